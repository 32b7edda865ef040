"""Observations of an environment: one array for each choice of observation.

Arrays of two fingers are stacked, with the first finger's first.

Unknown values are 0. Bounds are finite, and values are clipped to them.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from ..control import GripObservation
from ..errors import UserError
from ..scene.scene import Scene
from ..sensing.reader import Reading
from ..tracking import Tracks

#: Observations that can be chosen.
ObservationName = Literal["image", "markers", "forces", "margin"]

Values = NDArray[np.float32]
Image = NDArray[np.uint8]

#: Columns of `margin` with their bounds.
MARGIN = {
    "margin": (-10.0, 1.0),
    "margin_low": (-10.0, 1.0),
    "margin_high": (-10.0, 1.0),
    "grip_n": (0.0, 100.0),
    "known": (0.0, 1.0),
}
#: Columns of `forces` with their bounds.
FORCES = {
    "normal_n": (-100.0, 100.0),
    "friction_n": (-100.0, 100.0),
    "normal_deviation_n": (0.0, 100.0),
    "friction_deviation_n": (0.0, 100.0),
    "mu": (0.0, 10.0),
    "mu_low": (0.0, 10.0),
    "mu_high": (0.0, 10.0),
    "force_x_n": (-100.0, 100.0),
    "force_y_n": (-100.0, 100.0),
    "force_z_n": (-100.0, 100.0),
    "torque_nmm": (-1000.0, 1000.0),
    "grip_n": (0.0, 100.0),
    "known": (0.0, 1.0),
}
#: Largest shift of a marker along x and y [px], and logarithm of its growth, in `markers`.
_MOST = (100.0, 100.0, 3.0)


@dataclass(frozen=True, kw_only=True)
class ObservationKind:
    """A choice of observation.

    Attributes
    ----------
    space: space of its arrays
    observed: function of a reading and the commanded grip [N] that makes a new array
    """

    space: Box
    observed: Callable[[Reading, float], NDArray[np.generic]]


def observation_of(name: ObservationName, scene: Scene, rest: Tracks | None) -> ObservationKind:
    """Make the observation of that name.

    Parameters
    ----------
    name: name of the observation
    scene: scene that is gripped
    rest: tracks at rest; needed for `markers`
    """
    if name == "image":
        view = scene.build_sensor().view
        space = Box(0, 255, (view.height, view.width, 3), np.uint8)
        return ObservationKind(space=space, observed=_image)
    if name == "markers":
        assert rest is not None
        most = np.tile(np.array(_MOST, np.float32), rest.visible.size)
        return ObservationKind(space=Box(-most, most, dtype=np.float32), observed=_markers)
    columns, values = (MARGIN, _margin) if name == "margin" else (FORCES, _forces)
    low, high = np.array(list(columns.values()), np.float32).T

    def observed(reading: Reading, grip: float) -> Values:
        assert reading.held is not None
        known = np.nan_to_num(
            np.array(values(reading.held, grip)), nan=0.0, posinf=math.inf, neginf=-math.inf
        )
        clipped: Values = np.clip(known, low, high).astype(np.float32)
        return clipped

    return ObservationKind(space=Box(low, high, dtype=np.float32), observed=observed)


def space_of(kinds: Sequence[ObservationKind]) -> Box:
    """Space of one finger's observation, or of two, with an axis of length 2 in front.

    Raises
    ------
    UserError
        For two fingers whose arrays differ in shape.
    """
    spaces = [kind.space for kind in kinds]
    if len(spaces) == 1:
        return spaces[0]
    first, second = (space.shape for space in spaces)
    if first != second:
        raise UserError(
            f"the two sensors' observations have the shapes {first} and {second}, which cannot be "
            "stacked; choose another observation or another pinch.second_sensor"
        )
    low, high = (np.stack(ends) for ends in zip(*((s.low, s.high) for s in spaces), strict=True))
    return Box(low, high, dtype=low.dtype.type)


def observed(
    kinds: Sequence[ObservationKind], seen: Sequence[Reading], grip: float
) -> NDArray[np.generic]:
    """Make the observation of one finger or two, as in `space_of`."""
    arrays = [kind.observed(each, grip) for kind, each in zip(kinds, seen, strict=True)]
    return arrays[0] if len(arrays) == 1 else np.stack(arrays)


def _image(reading: Reading, _: float) -> Image:
    assert reading.frame is not None
    return reading.frame.image.copy()


def _markers(reading: Reading, _: float) -> Values:
    """Shift of each marker from rest along x and y [px], and growth; 0 if it is not visible.

    The outer layer comes first, with three numbers a marker.
    """
    tracks, rest = reading.tracks, reading.rest
    assert tracks is not None
    assert rest is not None
    values = np.empty((*tracks.visible.shape, 3))
    values[..., :2] = tracks.position - rest.position
    values[..., 2] = tracks.log_size
    values[~tracks.visible] = 0.0
    clipped: Values = np.clip(np.nan_to_num(values), np.negative(_MOST), _MOST).astype(np.float32)
    return clipped.reshape(-1)


def _margin(now: GripObservation, grip: float) -> tuple[float, ...]:
    return (now.margin, *now.margin_interval, grip, float(not now.no_estimate))


def _forces(now: GripObservation, grip: float) -> tuple[float, ...]:
    normal, friction = np.sqrt(np.maximum(np.diag(now.field.totals_covariance), 0.0)).tolist()
    return (
        now.field.total_normal,
        now.field.total_friction,
        normal,
        friction,
        now.friction,
        *now.friction_interval,
        *now.force.tolist(),
        1e3 * now.torque,
        grip,
        float(not now.no_estimate),
    )
