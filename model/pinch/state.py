"""What a step of a pinch starts from, and how it is kept in a file."""

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
    """All that a step of a pinch starts from.

    Attributes
    ----------
    time: [s]
    first, second: fingertips, each in its own frame; `velocity` of the object is not used
    moving: object in the world
    closing: way on which both fingertips have closed [m]
    drift: velocity of the object in the hand in the last step [m/s, rad/s], shape (6,)
    support: force of the table, against gravity [N]
    level: height of the table, of the object's centre of mass along gravity [m]
    came: way that object and skins came since nodes were looked for [m]; infinite looks anew
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
    """State at the start: both fingertips just touch, nothing moves.

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
    count = len(lattice(dome).ring)

    def zeros() -> Array:
        return np.zeros((count, 3))

    return DomeState(
        time=0.0, place=place, rotation=rotation, velocity=np.zeros(6), displacement=zeros(),
        linear=zeros(), memory=zeros(), forces=zeros(), friction=zeros(), normals=zeros(),
        near=np.zeros(0, np.int64),
    )  # fmt: skip


#: Parts of a state that have fields of their own, with their type.
_PARTS: dict[str, Any] = {"first": DomeState, "second": DomeState, "moving": Moving}


def save_pinch_state(path: str | os.PathLike[str], state: PinchState) -> None:
    """Write a state to an .npz file, whole or not at all."""
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
    """State from a file of `save_pinch_state`.

    Raises
    ------
    UserError: for a file that is not one.
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
    """An array, or the number that one without axes holds."""
    return array if array.ndim else float(array)
