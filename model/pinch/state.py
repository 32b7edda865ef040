"""State from which a step of a pinch starts, and its files."""

import math
import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...folders import write_arrays
from ...strange_files import array_names, read_arrays
from ..dome.dome import SoftBody, lattice
from ..dome.placing import rotation_of
from ..dome.state import DomeState
from .body import Moving, at_rest
from .pinch import FACING, Pinch, bases

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class PinchState:
    """Everything that a step of a pinch starts from.

    Attributes
    ----------
    time: time of the state [s]
    first, second: states of the fingertips, each in its own frame; `velocity` is not used
    moving: state of motion of the object in the world
    closing: distance by which each fingertip has closed [m]
    drift: velocity [m/s] and angular velocity [rad/s] of the object in the hand in the last step,
        shape (6,)
    support: force of the table, against gravity [N]
    level: coordinate of the centre of mass along gravity at which the table starts to push [m]
    came: distance that object and skins have moved since the active nodes were chosen [m];
        infinite: choose them in the next step
    """

    time: float
    first: DomeState
    second: DomeState
    moving: Moving
    closing: float
    drift: Array
    support: float
    level: float
    came: float


def pinch_rest(pinch: Pinch) -> PinchState:
    """State at the start: both fingertips just touch the object, nothing moves.

    Raises
    ------
    UserError: where the object cannot lie on a fingertip
    """
    base, place = bases(pinch), np.array([*pinch.beside, 0.0])
    rotation = rotation_of(np.array([0.0, 0.0, 0.0, *pinch.turned]))
    origin, turn = pinch.hand.at(0.0)
    centre = origin + turn @ (place + rotation @ np.array(pinch.body.centre))
    weight = pinch.body.mass * float(np.linalg.norm(pinch.gravity)) if pinch.table else 0.0
    gives = weight / pinch.table_stiffness if pinch.table else 0.0
    level = float(pinch.down @ centre) - gives if pinch.table else 0.0
    return PinchState(
        time=0.0,
        first=_untouched(pinch.first, place - base[0], rotation),
        second=_untouched(pinch.second, FACING * (place - base[1]), FACING[:, None] * rotation),
        moving=at_rest(centre, turn @ rotation),
        closing=0.0,
        drift=np.zeros(6),
        support=weight,
        level=level,
        came=math.inf,
    )


def _untouched(dome: SoftBody, place: Array, rotation: Array) -> DomeState:
    """State of an undeformed fingertip with the object at a pose."""
    count = len(lattice(dome).ring)

    def zeros() -> Array:
        return np.zeros((count, 3))

    return DomeState(
        time=0.0, place=place, rotation=rotation, velocity=np.zeros(6), displacement=zeros(),
        linear=zeros(), memory=zeros(), forces=zeros(), friction=zeros(), normals=zeros(),
        near=np.zeros(0, np.int64),
    )  # fmt: skip


#: Fields of a state that consist of several arrays, with their type.
_PARTS: dict[str, Any] = {"first": DomeState, "second": DomeState, "moving": Moving}


def save_pinch_state(path: str | os.PathLike[str], state: PinchState) -> None:
    """Write a state to an .npz file atomically."""
    arrays: dict[str, Any] = {}
    for each in fields(state):
        value = getattr(state, each.name)
        if each.name not in _PARTS:
            arrays[each.name] = np.asarray(value)
            continue
        for inner in fields(value):
            arrays[f"{each.name}.{inner.name}"] = np.asarray(getattr(value, inner.name))
    write_arrays(Path(path), arrays)


def load_pinch_state(path: str | os.PathLike[str]) -> PinchState:
    """Read a state from a file of `save_pinch_state`.

    Raises
    ------
    UserError: for any other file.
    """
    try:
        stored, values = read_arrays(Path(path), array_names(Path(path))), dict[str, Any]()
        for each in fields(PinchState):
            part = _PARTS.get(each.name)
            if part is None:
                values[each.name] = _plain(stored[each.name])
                continue
            inner = {f.name: _plain(stored[f"{each.name}.{f.name}"]) for f in fields(part)}
            values[each.name] = part(**inner)
        return PinchState(**values)
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(f"{os.fspath(path)} is no state of a pinch: {error}") from None


def _plain(array: Array) -> Any:
    """Return an array, or its value as a float if it has no axes."""
    return array if array.ndim else float(array)
