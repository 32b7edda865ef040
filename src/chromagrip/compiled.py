"""Compiled functions whose cache on disk belongs to all of their sources.

Numba looks only at the file that holds a function: after a change in another file that it calls,
the old machine code would run on. Here the cache's folder is named by the sources of every kernel.
"""

import hashlib
import os
import shutil
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba

#: Caches of sources that are no more are removed after this time [s].
KEPT = 7 * 86400.0


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile without Python objects, cached on disk; options as in `numba.njit`.

    Never with `fastmath`: where a kernel is inlined, and whether it was read from the cache, would
    then decide its last digits. Long sums are vectorised by `tracking.lanes`.
    """
    if "fastmath" in options:
        raise TypeError("kernels are compiled without fastmath: see tracking.lanes for long sums")

    def decorate(function: Callable[..., Any]) -> Any:
        chosen = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = chosen or _folder(Path(function.__code__.co_filename).parent)
        try:
            return numba.njit(cache=True, error_model="numpy", **options)(function)
        finally:
            numba.config.CACHE_DIR = chosen

    return decorate


@cache
def _sources() -> str:
    """Digest of every file that holds a kernel."""
    digest = hashlib.sha256(numba.__version__.encode())
    package = Path(__file__).parent
    for folder, inner, names in os.walk(package, followlinks=True):
        inner[:] = sorted(name for name in inner if name != "__pycache__")
        for name in sorted(names):
            if name.endswith(".py"):
                text = (Path(folder) / name).read_bytes()
                if b"njit(" in text or b"@intrinsic" in text:
                    digest.update(text)
    return digest.hexdigest()[:16]


@cache
def _folder(source: Path) -> str:
    """Cache folder for the kernels of a folder; empty where it cannot be written to."""
    home = source / "__pycache__" / f"kernels-{_sources()}"
    try:
        fresh = not home.exists()
        home.mkdir(parents=True, exist_ok=True)
    except OSError:
        return ""  # numba finds a place of its own
    if fresh:
        # Another process may still write to the one before this.
        for old in home.parent.glob("kernels-*"):
            if old.stat().st_mtime < time.time() - KEPT:
                shutil.rmtree(old, ignore_errors=True)
    return str(home)
