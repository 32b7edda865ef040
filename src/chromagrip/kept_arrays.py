"""Cache of computed arrays in the user's folder, keyed by their input."""

import contextlib
import hashlib
import os
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from .folders import lock_file, user_cache

#: Arrays of a kept file, by name.
Arrays = dict[str, NDArray[np.generic]]

#: Number of files of a kind that are kept, those used last; each has some 3.5 MB. The tests need
#: more than 100.
MOST = 300


def content_key(version: str, *arrays: NDArray[np.generic]) -> str:
    """Cache key of a result computed from these arrays: digest of types, shapes and values.

    Parameters
    ----------
    version: version of the computation
    arrays: input of the computation, any shapes
    """
    digest = hashlib.sha256(version.encode())
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:32]


def kept(kind: str, key: str) -> Arrays | None:
    """Load the arrays kept under a key; None if they are missing or cannot be read."""
    path = user_cache() / kind / f"{key}.npz"
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            found = {name: file[name] for name in file.files}
        os.utime(path)  # used now
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        return None
    return found


def keep(kind: str, key: str, arrays: Arrays) -> None:
    """Keep arrays under a key; a no-op if the cache cannot be written."""
    folder = user_cache() / kind
    if not folder.is_absolute():
        return
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        handle, unfinished = tempfile.mkstemp(suffix=".unfinished", dir=folder)
        try:
            with open(handle, "wb") as file:
                np.savez(file, allow_pickle=False, **arrays)
            os.replace(unfinished, folder / f"{key}.npz")
        finally:
            Path(unfinished).unlink(missing_ok=True)
        for old in sorted(folder.glob("*.npz"), key=_used)[:-MOST]:
            old.unlink(missing_ok=True)


def kept_or_made(kind: str, key: str, make: Callable[[], Arrays]) -> Arrays:
    """Load the arrays kept under a key, or make and keep them; other processes wait meanwhile."""
    found = kept(kind, key)
    if found is None:
        with _alone(user_cache() / kind / f"{key}.lock"):
            found = kept(kind, key)
            if found is None:
                # A dome's systems are small: on two threads they take twice as long.
                with threadpool_limits(1):
                    found = make()
                keep(kind, key, found)
    return found


@contextlib.contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Hold a lock file, which is removed; no lock where the cache cannot be written."""
    with contextlib.ExitStack() as held:
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            lock_file(held.enter_context(path.open("w")).fileno(), wait=True)
            held.callback(path.unlink, missing_ok=True)
        yield


def _used(path: Path) -> float:
    return path.stat().st_mtime
