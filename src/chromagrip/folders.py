"""Folders and files of a command's output: never half-written, never overwritten unasked."""

import atexit
import errno
import os
import platform
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from .errors import UserError

if TYPE_CHECKING:  # the doctor needs no package to find the user's cache
    from numpy.typing import NDArray

#: Start of the name of a file or folder that is not complete.
PART = ".part-"
#: File of a folder that is being filled; it names the process that fills it.
LOCK = ".lock"
#: Folders made by this process, the outer ones first.
_made: list[Path] = []
#: Start of the name of a folder for temporary files of libraries.
_SCRATCH = ".scratch-"


def user_cache() -> Path:
    """Folder in which what took long to compute is kept for the user.

    It is relative where the user has no home and none was chosen.
    """
    user = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or "~/.cache"
    return Path(os.path.expanduser(user)) / "chromagrip"


@contextmanager
def prepared(folder: Path | None, overwrite: bool | None) -> Iterator[None]:
    """Make a folder for output, and lock it until it is filled.

    Parameters
    ----------
    folder: new or empty folder; None for a command without output
    overwrite: whether the folder may hold files; None if the command has no --overwrite

    Raises
    ------
    UserError
        When the folder holds files without `overwrite`, cannot be made, or is being filled.
    """
    if folder is None:
        yield
        return
    try:
        make_folder(folder)
    except FileExistsError:
        raise UserError(f"{folder} is a file, not a folder") from None
    except OSError as error:
        raise UserError(f"folder {folder} cannot be written: {error.strerror}") from None
    with filling(folder):
        if not overwrite and any(
            not each.name.startswith((LOCK, _SCRATCH)) for each in folder.iterdir()
        ):
            mend = "choose another" if overwrite is None else "choose another or give --overwrite"
            raise UserError(f"folder {folder} is not empty; {mend}")
        yield


def make_folder(folder: Path, new: bool = False) -> None:
    """Make a folder, and remember it for `remove_empty`.

    Parameters
    ----------
    folder: folder to make, with its parents
    new: whether an existing folder is a `FileExistsError` (default: it is not)
    """
    absent = [each for each in (folder, *folder.parents) if not each.exists()]
    folder.mkdir(parents=True, exist_ok=not new)
    _made.extend(reversed(absent))


def remove_empty() -> None:
    """Remove the empty folders that this process has made, for use after a failure."""
    while _made:
        with suppress(OSError):
            _made.pop().rmdir()


def make_scratch(out: Path) -> None:
    """Make a folder for temporary files in or next to an output, if there is no other.

    Matplotlib ends a program that has neither a home nor a folder for temporary files. The folder
    is removed when this process ends.

    Parameters
    ----------
    out: file or folder of the output; it need not exist
    """
    try:
        tempfile.gettempdir()
    except FileNotFoundError:
        place = next((each for each in (out, *out.absolute().parents) if each.is_dir()), out)
        with suppress(OSError):
            tempfile.tempdir = tempfile.mkdtemp(prefix=_SCRATCH, dir=place)
            os.environ["TMPDIR"] = os.environ["MPLCONFIGDIR"] = tempfile.tempdir
            atexit.register(shutil.rmtree, tempfile.tempdir, ignore_errors=True)


