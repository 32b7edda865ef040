"""Folders and files of a command's output: never half-written, and never written over unasked."""

import atexit
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from ..errors import UserError

#: Start of the name of a file or folder that is not complete.
PART = ".part-"
#: Folders that were made, the outer ones first.
_made: list[Path] = []
#: Start of the name of a folder for what libraries keep while a command runs.
_SCRATCH = ".scratch-"


def prepare(folder: Path, overwrite: bool | None) -> None:
    """Make a folder for output.

    Parameters
    ----------
    folder: new or empty
    overwrite: whether it may hold files; None where a command never writes over any

    Raises
    ------
    UserError
        When it holds files and `overwrite` is not given, or cannot be made.
    """
    absent = [each for each in (folder, *folder.parents) if not each.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _made.extend(reversed(absent))
        taken = any(not each.name.startswith(_SCRATCH) for each in folder.iterdir())
    except FileExistsError:
        raise UserError(f"{folder} is a file, not a folder") from None
    except OSError as error:
        raise UserError(f"folder {folder} cannot be written: {error.strerror}") from None
    if taken and not overwrite:
        mend = "choose another" if overwrite is None else "choose another or give --overwrite"
        raise UserError(f"folder {folder} is not empty; {mend}")


def remove_empty() -> None:
    """Remove what `prepare` has made in this process, where it is empty, as after a failure."""
    while _made:
        with suppress(OSError):
            _made.pop().rmdir()


def make_scratch(out: Path) -> None:
    """Give libraries a folder beside or in an output, where nothing else can be written.

    Matplotlib ends a program that has neither a home nor a folder for temporary files. The folder
    goes when this process ends.

    Parameters
    ----------
    out: file or folder of the output, which need not exist
    """
    try:
        tempfile.gettempdir()
    except FileNotFoundError:
        place = next((each for each in (out, *out.absolute().parents) if each.is_dir()), out)
        with suppress(OSError):
            tempfile.tempdir = tempfile.mkdtemp(prefix=_SCRATCH, dir=place)
            os.environ["TMPDIR"] = os.environ["MPLCONFIGDIR"] = tempfile.tempdir
            atexit.register(shutil.rmtree, tempfile.tempdir, ignore_errors=True)


def leave(folder: Path, name: str) -> None:
    """Remove the first file of a result that has no others, and the folder if it is then empty."""
    with suppress(OSError):
        if [each.name for each in folder.iterdir()] == [name]:
            (folder / name).unlink()
        folder.rmdir()


def part_of(path: Path) -> Path:
    """Path of a file until it is complete, with the same suffix."""
    return path.with_name(f"{PART}{path.name}")


@contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Make an error of the disk one sentence, and remove what was written of the file.

    Raises
    ------
    UserError
        Instead of an `OSError` that is raised inside, as where the disk is full.
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

    Yields the path to write to; an exception inside leaves no file.

    Raises
    ------
    UserError
        When it cannot be written, as where the disk is full.
    """
    part = part_of(path)
    with disk_errors(path):
        try:
            yield part
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)


def write_whole(path: Path, data: bytes) -> None:
    """Write bytes as a `whole_file`; errors as there."""
    with whole_file(path) as part:
        part.write_bytes(data)


class GrowingFile:
    """File that is written piece by piece; a context, at whose end it gets its name.

    So it does after an interruption, with the pieces until then, but not after an error of the
    disk.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._part = path, part_of(path)

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
            When it cannot be written, as where the disk is full; nothing of it is left.
        """
        with disk_errors(self._path):
            if self._part.exists():
                self._finish()
            if self._part.exists():
                self._part.replace(self._path)

    def _finish(self) -> None:
        """Write what waits, and close; a file that is removed here gets no name."""
        raise NotImplementedError


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """Fill a folder that gets its name when it is complete.

    Yields the folder to fill; an exception inside leaves none. An empty folder of that name is
    replaced. A filled one stays: another process was faster.

    Raises
    ------
    UserError
        When it cannot be written, as where the disk is full.
    """
    part = path.with_name(f"{PART}{path.name}-{os.getpid()}")
    with disk_errors(path):
        try:
            shutil.rmtree(part, ignore_errors=True)
            part.mkdir()
            yield part
            with suppress(OSError):
                path.rmdir()
            if not path.exists():
                part.rename(path)
        finally:
            shutil.rmtree(part, ignore_errors=True)


@contextmanager
def filling(folder: Path) -> Iterator[None]:
    """Hold a folder that two runs must not fill at once, where the file system has locks.

    Raises
    ------
    UserError
        When another run of this machine holds it.
    """
    try:
        import fcntl
    except ImportError:  # Windows has no lock on folders
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise UserError(f"{folder} is being filled by another run") from None
        yield
    finally:
        os.close(handle)
