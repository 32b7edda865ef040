"""Status of a gripped object, with one finger or with two."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import UserError
from ..loop.rig import Rig
from ..model.pinch import Outcome
from ..scene.scene import Scene


@dataclass(frozen=True, kw_only=True)
class GripStatus:
    """Status of an object so far.

    Attributes
    ----------
    slid: sliding of the whole contact [m]; with two fingers, the larger one
    touched: whether the finger touches the object; with two fingers, whether both do
    outcome: `held`, `dropped`, `turned` or `crushed`
    unpaid: whether the outcome still has to cost `DROP_COST`, because sliding has not cost it
    truth: true values of this frame, for `info`
    """

    slid: float
    touched: bool
    outcome: Outcome
    unpaid: bool
    truth: dict[str, Any]


def status_of(rig: Rig, dropped: float, was_touched: bool) -> GripStatus:
    """Status of the object at a rig's frame.

    Parameters
    ----------
    rig: rig of the grasp
    dropped: sliding that counts as a drop with one finger [m]; a pinch has limits of its own
    was_touched: whether the object was touched in a frame before
    """
    return {1: _status_of_one, 2: _status_of_two}[rig.scene.fingers](rig, dropped, was_touched)


def _status_of_one(rig: Rig, dropped: float, was_touched: bool) -> GripStatus:
    contact = rig.truth
    slid, touched = float(contact.slip.rigid_slip), bool(contact.field.contact.any())
    load, now = rig.scene.load, rig.time + 1e-9
    pulled = load.force(now) != 0.0 or load.sideways(now) != 0.0
    let_go = was_touched and pulled and not touched
    return GripStatus(
        slid=slid,
        touched=touched,
        outcome="dropped" if let_go or slid >= dropped else "held",
        unpaid=let_go,
        truth={
            "margin_true": float(contact.field.safety_margin(contact.friction)),
            "rigid_slip_mm": 1e3 * slid,
        },
    )


def _status_of_two(rig: Rig, dropped: float, was_touched: bool) -> GripStatus:
    fingers, record = rig.truth.fingers, rig.truth.record
    slid = max(float(each.slip.rigid_slip) for each in fingers)
    outcome = record.outcome(rig.scene.pinch.limits)
    margins = [float(each.field.safety_margin(each.friction)) for each in fingers]
    return GripStatus(
        slid=slid,
        touched=all(bool(each.field.contact.any()) for each in fingers),
        outcome=outcome,
        unpaid=outcome != "held",
        truth={
            "margin_true": float(np.min(margins)),  # NaN with a finger without contact
            "rigid_slip_mm": 1e3 * slid,
            "outcome": outcome,
            "slide_mm": 1e3 * record.slide,
            "turn_deg": math.degrees(record.turn),
            "pressure_kpa": 1e-3 * record.pressure,
        },
    )


def limit_of(scene: Scene, dropped_mm: float | None) -> float:
    """Sliding that counts as a drop [m].

    Parameters
    ----------
    scene: scene that is gripped
    dropped_mm: given limit [mm]; None: 1, or the scene's with two fingers

    Raises
    ------
    UserError
        For a given limit with two fingers, whose scene has one.
    """
    if scene.fingers == 1:
        return 1e-3 * (dropped_mm or 1.0)
    if dropped_mm is not None:
        raise UserError(
            f"dropped_mm = {dropped_mm} is for one finger; with two, change pinch.dropped_mm"
        )
    return 1e-3 * scene.pinch.dropped_mm