def remove(path: Path) -> None:
    """Remove a file, or a folder with what it holds."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()


def leave(folder: Path, name: str) -> None:
    """Remove a file that is alone in its folder, and the folder if it is then empty."""
    with suppress(OSError):
        if [each.name for each in folder.iterdir()] == [name]:
            (folder / name).unlink()
        folder.rmdir()


def part_of(path: Path) -> Path:
    """Path of a file until it is complete: same suffix, a different name in each process."""
    return path.with_name(f"{PART}{os.getpid()}-{path.name}")


def sync(path: Path) -> None:
    """Wait until the disk holds a file, or the names in a folder."""
    if os.name == "nt":  # Windows syncs what is open for writing alone
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        # Some file systems of other machines cannot sync a folder.
        if error.errno != errno.EINVAL:
            raise
    finally:
        os.close(handle)


@contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Turn a disk error into one sentence, and remove the part of the file already written.

    Raises
    ------
    UserError
        Instead of an `OSError` that is raised inside, such as a full disk.
    """
    try:
        yield
    except OSError as error:
        with suppress(OSError):
            part_of(path).unlink()
        reason = os.strerror(error.errno) if error.errno else error
        raise UserError(f"{path} cannot be written: {reason}") from None


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Write a file that gets its name when it is complete.

    Yields the path to write to; after an exception inside, no file remains.

    Raises
    ------
    UserError
        When it cannot be written, such as on a full disk.
    """
    part = part_of(path)
    with disk_errors(path):
        part.unlink(missing_ok=True)  # in a stranger's folder it may be a link to elsewhere
        try:
            yield part
            sync(part)
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)


def write_whole(path: Path, data: bytes) -> None:
    """Write bytes as a `whole_file`; errors as there."""
    with whole_file(path) as part:
        part.write_bytes(data)


def synced(path: Path) -> None:
    """`sync` with errors of the disk in one sentence, as in `disk_errors`."""
    with disk_errors(path):
        sync(path)


def write_arrays(path: Path, arrays: "Mapping[str, NDArray[Any]]") -> None:
    """Write arrays as a NumPy file (.npz), as a `whole_file`; errors as there."""
    import numpy as np

    with whole_file(path) as part, part.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


class GrowingFile:
    """File that is written piece by piece; it gets its name when its context ends.

    After an interruption it keeps the pieces written so far; after a disk error it is removed.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._part = path, part_of(path)
        with suppress(OSError):
            self._part.unlink()

    def __enter__(self) -> Self:
        """Use as a context."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file."""
        self.close()

    def close(self) -> None:
        """Finish the file and give it its name; closing it again does nothing.

        Raises
        ------
        UserError
            When it cannot be written, such as on a full disk; it is then removed.
        """
        with disk_errors(self._path):
            if self._part.exists():
                self._finish()
            if self._part.exists():
                sync(self._part)
                self._part.replace(self._path)

    def _finish(self) -> None:
        """Write the remaining pieces and close; a file that is removed here gets no name."""
        raise NotImplementedError


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """Fill a folder that gets its name when it is complete.

    Yields the folder to fill; after an exception inside, no folder remains. An empty folder of
    that name is replaced. A filled one stays: another process was faster.

    Raises
    ------
    UserError
        When it cannot be written, such as on a full disk.
    """
    part = path.with_name(f"{PART}{path.name}-{os.getpid()}")
    with disk_errors(path):
        try:
            shutil.rmtree(part, ignore_errors=True)
            part.mkdir()
            yield part
            with suppress(OSError):
                if [each.name for each in path.iterdir()] == [LOCK]:  # this process holds it
                    (path / LOCK).unlink()
                path.rmdir()
            if not path.exists():
                part.rename(path)
        finally:
            shutil.rmtree(part, ignore_errors=True)


@contextmanager
def filling(folder: Path, *, wait: bool = False) -> Iterator[None]:
    """Lock a folder that two runs must not fill at once.

    The operating system holds the lock and releases it when the process ends. The lock file only
    names the process. Windows and some network disks have no locks; the folder is not locked there.

    Parameters
    ----------
    folder: folder that is filled
    wait: whether to wait for a locked folder (default: refuse it)

    Raises
    ------
    UserError
        When another run has locked it, or it cannot be written.
    """
    try:
        handle = _locked(folder, wait)
    except OSError as error:
        raise UserError(f"folder {folder} cannot be written: {error.strerror}") from None
    try:
        yield
    finally:
        with suppress(OSError):
            (folder / LOCK).unlink()
        os.close(handle)


def lock_file(handle: int, wait: bool = False) -> bool | None:
    """Lock an open file; False if another process holds it, None if there are no such locks."""
    try:
        import fcntl

        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        return False
    except (ImportError, OSError):
        return None
    return True


def _locked(folder: Path, wait: bool) -> int:
    """Open the file that locks a folder; returns its descriptor."""
    path = folder / LOCK
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
        held = lock_file(handle, wait)
        if held is None:
            return handle
        if not held:
            who = os.read(handle, 200).decode(errors="replace").strip() or "another run"
            os.close(handle)
            raise UserError(
                f"folder {folder} is being filled by {who}; choose another, or wait until it ends"
            )
        with suppress(FileNotFoundError):
            if path.stat().st_ino == os.fstat(handle).st_ino:
                os.ftruncate(handle, 0)
                os.write(handle, f"process {os.getpid()} on {platform.node()}\n".encode())
                return handle
        os.close(handle)  # the process that held it has just removed the file
