"""Compiled functions, each kept on disk by the digest of everything that it can reach.

Numba itself looks only at the file that holds a function: after a change in another file that it
calls, the old machine code would run on. Each kernel here is compiled again when something changes
that it can reach, and only then.
"""

import os
import pickle
import shutil
import sys
import tempfile
import time
import uuid
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numba
from numba.core import event as events
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

from .kernel_key import UnreadableError, kernel_key, signature_key
from .user_cache import user_cache

#: Machine code that nobody used is removed after this time [s].
KEPT = 7 * 86400.0
#: A use is noted when the one before is older than this [s].
NOTED = 86400.0

#: Cache folder of each folder with kernels; None where no folder can be written.
_homes: dict[Path, Path | None] = {}
#: So many kernels are worth a word, also where others are kept.
FEW = 10


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
        kernel, home = numba.njit(error_model="numpy", **options)(function), _homes[folder]
        if home is not None and not numba.config.DISABLE_JIT:
            kernel._cache = _Cache(kernel, home)
        return kernel

    return decorate


class _Cache:
    """Machine code of one kernel: what Numba asks of a cache, with one file for each signature.

    A file is named by the kernel, its key and its signature. It is complete when it gets its name:
    processes may compile the same kernel at once.
    """

    def __init__(self, kernel: Any, home: Path) -> None:
        self.kernel = kernel
        self.home = home
        self.cache_path = str(home)
        name = f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}"
        self.name = name.replace("<", "").replace(">", "")

    @cached_property
    def key(self) -> str:
        """Key of the kernel, taken at its first call: what it calls may be defined after it."""
        return kernel_key(self.kernel)

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Result of a former compilation, or None."""
        target.refresh()
        path = self._path(signature, target.codegen())
        if path is None:
            return None
        try:
            used = path.stat().st_mtime
            kept, result = pickle.loads(path.read_bytes())
        except (OSError, EOFError, pickle.UnpicklingError):
            return None
        if used < time.time() - NOTED:
            with suppress(OSError):
                os.utime(path)
        return CompileResult._rebuild(target, *result) if kept == signature else None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep the result of a compilation, unless the disk is full."""
        path = self._path(signature, result.codegen)
        if path is None:
            return
        if result.library.has_dynamic_globals:
            self._warn("it holds addresses of this process")
            return
        part = self.home / f"{uuid.uuid4().hex}.part"
        try:
            self.home.mkdir(parents=True, exist_ok=True)
            _clean(self.home)
            part.write_bytes(dumps((signature, result._reduce())))
            os.replace(part, path)
        except OSError:
            part.unlink(missing_ok=True)

    def flush(self) -> None:
        """Remove nothing: what is kept belongs to this kernel as it is."""

    def _path(self, signature: Any, codegen: Any) -> Path | None:
        """File of a signature; None, with a warning, for one that cannot be kept."""
        try:
            types = signature_key(signature, codegen.magic_tuple())
            return self.home / f"{self.name}-{self.key[:20]}-{types[:20]}.nbc"
        except UnreadableError as error:
            self._warn(error)
            return None

    def _warn(self, reason: object) -> None:
        warnings.warn(f"{self.name} is compiled at each start: {reason}", stacklevel=3)


def _places(folder: Path) -> list[Path]:
    """Cache folders for the kernels of a folder, the first one that can be written is used."""
    if numba.config.CACHE_DIR:  # set by NUMBA_CACHE_DIR
        return [Path(numba.config.CACHE_DIR) / "chromagrip/kernels"]
    places = [folder / "__pycache__/kernels", user_cache() / "kernels"]
    return [place for place in places if place.is_absolute()]  # who has no home has none


@cache
def _make(home: Path) -> bool:
    """Make a cache folder; False if it cannot be written."""
    try:
        home.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=home).close()
    except OSError:
        return False
    return True


@cache
def _clean(home: Path) -> None:
    """Remove, once in a process, what nobody used for long; other processes may use the rest."""
    former = home.parent.glob("kernels-*")  # of all kernels, from when they had one key
    for old in [*home.iterdir(), *former]:
        with suppress(OSError):
            if old.stat().st_mtime < time.time() - KEPT:
                if old.is_dir():
                    shutil.rmtree(old)
                else:
                    old.unlink()


def announce() -> None:
    """Say on stderr when kernels are compiled, and where they cannot be kept."""
    events.register("numba:compile", _Announcer())


class _Announcer(events.Listener):  # type: ignore[misc]  # numba has no types
    """Speaks once: at the first kernel, or after a few where others are kept."""

    _compiled = 0
    _spoken = False

    def on_start(self, event: events.Event) -> None:
        """Say it when a kernel of ours is compiled."""
        code = event.data["dispatcher"].py_func.__code__
        if self._spoken or Path(code.co_filename).parent not in _homes:
            return
        self._compiled += 1
        if self._compiled in (1, FEW):
            notice = _notice(few=self._compiled < FEW)
            if notice:
                self._spoken = True
                print(f"chromagrip: {notice}", file=sys.stderr, flush=True)

    def on_end(self, event: events.Event) -> None:
        """Nothing is said at the end."""


def _notice(*, few: bool) -> str | None:
    """One sentence about what compiling costs now; None for few kernels where others are kept."""
    package = f"the folder {Path(__file__).parent}"
    chosen = numba.config.CACHE_DIR
    homes = {home for home in _homes.values() if home is not None}
    if None in _homes.values():
        lost = f"NUMBA_CACHE_DIR={chosen}" if chosen else package
        return (
            f"{lost} cannot be written, so the kernels are compiled at each start, which takes "
            "about a minute; set NUMBA_CACHE_DIR to a folder that can be written"
        )
    if few and any(next(home.glob("*.nbc"), None) for home in homes):
        return None
    notice = "compiling its kernels, once; this takes about a minute"
    away = [home for folder, home in _homes.items() if home and folder not in home.parents]
    if away and not chosen:
        notice += f" (they are kept in {away[0].parent}, because {package} cannot be written)"
    return notice
