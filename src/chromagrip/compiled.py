"""Compiled functions, each cached on disk by the digest of all code that it can reach.

Numba itself looks only at the file of a function: after a change in another file that it calls,
the old machine code would run. Here a kernel is compiled again only when code that it can reach
changes.
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

from .folders import lock_file, user_cache
from .kernel_key import UnreadableError, kernel_key, signature_key

#: Cache folder of each folder with kernels; None if no folder can be written.
_homes: dict[Path, Path | None] = {}
#: Files of the kernels that this process has compiled.
_compiled_here: set[Path] = set()


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile without Python objects, cached on disk; options as in `numba.njit`.

    A kernel runs without the interpreter's lock, so that threads work beside each other: it must
    not write into arrays that several threads share.

    `fastmath` is refused: last digits would depend on where a kernel is inlined, and on whether it
    was read from the cache. Long sums are vectorised by `tracking.fit.kernels.lanes`.
    """
    if "fastmath" in options:
        raise TypeError(
            "no kernel is compiled with fastmath; tracking.fit.kernels.lanes has long sums"
        )

    def decorate(function: Callable[..., Any]) -> Any:
        folder = Path(function.__code__.co_filename).parent
        if folder not in _homes:
            _homes[folder] = next(filter(_make, _places(folder)), None)
        kernel = numba.njit(error_model="numpy", nogil=True, **options)(function)
        if numba.config.DISABLE_JIT:
            return kernel  # the function itself
        kernel.get_call_template = _any_values(kernel.get_call_template)
        home = _homes[folder]
        if home is not None:
            kernel._cache = _Cache(kernel, home)
        return kernel

    return decorate


def _any_values(get_template: Callable[..., Any]) -> Callable[..., Any]:
    """A kernel that is called with a constant by another one is that for any value of its type."""

    def get(arguments: Any, keywords: dict[str, Any]) -> Any:
        loose = {name: numba.types.unliteral(each) for name, each in keywords.items()}
        return get_template(tuple(map(numba.types.unliteral, arguments)), loose)

    return get


class _Cache:
    """Numba cache of one kernel's machine code, with one file for each signature.

    A file is named by the kernel, its key and its signature. It is complete when it gets its name:
    processes may compile the same kernel at once.
    """

    def __init__(self, kernel: Any, home: Path) -> None:
        self.kernel = kernel
        self.home = home
        self.cache_path = str(home)
        name = f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}"
        self.name = name.replace("<", "").replace(">", "")
        self._held: dict[Path, int] = {}

    @cached_property
    def key(self) -> str:
        """Key of the kernel, computed at its first call: its callees may be defined after it."""
        return kernel_key(self.kernel)

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Load the result of an earlier compilation; None if it is missing.

        One process compiles a kernel for all: others wait for its result.
        """
        target.refresh()
        path = self._path(signature, target.codegen())
        if path is None:
            return None
        found = self._read(path, signature, target)
        if found is None and self._compiled_elsewhere(path):
            found = self._read(path, signature, target)
        return found

    def _read(self, path: Path, signature: Any, target: Any) -> Any:
        try:
            used = path.stat().st_mtime
            kept, result = pickle.loads(path.read_bytes())
        except (OSError, EOFError, pickle.UnpicklingError):
            return None
        noted_s = 86400.0  # a use is noted when the last noted one is older than this [s]
        if used < time.time() - noted_s:
            with suppress(OSError):
                os.utime(path)
        return CompileResult._rebuild(target, *result) if kept == signature else None

    def _compiled_elsewhere(self, path: Path) -> bool:
        """Wait while another process compiles a kernel; returns False if this one has to."""
        patience_s, step_s = 300.0, 0.05  # a process that compiles longer is not waited for
        end, waited = time.monotonic() + patience_s, False
        try:
            self.home.mkdir(parents=True, exist_ok=True)
            lock = os.open(path.with_suffix(".lock"), os.O_CREAT | os.O_RDWR, 0o644)
        except OSError:
            return False
        while lock_file(lock) is False:
            waited = True
            if time.monotonic() > end:
                os.close(lock)
                return False
            time.sleep(step_s)
        if waited and path.is_file():
            os.close(lock)
            return True
        self._held[path] = lock
        return False

    def release(self) -> None:
        """Let other processes compile what this one began."""
        for path, lock in self._held.items():
            with suppress(OSError):
                path.with_suffix(".lock").unlink()
            os.close(lock)
        self._held.clear()

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep the result of a compilation, unless the disk is full."""
        try:
            self._save(signature, result)
        finally:
            self.release()

    def _save(self, signature: Any, result: Any) -> None:
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
            _compiled_here.add(path)
        except OSError:
            part.unlink(missing_ok=True)

    def flush(self) -> None:
        """Do nothing: all files of this cache belong to the kernel as it is."""

    def _path(self, signature: Any, codegen: Any) -> Path | None:
        """Path of a signature's file; None, with a warning, if it cannot be cached."""
        try:
            types = signature_key(signature, codegen.magic_tuple())
            return self.home / f"{self.name}-{self.key[:20]}-{types[:20]}.nbc"
        except UnreadableError as error:
            self._warn(error)
            return None

    def _warn(self, reason: object) -> None:
        warnings.warn(f"{self.name} is compiled at each start: {reason}", stacklevel=3)


