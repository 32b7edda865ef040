"""Files from strangers: names, links, sizes and arrays are checked before they are used."""

import math
import os
import tokenize
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from .errors import UserError

#: Largest text file, such as a manifest of a million sequences [bytes].
_MOST_BYTES = 200_000_000


def inside(folder: Path, name: str, follow_links: bool = False) -> Path:
    """Path of a relative name in a folder; it need not exist.

    Parameters
    ----------
    folder: folder given by the user; it may be a link itself
    name: relative name found in a file of the folder, such as `sequence-000000/rest.png`
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


def refuse_links(folder: Path, follow_links: bool = False) -> None:
    """Walk a folder, and refuse links that lead out of it and special files, such as a pipe.

    Parameters
    ----------
    folder: folder given by the user; it may be a link itself
    follow_links: whether links may lead out of it

    Raises
    ------
    UserError
        For the first such entry.
    """
    home = Path(os.path.realpath(folder))
    pending = [folder]
    while pending:
        try:
            with os.scandir(pending.pop()) as entries:
                found = list(entries)
        except OSError as error:
            raise UserError(f"{error.filename} cannot be read: {error.strerror}") from None
        for entry in found:
            if entry.is_symlink() and not follow_links:
                _check_link(Path(entry.path), home)
            if entry.is_dir(follow_symlinks=False):
                pending.append(Path(entry.path))
            elif not entry.is_file(follow_symlinks=False):
                path = entry.path  # DirEntry raises at a loop of links
                if os.path.exists(path) and not (os.path.isfile(path) or os.path.isdir(path)):
                    raise UserError(f"{path} is no file; remove it")


def need_file(path: Path, what: str) -> None:
    """Refuse a pipe or a device, which may never end; `what` names the file."""
    if path.is_fifo() or path.is_char_device():
        raise UserError(f"{what} is no file")


def read_small(path: Path, most: int = _MOST_BYTES) -> bytes:
    """Read a whole file into memory.

    Parameters
    ----------
    path: path of the file
    most: largest size (default 200 MB) [bytes]

    Raises
    ------
    UserError
        When it cannot be read or is larger.
    """
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            if size > most:
                raise UserError(
                    f"{path} has {size / 1e6:.0f} MB; at most {most / 1e6:.0f} MB are read"
                )
            return file.read(most)
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror}") from None


def array_names(path: Path) -> list[str]:
    """Names of the arrays in a NumPy file (.npz); errors as in `read_arrays`."""
    with _unzipped(path) as file:
        return [name.removesuffix(".npy") for name in file.namelist()]


def read_arrays(
    path: Path, names: Iterable[str], most: int = 100_000_000
) -> dict[str, NDArray[Any]]:
    """Read arrays of a NumPy file (.npz); their headers are checked before they are decoded.

    Parameters
    ----------
    path: path of the file
    names: names of the arrays
    most: largest number of values in an array, of eight bytes each (default 10⁸)

    Raises
    ------
    UserError
        When the file is damaged, or an array is not in it, claims more than it holds or is too
        large.
    """
    with _unzipped(path) as file:
        return {name: _array(file, f"{name}.npy", most) for name in names}


def array_headers(
    path: Path, names: Iterable[str]
) -> dict[str, tuple[tuple[int, ...], np.dtype[Any]]]:
    """Shape and type of arrays of a NumPy file (.npz), undecoded; errors as in `read_arrays`."""
    with _unzipped(path) as file:
        return {name: _header(file, f"{name}.npy") for name in names}


def read_header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Read the header of an array: its shape, whether its columns come first, and its type.

    Raises
    ------
    ValueError
        When it is not the header of an array.
    """
    read = np.lib.format.read_array_header_2_0
    if np.lib.format.read_magic(stream) == (1, 0):
        read = np.lib.format.read_array_header_1_0
    try:
        return read(stream)
    except (tokenize.TokenError, RecursionError, MemoryError):
        raise ValueError("its header is damaged") from None


def _header(file: zipfile.ZipFile, name: str) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of an array, which is not larger than what is stored."""
    try:
        stored = file.getinfo(name).file_size
    except KeyError:
        raise UserError(f"{file.filename} has no array {name.removesuffix('.npy')}") from None
    with file.open(name) as stream:
        shape, _, kind = read_header(stream)
        claimed = math.prod(shape) * kind.itemsize
    if min(shape, default=0) < 0 or claimed > stored:
        raise ValueError(f"{name} claims {claimed} bytes, it has {stored}")
    return shape, kind


def _array(file: zipfile.ZipFile, name: str, most: int) -> NDArray[Any]:
    shape, kind = _header(file, name)
    if math.prod(shape) * max(kind.itemsize, 8) > 8 * most:
        raise UserError(f"{file.filename}: {name} has more than {most} values, too many to read")
    with file.open(name) as stream:
        return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))


@contextmanager
def _unzipped(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open an archive; errors of a damaged one become one sentence."""
    try:
        with zipfile.ZipFile(path) as file:
            yield file
    except UserError:
        raise
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or str(error).partition("\n")[0]
        raise UserError(f"{path} cannot be read: {reason}") from None


def shortened(value: object, most: int = 80) -> str:
    """Quote a stranger's value for a message: one line of at most `most` characters."""
    text = repr(value[: 2 * most] if isinstance(value, str) else value)
    return text if len(text) <= most else f"{text[: most - 1]}…"


def _check_link(path: Path, home: Path) -> None:
    # `realpath` stops at a loop of links instead of raising; opening the file then fails.
    if not Path(os.path.realpath(path)).is_relative_to(home):
        raise UserError(
            f"{path} is a link that leads out of its folder; give --follow-links (Python: "
            "follow_links=True) if you trust it"
        )
