"""Outcome of a pinch for its object: held, dropped, turned or crushed."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..checks import finite
from ..dome.dome import SoftBody, lattice
from ..dome.placing import rotation_of
from ..dome.state import DomeState
from ..force_field import ForceField
from .pinch import FACING, Pinch
from .state import PinchState

Array = NDArray[np.float64]

Outcome = Literal["held", "dropped", "turned", "crushed"]


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of slide, turn and pressure that a grasp must keep.

    Attributes
    ----------
    slide: slide beyond which the object counts as dropped [m]
    turn: turn about the axis of the pinch, without elastic twist, beyond which it counts as turned
        [rad]
    pressure: mean pressure of a contact beyond which it counts as crushed [Pa]
    """

    slide: float = 5e-3
    turn: float = math.radians(20.0)
    pressure: float = math.inf

    def __post_init__(self) -> None:
        finite("largest slide", self.slide, "m", above=0.0)
        finite("largest turn", self.turn, "rad", above=0.0)


@dataclass(frozen=True, kw_only=True)
class PinchRecord:
    """Slide, turn and pressure of an object in a pinch so far.

    Attributes
    ----------
    slide: displacement of the object's origin in the hand across the axis of the pinch, without the
        elastic displacement of the skins [m]
    turn: turn of the object about that axis, without elastic twist [rad]
    elastic: mean elastic twist of both skins [rad]
    pressure: mean pressure of the more pressed contact, see `mean_pressure` [Pa]
    largest_turn, largest_pressure: largest values so far
    dropped: whether it slid too far, or left the fingertips above the table
    """

    slide: float = 0.0
    turn: float = 0.0
    elastic: float = 0.0
    pressure: float = 0.0
    largest_turn: float = 0.0
    largest_pressure: float = 0.0
    dropped: bool = False

    def outcome(self, limits: Limits) -> Outcome:
        """Worst outcome so far."""
        if self.dropped:
            return "dropped"
        if self.largest_pressure > limits.pressure:
            return "crushed"
        return "turned" if self.largest_turn > limits.turn else "held"


def follow_pinch(
    record: PinchRecord,
    pinch: Pinch,
    state: PinchState,
    fields: tuple[ForceField, ForceField],
    limits: Limits,
) -> PinchRecord:
    """Update a record by the state after a step.

    Parameters
    ----------
    fields: contact forces of both fingertips in the state, each in its own frame
    """
    domes, states = (pinch.first, pinch.second), (state.first, state.second)
    skins = [_moved(*each) for each in zip(domes, states, fields, strict=True)]
    # The second fingertip is turned about x: a turn about its z is one backwards.
    elastic = 0.5 * (skins[0][1] - skins[1][1])
    way = 0.5 * (skins[0][0] + FACING * skins[1][0])
    place = state.first.place
    # Fingertip axes are those of the hand, so x and y of a position are the same in both.
    moved = place[:2] - np.array(pinch.beside) - way[:2]
    slide = float(np.linalg.norm(moved))
    r = state.first.rotation
    whole = record.turn + record.elastic
    r = r @ rotation_of(np.array([0.0, 0.0, 0.0, *pinch.turned])).T
    angle = math.atan2(r[1, 0] - r[0, 1], r[0, 0] + r[1, 1])
    turn = whole + math.remainder(angle - whole, 2.0 * math.pi) - elastic
    pressure = max(mean_pressure(*each) for each in zip(domes, fields, strict=True))
    free = not any(field.contact.any() for field in fields)
    fell = free and pinch.table and state.support == 0.0
    return PinchRecord(
        slide=slide,
        turn=turn,
        elastic=elastic,
        pressure=pressure,
        largest_turn=max(record.largest_turn, abs(turn)),
        largest_pressure=max(record.largest_pressure, pressure),
        dropped=record.dropped or fell or slide > limits.slide,
    )


def mean_pressure(dome: SoftBody, field: ForceField) -> float:
    """Mean pressure of a contact [Pa]; 0 without contact.

    It is 8/9 of Σ(Fn·p)/ΣFn, with force Fn and pressure p of each node. For a Hertz contact this is
    ΣFn over its area, and it does not jump where a ring of nodes joins the contact.
    """
    on = field.contact
    if not on.any():
        return 0.0
    normal = field.normal[on]
    return float(8.0 / 9.0 * (normal**2 / lattice(dome).areas[on]).sum() / normal.sum())


def _moved(dome: SoftBody, state: DomeState, field: ForceField) -> tuple[Array, float]:
    """Displacement of the skin in contact [m] and its twist about z [rad], weighted by Fn."""
    on = field.contact
    if not on.any():
        return np.zeros(3), 0.0
    weight = field.normal[on] / field.normal[on].sum()
    u, at = state.displacement[on], lattice(dome).points[on]
    mean = weight @ u
    arm = (at - weight @ at)[:, :2]
    across = arm[:, 0] * (u - mean)[:, 1] - arm[:, 1] * (u - mean)[:, 0]
    size = float(weight @ (arm**2).sum(axis=1))
    return mean, float(weight @ across) / size if size > 0.0 else 0.0
