"""A folder of presses: pictures of the sensor at rest and under known presses, and their list."""

import csv
import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import UserError, located
from ..output.processes import one_thread
from ..pictures.noise_level import noise_level
from ..render import Frame, SensorDesign
from ..sources.picture_files import is_picture, read_picture
from ..strange_files import need_file
from ..tracking import Palette, Tracks, load_tracker
from ..tracking.forces import rest_pose

#: File of a folder of presses that lists them.
LIST = "presses.csv"
#: Columns of a list of presses by force, next to `file`; the second is optional (default 0).
BY_FORCE = ("normal_n", "lateral_n")
#: Optional columns of a list by force, for a dome of silicone; 0 if missing or empty.
ON_SILICONE = ("torque_nmm", "radius_mm")
#: Columns of a list of presses by displacement, likewise.
BY_PLACE = ("depth_mm", "shear_mm")


@dataclass(frozen=True, kw_only=True)
class Press:
    """A picture of the sensor pressed by a plate or ball first, then pulled along its x and turned.

    Attributes
    ----------
    name: name of the picture
    normal, lateral: forces [N], or displacements [m]
    torque: torque about the normal, right-handed about the direction out of the dome [N·m]
    radius: radius of the ball [m]; 0: a plate
    """

    name: str
    normal: float
    lateral: float
    torque: float = 0.0
    radius: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Pressed:
    """Tracks of the pictures of a folder.

    Attributes
    ----------
    presses: presses in the order in which they were tracked
    rest: tracks of the unloaded sensor
    tracks: tracks of each press
    noise: standard deviation of a pixel [grey levels]
    """

    presses: list[Press]
    rest: Tracks
    tracks: list[Tracks]
    noise: float


def track_presses(
    folder: Path,
    presses: list[Press],
    sensor: SensorDesign,
    tracker: str,
    noise: float | None,
    tell: Callable[[str], None],
    max_megapixels: float,
) -> Pressed:
    """Find and track the markers in the pictures of a folder.

    Parameters
    ----------
    folder: folder with `rest*` pictures and those of the presses
    presses: presses in the order in which they are tracked
    sensor: design, which has the markers' dyes
    tracker: see `load_tracker`
    noise: standard deviation of a pixel [grey levels]; None: estimated from the rest pictures
    tell: function called with the current step, for a progress line
    max_megapixels: largest picture that is decoded [10⁶ pixels]

    Raises
    ------
    UserError
        For a picture that cannot be used, with its name and the reason.
    """
    files = sorted(p for p in folder.iterdir() if is_picture(p) and p.name.startswith("rest"))
    if not files:
        raise UserError(f"folder {folder} has no rest*.png, pictures of the unloaded sensor")
    tell("markers at rest")
    still = [Frame(image=read_picture(path, max_megapixels), time=0.0) for path in files]
    if noise is None:
        noise, _ = noise_level(still, any(".jp" in path.suffix.lower() for path in files))
    follower = load_tracker(tracker)(Palette.of_sensor(sensor), noise)
    period = 1.0  # the tracker needs a time between pictures [s]
    with one_thread():
        rest = follower.reset(still)
        rest_pose(sensor, rest)
        tracks = []
        for number, press in enumerate(presses, 1):
            tell(f"markers in {press.name}, {number} of {len(presses)}")
            image = read_picture(folder / press.name, max_megapixels)
            with located(f"picture {folder / press.name}"):
                tracks.append(follower.update(Frame(image=image, time=number * period)))
    pairs = np.asarray(rest.visible.all(axis=0))
    visible_share = 0.5  # smallest share of the pairs at rest that a picture of a press shows
    for press, now in zip(presses, tracks, strict=True):
        visible = int(now.visible[:, pairs].all(axis=0).sum())
        if visible < visible_share * pairs.sum():
            raise UserError(
                f"picture {folder / press.name} shows {visible} of the {pairs.sum()} marker pairs "
                f"at rest; wanted: at least {visible_share:.0%}"
            )
    return Pressed(presses=presses, rest=rest, tracks=tracks, noise=noise)


def read_list(path: Path) -> tuple[list[Press], bool]:
    """Presses of a list, the lightest first, and whether it gives forces.

    Raises
    ------
    UserError
        With the line and what is wrong with it.
    """
    need_file(path, f"list of presses {path}")
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
    more = ON_SILICONE if by_force else ()
    if not {"file", names[0]} <= set(columns) <= {"file", *names, *more}:
        raise UserError(
            f"list of presses {path} has the columns {', '.join(columns) or 'none'}; wanted: file, "
            f"{', '.join(BY_FORCE)}, or file, {', '.join(BY_PLACE)}; on a dome of silicone also "
            f"{', '.join(ON_SILICONE)}"
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
        torque, radius = (
            1e-3 * _number(row.get(name, "") or "0", name, where) for name in ON_SILICONE
        )
        if not radius >= 0.0:
            raise UserError(f"{where}: radius_mm is {row['radius_mm']}; wanted: 0 or above")
        presses.append(
            Press(name=row["file"], normal=normal, lateral=lateral, torque=torque, radius=radius)
        )
    if not presses:
        raise UserError(f"list of presses {path} has no presses")
    return sorted(presses, key=lambda press: (press.normal, abs(press.lateral))), by_force


def _number(text: str, name: str, where: str) -> float:
    value = math.nan
    with suppress(ValueError):
        value = float(text)
    if not math.isfinite(value):
        raise UserError(f"{where}: {name} is {text!r}, which is no number")
    return value
