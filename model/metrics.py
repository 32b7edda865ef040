"""Measured words of a grasp, all from truth: lateral displacement, rigid slip, pressure."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .force_field import ForceField
from .state import State

#: Lateral displacement above which a grasp counts as gross slip [m].
GROSS_SLIP = 0.2e-3


@dataclass(frozen=True, kw_only=True)
class SlipRecord:
    """Slip of an object over the fingertip up to now.

    Attributes
    ----------
    origin: object − node along x when each node's contact began, less `slid` of then [m], NaN out
        of contact, (N,)
    current: min over nodes in contact of |object − node|, each since its contact began [m]
    lateral_displacement: maximum of `current` so far [m]
    rigid_slip: ∫ min over contact nodes of |relative tangential speed| dt [m]
    slid: the same with its sign, since there is a contact [m]
    """

    origin: NDArray[np.float64]
    current: float = 0.0
    lateral_displacement: float = 0.0
    rigid_slip: float = 0.0
    slid: float = 0.0


def no_slip(nodes: int) -> SlipRecord:
    """Record of a grasp that has not begun."""
    return SlipRecord(origin=np.full(nodes, np.nan))


def follow_slip(record: SlipRecord, state: State, field: ForceField, dt: float) -> SlipRecord:
    """Record after a step of `dt` seconds that ended in `state` with contact forces `field`.

    A round object that slides takes its contact along: nodes at the back leave, others join at the
    front. Those take over how far the whole contact has slid; counted from zero, they would hide
    slip of any length.
    """
    touching = field.contact
    offset = state.deformation.object_position - state.deformation.nodes[:, 0]
    if not touching.any():
        return replace(record, origin=np.full_like(offset, np.nan), current=0.0, slid=0.0)
    rates = state.slip_rate[touching]
    step = float(rates[np.abs(rates).argmin()]) * dt
    slid = record.slid + step
    begun = np.where(np.isnan(record.origin), offset - slid, record.origin)
    origin = np.where(touching, begun, np.nan)
    current = float(np.abs(offset - origin)[touching].min())
    return SlipRecord(
        origin=origin,
        current=current,
        lateral_displacement=max(record.lateral_displacement, current),
        rigid_slip=record.rigid_slip + abs(step),
        slid=slid,
    )


def pressure(field: ForceField, pitch: float = 0.0) -> float:
    """ΣFn over the deformed distance of the outermost nodes in contact [N/m] (thesis Eq. 11, E3).

    Parameters
    ----------
    field: contact forces
    pitch: node pitch to add to the width [m]; with it, one node in contact has a width too

    Returns
    -------
    Pressure; 0 without contact, NaN where the contact has no width.
    """
    touching = field.position[field.contact, 0]
    if touching.size == 0:
        return 0.0
    width = float(touching.max() - touching.min()) + pitch
    return field.total_normal / width if width > 0.0 else float("nan")
