"""Compiled functions whose cache on disk belongs to all of their sources.

Numba looks only at the file that holds a function: after a change in another file that it calls,
the old machine code would run on. Here the cache's folder is named by the sources of every kernel.
"""

import hashlib
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core import event as events

from .user_cache import user_cache

#: Caches of sources that no longer exist are removed after this time [s].
KEPT = 7 * 86400.0

#: Cache folder of each folder with kernels; None where no folder can be written.
_homes: dict[Path, Path | None] = {}


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile without Python objects, cached on disk; options as in `numba.njit`.

    Never with `fastmath`: where a kernel is inlined, and whether it was read from the cache, would
    then decide its last digits. Long sums are vectorised by `tracking.fit.kernels.lanes`.
    """
    if "fastmath" in options:
        raise TypeError(
            "no kernel is compiled with fastmath; tracking.fit.kernels.lanes has long sums"
        )

    def decorate(function: Callable[..., Any]) -> Any:
        folder = Path(function.__code__.co_filename).parent
        if folder not in _homes:
            _homes[folder] = next(filter(_make, _places(folder)), None)
        home, chosen = _homes[folder], numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(home or chosen)
        try:
            return numba.njit(cache=home is not None, error_model="numpy", **options)(function)
        finally:
            numba.config.CACHE_DIR = chosen

    return decorate


@cache
def _sources() -> str:
    """Digest of every file that holds a kernel, and of what changes their machine code."""
    digest = hashlib.sha256(numba.__version__.encode())
    if numba.config.BOUNDSCHECK:  # NUMBA_BOUNDSCHECK=1 makes other machine code
        digest.update(b"bounds are checked")
    package = Path(__file__).parent
    for folder, inner, names in os.walk(package, followlinks=True):
        inner[:] = sorted(name for name in inner if name != "__pycache__")
        for name in sorted(names):
            if name.endswith(".py"):
                text = (Path(folder) / name).read_bytes()
                if b"njit(" in text or b"@intrinsic" in text:
                    digest.update(text)
    return digest.hexdigest()[:16]


def _places(folder: Path) -> list[Path]:
    """Cache folders for the kernels of a folder, the first one that can be written is used."""
    name = f"kernels-{_sources()}"
    if numba.config.CACHE_DIR:  # set by NUMBA_CACHE_DIR
        return [Path(numba.config.CACHE_DIR) / "chromagrip" / name]
    places = [folder / "__pycache__" / name, user_cache() / name]
    return [place for place in places if place.is_absolute()]  # who has no home has none


def _make(home: Path) -> bool:
    """Make a cache folder, without caches of former sources beside it; False if it cannot be."""
    fresh = not home.exists()
    try:
        home.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=home).close()
    except OSError:
        return False
    if fresh:
        # Another process may still write to the one before this.
        for old in home.parent.glob("kernels-*"):
            if old.stat().st_mtime < time.time() - KEPT:
                shutil.rmtree(old, ignore_errors=True)
    return True


def announce() -> None:
    """Say on stderr when the first kernel is compiled, and where kernels cannot be kept."""
    events.register("numba:compile", _Announcer())


class _Announcer(events.Listener):  # type: ignore[misc]  # numba has no types
    """Speaks once, and only if nothing was compiled before or nothing can be kept."""

    _spoken = False

    def on_start(self, event: events.Event) -> None:
        """Say it when a kernel of ours is compiled."""
        code = event.data["dispatcher"].py_func.__code__
        if not self._spoken and Path(code.co_filename).parent in _homes:
            self._spoken = True
            notice = _notice()
            if notice:
                print(f"chromagrip: {notice}", file=sys.stderr, flush=True)

    def on_end(self, event: events.Event) -> None:
        """Nothing is said at the end."""


def _notice() -> str | None:
    """One sentence about what compiling costs now; None when most kernels are kept already."""
    package = f"the folder {Path(__file__).parent}"
    chosen = numba.config.CACHE_DIR
    homes = {home for home in _homes.values() if home is not None}
    if None in _homes.values():
        lost = f"NUMBA_CACHE_DIR={chosen}" if chosen else package
        return (
            f"{lost} cannot be written, so the kernels are compiled at each start, which takes "
            "about a minute; set NUMBA_CACHE_DIR to a folder that can be written"
        )
    if any(next(home.rglob("*.nbi"), None) for home in homes):
        return None
    notice = "compiling its kernels, once; this takes about a minute"
    away = [home for folder, home in _homes.items() if home and folder not in home.parents]
    if away and not chosen:
        notice += f" (they are kept in {away[0].parent}, because {package} cannot be written)"
    return notice
