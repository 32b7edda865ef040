"""Measures of a grasp from its true state: lateral displacement, rigid slip, pressure."""

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
    """Slip of an object over the fingertip so far.

    Attributes
    ----------
    origin: reference of each node: object minus node along x when its contact began, minus `slid`
        at that time [m]; NaN out of contact, shape (N,)
    current: minimum over the nodes in contact of their slip |object − node − origin| [m]
    lateral_displacement: maximum of `current` so far [m]
    rigid_slip: ∫ min over the nodes in contact of |relative tangential speed| dt [m]
    slid: the same integral with sign, since the contact began [m]
    """

    origin: NDArray[np.float64]
    current: float = 0.0
    lateral_displacement: float = 0.0
    rigid_slip: float = 0.0
    slid: float = 0.0


def no_slip(nodes: int) -> SlipRecord:
    """Slip record at the start of a grasp.

    Parameters
    ----------
    nodes: number of nodes of the chain
    """
    return SlipRecord(origin=np.full(nodes, np.nan))


def follow_slip(
    record: SlipRecord,
    run: History,
    touching: NDArray[np.bool_],
    dt: float,
    kept: Sequence[int] | None = None,
) -> list[SlipRecord]:
    """Update a slip record over the steps of a run; return the records after them.

    The contact of a round object moves with it as it slides: nodes leave at the back, others join
    at the front. New nodes start with the slip of the contact so far; if they started at zero, they
    would hide slip of any length.

    Parameters
    ----------
    record: record before the run
    run: run of the chain with R recorded instants
    touching: whether each node touches the object at each instant, shape (R, N)
    dt: time between instants [s]
    kept: indices, from 1, of the instants to return records for; None: all
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
    """ΣFn over the width between the outermost nodes in contact [N/m] (thesis Eq. 11, E3).

    Parameters
    ----------
    field: contact forces
    pitch: node pitch to add to the width [m]; then a single node in contact has a width too

    Returns
    -------
    Pressure; 0 without contact, NaN where the contact has no width.
    """
    touching = field.position[field.contact, 0]
    if touching.size == 0:
        return 0.0
    width = float(touching.max() - touching.min()) + pitch
    return field.total_normal / width if width > 0.0 else float("nan")
