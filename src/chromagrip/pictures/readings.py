"""Rows of estimates: forces with µ and Γ of a dome, or displacements of a flat pad."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..control import GripObservation
from ..errors import UserError
from ..loop.force_row import force_row
from ..output.parquet import Row
from ..render import Frame, View
from ..sensing.reader import Reader
from ..tracking import DEFAULT_TRACKER, DisplacementGains, FrictionRule, Tracks
from ..tracking.forces import CameraPose, aligned, alignment, seen_by, skin_displacement
from .figure import draw_forces
from .opening import Opened
from .overlay import Magnification, TrackDrawing


class Shown(NamedTuple):
    """A frame's row of the table, what draws the frame with its estimates, and what was seen.

    There is no observation of a flat pad.
    """

    row: Row
    draw: Callable[[], NDArray[np.uint8]]
    observation: GripObservation | None = None


#: Called with each frame and its tracks.
Read = Callable[[Frame, Tracks], Shown]


def force_reading(
    reader: Reader, rule: FrictionRule, opened: Opened, view: View, pose: CameraPose
) -> Read:
    """Reading of forces, µ and Γ.

    Parameters
    ----------
    reader: of the sensor, with its forces
    rule: how µ is read off the forces
    opened: tracker and frames
    view: of the design's camera
    pose: of the camera that took the frames

    Raises
    ------
    UserError
        When the tracker does not measure what forces are read from.
    """
    rest = opened.resting
    pairs = rest.visible.all(axis=0) if len(rest.visible) == 2 else np.zeros(0, dtype=bool)
    if not pairs.any() or not np.isfinite(rest.covariance[pairs]).all():
        raise UserError(
            f"tracker {opened.setup['tracker']!r} does not estimate the covariances of places and "
            f"sizes, which forces are read from; wanted: {DEFAULT_TRACKER}"
        )

    motion = Magnification(rest)

    def place(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return seen_by(pose, view.camera, view.project(points))

    def read(frame: Frame, tracks: Tracks) -> Shown:
        observation = reader.read(frame, tracks).observation
        assert observation is not None
        row = force_row(observation, rule)
        row["markers_seen"] = _visible_pairs(tracks)

        def draw() -> NDArray[np.uint8]:
            factor = motion.after(tracks)
            return draw_forces(frame.image, place, tracks, rest, observation, factor)

        return Shown(row, draw, observation)

    return read


def _visible_pairs(tracks: Tracks) -> int:
    return int(tracks.visible.all(axis=0).sum())


def displacement_reading(
    gains: DisplacementGains, opened: Opened, view: View, pose: CameraPose
) -> Read:
    """Reading of a flat pad's displacements, with its gains.

    Parameters
    ----------
    gains: from the image of the design's camera to displacements
    opened: tracker and frames
    view: of the design's camera
    pose: of the camera that took the frames
    """
    align = alignment(pose, view.camera, opened.resting.position)
    rest = aligned(align, opened.resting)
    draw = TrackDrawing(opened.palette, opened.start, opened.resting)

    def read(frame: Frame, tracks: Tracks) -> Shown:
        row = _displacement_row(gains, rest, aligned(align, tracks))
        return Shown(row, lambda: draw(frame.image, tracks))

    return read


def _displacement_row(gains: DisplacementGains, rest: Tracks, tracks: Tracks) -> Row:
    displacement, covariance = skin_displacement(gains, rest, tracks)
    row: Row = {"markers_seen": _visible_pairs(tracks)}
    known = displacement[np.isfinite(displacement).all(axis=1)]
    if not len(known):
        row["no_estimate"] = "no marker of the outer layer is visible with its hue or size"
        return row
    # Quantile of the markers' depths that stands for the pad: a single marker's error does not
    # count.
    quantile = 0.95
    deep = float(np.quantile(known[:, 2], quantile))
    shift_x, shift_y = known[known[:, 2] >= min(0.5 * deep, deep), :2].mean(axis=0).tolist()
    row["depth_mm"], row["shift_x_mm"], row["shift_y_mm"] = 1e3 * deep, 1e3 * shift_x, 1e3 * shift_y
    row["deviation_mm"] = 1e3 * float(np.sqrt(np.nanmedian(covariance[:, 2, 2])))
    row["no_estimate"] = ""
    for name, column in zip(["x_mm", "y_mm", "depth_mm"], displacement.T, strict=True):
        row[f"marker_{name}"] = (1e3 * column).astype(np.float32)
    return row
