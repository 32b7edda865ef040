"""A folder for a command's output: new or empty, or written over when asked to."""

from pathlib import Path

from .errors import FolderError


def prepare(folder: Path, force: bool) -> None:
    """Make the folder.

    Raises
    ------
    FolderError
        When it holds files and `force` is not given, or cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        taken = any(folder.iterdir())
    except FileExistsError:
        raise FolderError(f"{folder} is a file, not a folder") from None
    except OSError as error:
        raise FolderError(f"folder {folder} cannot be written: {error.strerror}") from None
    if taken and not force:
        raise FolderError(f"folder {folder} is not empty; choose another or give --force")
