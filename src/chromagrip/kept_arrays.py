"""Arrays that were made once, kept by what they were made from in the user's cache."""

import contextlib
import hashlib
import os
import tempfile
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .user_cache import user_cache

#: What a kept file holds: arrays by name.
Arrays = dict[str, NDArray[np.generic]]

#: So many files of a kind are kept, the ones used last; each has some 5 MB.
MOST = 100


def content_key(version: str, *arrays: NDArray[np.generic]) -> str:
    """Name of what is made from these arrays: a digest of their types, shapes and values.

    Parameters
    ----------
    version: of the way in which it is made
    """
    digest = hashlib.sha256(version.encode())
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:32]


def kept(kind: str, key: str) -> Arrays | None:
    """Arrays kept under a name; None when there are none that can be read."""
    path = user_cache() / kind / f"{key}.npz"
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            found = {name: file[name] for name in file.files}
        os.utime(path)  # used now
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        return None
    return found


def keep(kind: str, key: str, arrays: Arrays) -> None:
    """Keep arrays under a name, whole or not at all; nothing where no folder can be written."""
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


def _used(path: Path) -> float:
    return path.stat().st_mtime
