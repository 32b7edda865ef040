"""Copies of the user's own sensors in a dataset, so that it can be read wherever it is moved to.

sensors/mine/        mine.toml, and the files that it names
"""

from pathlib import Path

import tomli_w

from ..errors import UserError
from ..output.folder import disk_errors, write_whole
from ..render import FILES_NAMED
from ..strict_toml import read_toml
from .folder import RECIPE, SENSORS
from .recipe import Recipe, with_sensors


def keep_sensors(recipe: Recipe, folder: Path) -> Recipe:
    """Copy the user's own sensors into a dataset; returns the recipe that names the copies.

    Raises
    ------
    UserError
        When two sensors have one name, a file cannot be read or written, or the folder holds a
        dataset of another sensor.
    """
    sensors: dict[str, Path] = {}

    def copy(name: str) -> str:
        path = Path(name)
        place = f"{SENSORS}/{path.stem}/{path.name}"
        if sensors.setdefault(place, path) != path:
            raise UserError(f"a dataset takes one sensor of a name; there are two {path.name}")
        return str(folder.absolute() / place)

    kept = with_sensors(recipe, copy)
    files = {
        f"{SENSORS}/{path.stem}/{file}": data
        for path in sensors.values()
        for file, data in _files(path).items()
    }
    begun = (folder / RECIPE).exists()
    for place, data in files.items():
        target = folder / place
        if begun:
            if not target.is_file() or target.read_bytes() != data:
                raise UserError(f"{folder} holds a dataset of another sensor: {place} differs")
            continue
        with disk_errors(target):
            target.parent.mkdir(parents=True, exist_ok=True)
        write_whole(target, data)
    return kept


def _files(path: Path) -> dict[str, bytes]:
    """A sensor's file and those that it names, by name in one folder."""
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
