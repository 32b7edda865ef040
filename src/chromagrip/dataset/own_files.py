"""Copies of the user's own files in a dataset, so that it can be read anywhere.

sensors/mine/        mine.toml, and the files that it names
objects/             meshes
"""

from pathlib import Path

import tomli_w

from ..errors import UserError
from ..folders import disk_errors, write_whole
from ..render import FILES_NAMED
from ..strict_toml import read_toml
from .folder import OBJECTS, RECIPE, SENSORS
from .recipe import Recipe, with_files


def keep_files(recipe: Recipe, folder: Path) -> Recipe:
    """Copy the user's own sensors and meshes into a dataset; returns the recipe of the copies.

    Raises
    ------
    UserError
        When two files have one name, one cannot be read or written, or the folder holds a dataset
        of another sensor or mesh.
    """
    origins: dict[str, Path] = {}

    def copy(name: str) -> str:
        path = Path(name)
        sensor = path.suffix == ".toml"
        place = f"{SENSORS}/{path.stem}/{path.name}" if sensor else f"{OBJECTS}/{path.name}"
        if origins.setdefault(place, path) != path:
            what = "sensor" if sensor else "mesh"
            raise UserError(f"a dataset takes one {what} of a name; there are two {path.name}")
        return str(folder.absolute() / place)

    kept = with_files(recipe, copy)
    files: dict[str, bytes] = {}
    for place, path in origins.items():
        own = _files(path) if path.suffix == ".toml" else {path.name: _bytes(path)}
        files |= {f"{Path(place).parent.as_posix()}/{name}": data for name, data in own.items()}
    begun = (folder / RECIPE).exists()
    for place, data in files.items():
        target = folder / place
        if begun:
            if not target.is_file() or target.read_bytes() != data:
                what = "sensor" if place.startswith(SENSORS) else "mesh"
                raise UserError(f"{folder} holds a dataset of another {what}: {place} differs")
            continue
        with disk_errors(target):
            target.parent.mkdir(parents=True, exist_ok=True)
        write_whole(target, data)
    return kept


def _files(path: Path) -> dict[str, bytes]:
    """Read a sensor's file and those that it names, by name in one folder."""
    values = read_toml(path, f"sensor file {path}")
    beside: dict[str, bytes] = {}
    for table, key in FILES_NAMED:
        if name := values.get(table, {}).get(key):
            other = path.parent / name
            if other.name in (path.name, *beside):
                raise UserError(
                    f"sensor file {path} cannot be copied: it names two files called {other.name}"
                )
            beside[other.name] = _bytes(other)
            values[table][key] = other.name
    return {path.name: tomli_w.dumps(values).encode() if beside else _bytes(path), **beside}


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise UserError(f"file {path} cannot be read: {error.strerror}") from None
