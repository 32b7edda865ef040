"""A folder of presses: pictures of the sensor at rest and under known presses, and their list."""

import csv
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from ..errors import UserError, located
from ..output.pictures import is_picture, read_picture
from ..pictures.noise_level import noise_level
from ..render import Frame, SensorDesign
from ..tracking import Palette, Tracks, load_tracker
from ..tracking.forces.calibration import check_rest

LIST = "presses.csv"
#: Columns of the list beside `file`: a press by force, or by displacement; what is along x may
#: be left out, and is 0 then.
BY_FORCE, BY_PLACE = ("normal_n", "lateral_n"), ("depth_mm", "shear_mm")
#: A press that shows less than this share of the pairs is no picture of this sensor under load.
_SEEN = 0.5
#: Presses are not frames of a video, but a tracker wants a time [s].
_PERIOD = 1.0


@dataclass(frozen=True, kw_only=True)
class Press:
    """A picture and what was done: pressed first, then pulled along the sensor's x.

    Attributes
    ----------
    name: of the picture
    normal, lateral: forces [N], or displacements [m]
    """

    name: str
    normal: float
    lateral: float


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What the pictures of a folder show.

    Attributes
    ----------
    presses: as they were listed
    rest: tracks of the unloaded sensor
    tracks: of each press
    noise: of the camera [grey levels]
    """

    presses: list[Press]
    rest: Tracks
    tracks: list[Tracks]
    noise: float


def see_presses(
    folder: Path,
    presses: list[Press],
    sensor: SensorDesign,
    tracker: str,
    noise: float | None,
    tell: Callable[[str], None],
) -> Seen:
    """Find the markers in the pictures of a folder.

    Parameters
    ----------
    folder: with `rest*` pictures and those of the presses
    presses: in the order in which they are followed
    sensor: design, whose dyes the markers have
    tracker: see `load_tracker`
    noise: of the camera [grey levels]; None estimates it from the rest pictures
    tell: called with what is being done

    Raises
    ------
    UserError
        With the picture and what is wrong with it.
    """
    files = sorted(p for p in folder.iterdir() if is_picture(p) and p.name.startswith("rest"))
    if not files:
        raise UserError(f"folder {folder} has no rest*.png, pictures of the unloaded sensor")
    tell("markers at rest")
    still = [Frame(image=read_picture(path), time=0.0) for path in files]
    if noise is None:
        noise, _ = noise_level(still, any(".jp" in path.suffix.lower() for path in files))
    follower = load_tracker(tracker)(Palette.of_sensor(sensor), noise)
    with threadpool_limits(1):
        rest = follower.reset(still)
        check_rest(sensor, rest)
        tracks = []
        for number, press in enumerate(presses, 1):
            tell(f"markers in {press.name}, {number} of {len(presses)}")
            image = read_picture(folder / press.name)
            with located(f"picture {folder / press.name}"):
                tracks.append(follower.update(Frame(image=image, time=number * _PERIOD)))
    whole = np.asarray(rest.visible.all(axis=0))
    for press, now in zip(presses, tracks, strict=True):
        seen = int(now.visible[:, whole].all(axis=0).sum())
        if seen < _SEEN * whole.sum():
            raise UserError(
                f"picture {folder / press.name} shows {seen} of the {whole.sum()} marker pairs at "
                f"rest; wanted: at least {_SEEN:.0%}"
            )
    return Seen(presses=presses, rest=rest, tracks=tracks, noise=noise)


def read_list(path: Path) -> tuple[list[Press], bool]:
    """Presses of a list, the lightest first, and whether it gives forces.

    Raises
    ------
    UserError
        With the line and what is wrong with it.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file, strict=True)
            columns, rows = tuple(reader.fieldnames or ()), list(reader)
    except OSError as error:
        raise UserError(f"list of presses {path} cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise UserError(f"list of presses {path} is not CSV: {error}") from None
    by_force = BY_FORCE[0] in columns
    names = BY_FORCE if by_force else BY_PLACE
    if not {"file", names[0]} <= set(columns) <= {"file", *names}:
        raise UserError(
            f"list of presses {path} has the columns {', '.join(columns) or 'none'}; wanted: file, "
            f"{', '.join(BY_FORCE)}, or file, {', '.join(BY_PLACE)}"
        )
    unit = 1.0 if by_force else 1e-3
    presses = []
    for line, row in enumerate(rows, 2):
        where = f"line {line} of {path}"
        if None in row or None in row.values():
            raise UserError(f"{where} has not {len(columns)} values, as the first line has")
        if not is_picture(Path(row["file"])):
            raise UserError(f"{where}: file {row['file']!r} is no picture")
        normal, lateral = (unit * _number(row.get(name, "0"), name, where) for name in names)
        if not normal > 0.0:
            raise UserError(f"{where}: {names[0]} is {row[names[0]]}; wanted: above 0")
        presses.append(Press(name=row["file"], normal=normal, lateral=lateral))
    if not presses:
        raise UserError(f"list of presses {path} has no presses")
    return sorted(presses, key=lambda press: (press.normal, abs(press.lateral))), by_force


def _number(text: str, name: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UserError(f"{where}: {name} is {text!r}, which is no number")
    return value