def _places(folder: Path) -> list[Path]:
    """Possible cache folders for the kernels of a folder; the first writable one is used."""
    if numba.config.CACHE_DIR:  # set by NUMBA_CACHE_DIR
        return [Path(numba.config.CACHE_DIR) / "chromagrip/kernels"]
    places = [folder / "__pycache__/kernels", user_cache() / "kernels"]
    return [place for place in places if place.is_absolute()]  # relative: the user has no home


@cache
def _make(home: Path) -> bool:
    """Make a cache folder; returns False if it cannot be written."""
    try:
        home.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=home).close()
    except OSError:
        return False
    return True


@cache
def _clean(home: Path) -> None:
    """Remove files unused for a week, once in a process; other processes may use the rest."""
    former = home.parent.glob("kernels-*")  # older format: one folder for all kernels
    for old in [*home.iterdir(), *former]:
        with suppress(OSError):
            if old.stat().st_mtime < time.time() - 7 * 86400.0:
                if old.is_dir():
                    shutil.rmtree(old)
                else:
                    old.unlink()


class _Clock(events.Listener):  # type: ignore[misc]  # numba has no types
    """Counts the time that this process spends compiling; kernels compile their callees inside."""

    seconds = _begin = 0.0
    _depth = 0

    def on_start(self, event: events.Event) -> None:
        """Start the clock at the outermost kernel."""
        if not self._depth:
            self._begin = time.perf_counter()
        self._depth += 1

    def on_end(self, event: events.Event) -> None:
        """Stop it there; a kernel that failed is not waited for."""
        if sys.exc_info()[0] is not None:
            cache = event.data["dispatcher"]._cache
            if isinstance(cache, _Cache):
                cache.release()
        self._depth -= 1
        if not self._depth:
            self.seconds += time.perf_counter() - self._begin


_clock = _Clock()
events.register("numba:compile", _clock)


def cold() -> bool:
    """Return True if no kernel was cached when this process began."""
    homes = {home for home in _homes.values() if home is not None}
    cached = {path for home in homes for path in home.glob("*.nbc")}
    return bool(homes) and cached <= _compiled_here


def working_time() -> float:
    """Clock that stands still while kernels are compiled [s]."""
    return time.perf_counter() - _clock.seconds


@cache
def announce() -> None:
    """Report on stderr once when kernels are compiled, and if they cannot be cached."""
    events.register("numba:compile", _Announcer())


class _Announcer(events.Listener):  # type: ignore[misc]  # numba has no types
    """Prints one notice: at the first kernel, or at the tenth if others are cached."""

    _compiled = 0
    _spoken = False

    def on_start(self, event: events.Event) -> None:
        """Count a compiled kernel of ours, and print the notice if it is due."""
        code = event.data["dispatcher"].py_func.__code__
        if self._spoken or Path(code.co_filename).parent not in _homes:
            return
        self._compiled += 1
        # Number of compiled kernels from which a notice is printed even if others are cached.
        few = 10
        if self._compiled in (1, few):
            notice = _notice(few=self._compiled < few)
            if notice:
                self._spoken = True
                print(f"chromagrip: {notice}", file=sys.stderr, flush=True)

    def on_end(self, event: events.Event) -> None:
        """Do nothing at the end of a compilation."""


def _notice(*, few: bool) -> str | None:
    """Describe the cost of compiling in one sentence; None for few kernels if others are cached."""
    package = f"the folder {Path(__file__).parent}"
    chosen = numba.config.CACHE_DIR
    homes = {home for home in _homes.values() if home is not None}
    if None in _homes.values():
        lost = f"NUMBA_CACHE_DIR={chosen}" if chosen else package
        return (
            f"{lost} cannot be written, so the kernels are compiled at each start, which takes "
            "about a minute; set NUMBA_CACHE_DIR to a folder that can be written"
        )
    others = {path for home in homes for path in home.glob("*.nbc")} - _compiled_here
    if few and others:
        return None
    notice = "compiling its kernels, once; this takes about a minute"
    if others:
        notice = "compiling kernels that no command has used before; this takes up to a minute"
    away = [home for folder, home in _homes.items() if home and folder not in home.parents]
    if away and not chosen:
        notice += f" (they are kept in {away[0].parent}, because {package} cannot be written)"
    return notice
