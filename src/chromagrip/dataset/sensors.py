"""Sensors of one's own in a dataset: copied into it, so that it is read wherever it lies.

sensors/mine/        mine.toml, and the files that it names
"""

import tomllib
from pathlib import Path

import tomli_w

from ..errors import UserError
from ..output.folder import write_whole
from ..render.design.sensor import FILES_NAMED
from .folder import RECIPE, SENSORS
from .recipe import Recipe, with_sensors


def keep_sensors(recipe: Recipe, folder: Path) -> Recipe:
    """Copy sensors of one's own into a dataset's folder; returns the recipe that names the copies.

    Raises
    ------
    UserError
        When two have one name, or the folder holds a dataset of another.
    UserError
        When the folder cannot be written.
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
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(f"{target} cannot be written: {error.strerror}") from None
        write_whole(target, data)
    return kept


def _files(path: Path) -> dict[str, bytes]:
    """A sensor's file and those that it names, as they lie in one folder."""
    try:
        data = path.read_bytes()
        values = tomllib.loads(data.decode())
        beside: dict[str, bytes] = {}
        for table, key in FILES_NAMED:
            if name := values.get(table, {}).get(key):
                other = path.parent / name
                if other.name in (path.name, *beside):
                    raise UserError(f"it names two files called {other.name}")
                beside[other.name] = other.read_bytes()
                values[table][key] = other.name
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UserError(f"sensor file {path} cannot be copied: {reason}") from None
    return {path.name: tomli_w.dumps(values).encode() if beside else data, **beside}
