"""Files that others made: names and links that lead out of a folder are refused."""

import os
from pathlib import Path

from .errors import UserError


def inside(folder: Path, name: str, follow_links: bool = False) -> Path:
    """Path of what has that relative name in a folder; whether it exists is not asked.

    Parameters
    ----------
    folder: that the user named; it may be a link itself
    name: that a file of the folder gives, such as `sequence-000000/rest.png`
    follow_links: whether the name may be a link that leads out of the folder

    Raises
    ------
    UserError
        When the name is absolute or has a part `..`, or it leads out of the folder by a link.
    """
    parts = name.split("/")
    plain = name.isprintable() and "\\" not in name and not Path(name).drive
    if not plain or not {"", ".", ".."}.isdisjoint(parts):
        raise UserError(
            f"{folder} names a file {shortened(name)}; expected a name inside the folder"
        )
    path = folder / name
    if not follow_links:
        _check_link(path, Path(os.path.realpath(folder)))
    return path


def refuse_links(folder: Path) -> None:
    """Walk a folder, and refuse links that lead out of it and what is no file, such as a pipe.

    Raises
    ------
    UserError
        With the first one.
    """
    home = Path(os.path.realpath(folder))
    left = [folder]
    while left:
        try:
            with os.scandir(left.pop()) as entries:
                found = list(entries)
        except OSError as error:
            raise UserError(f"{error.filename} cannot be read: {error.strerror}") from None
        for entry in found:
            if entry.is_symlink():
                _check_link(Path(entry.path), home)
            elif entry.is_dir():
                left.append(Path(entry.path))
            elif not entry.is_file():
                raise UserError(f"{entry.path} is no file; remove it")


def shortened(value: object, most: int = 80) -> str:
    """A stranger's value for a message: quoted, on one line, with at most so many characters."""
    text = repr(value[: 2 * most] if isinstance(value, str) else value)
    return text if len(text) <= most else f"{text[: most - 1]}…"


def _check_link(path: Path, home: Path) -> None:
    # `realpath` stops at a loop of links instead of raising; opening the file then fails.
    if not Path(os.path.realpath(path)).is_relative_to(home):
        raise UserError(
            f"{path} is a link that leads out of its folder; give --follow-links (Python: "
            "follow_links=True) if you trust it"
        )
