"""A folder for a command's output: new or empty, or written over when asked to."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import UserError


def prepare(folder: Path, force: bool | None) -> None:
    """Make the folder.

    Parameters
    ----------
    folder: new or empty
    force: whether it may hold files; None where a command never writes over any

    Raises
    ------
    UserError
        When it holds files and `force` is not given, or cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        taken = any(folder.iterdir())
    except FileExistsError:
        raise UserError(f"{folder} is a file, not a folder") from None
    except OSError as error:
        raise UserError(f"folder {folder} cannot be written: {error.strerror}") from None
    if taken and not force:
        mend = "choose another" if force is None else "choose another or give --force"
        raise UserError(f"folder {folder} is not empty; {mend}")


@contextmanager
def filling(folder: Path) -> Iterator[None]:
    """Hold a folder that two runs must not fill at once, as far as the file system can.

    Raises
    ------
    UserError
        When another run of this machine holds it.
    """
    try:
        import fcntl
    except ImportError:  # Windows holds no folder
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
