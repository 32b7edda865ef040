"""Measures of a grasp, from the true state: lateral displacement, rigid slip, pressure."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..force_field import ForceField
from ..kernels.slip_kernels import slip_steps
from .plant import History

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
    """Record of a grasp that has not begun.

    Parameters
    ----------
    nodes: number of the chain's nodes
    """
    return SlipRecord(origin=np.full(nodes, np.nan))


def follow_slip(
    record: SlipRecord,
    run: History,
    touching: NDArray[np.bool_],
    dt: float,
    kept: Sequence[int] | None = None,
) -> list[SlipRecord]:
    """Records of slip after some steps of a run.

    A round object that slides takes its contact along: nodes at the back leave, others join at the
    front. New nodes start from the slip of the contact so far; counted from zero, they would hide
    slip of any length.

    Parameters
    ----------
    record: before the run
    run: of the chain, R instants
    touching: whether each node touches the object at each instant, shape (R, N)
    dt: from instant to instant [s]
    kept: numbers of the instants that records are wanted of, from 1; None is each
    """
    origin, now = np.empty((len(run), len(record.origin))), np.empty((len(run), 4))
    origin[0] = record.origin
    now[0] = record.current, record.lateral_displacement, record.rigid_slip, record.slid
    slip_steps(origin, now, run.nodes, run.pose[:, 1], run.slip_rate, touching, dt)
    records = []
    for k in range(1, len(run)) if kept is None else kept:
        current, lateral, rigid, slid = now[k].tolist()
        records.append(
            SlipRecord(
                origin=origin[k].copy(),
                current=current,
                lateral_displacement=lateral,
                rigid_slip=rigid,
                slid=slid,
            )
        )
    return records


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
