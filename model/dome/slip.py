"""Slip of an object over a dome, with the same measures as `chain.metrics`."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..force_field import ForceField
from ..kernels.dome.contact_slip_kernels import add_slip
from .dome import SoftBody, lattice
from .state import DomeState

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class DomeSlip:
    """Slip of an object over a dome so far.

    Attributes
    ----------
    path: slip of the object over each node, along the surface, since the contact began [m], shape
        (N, 3); NaN out of contact
    current: minimum of |path| over the nodes in contact [m]
    lateral_displacement: maximum of `current` so far [m]
    rigid_slip: sum over the steps of the smallest slip of a node in contact [m]
    """

    path: Array
    current: float = 0.0
    lateral_displacement: float = 0.0
    rigid_slip: float = 0.0


def no_dome_slip(dome: SoftBody) -> DomeSlip:
    """Slip record at the start of a grasp."""
    return DomeSlip(path=np.full_like(lattice(dome).points, np.nan))


def follow_dome_slip(
    record: DomeSlip, dome: SoftBody, before: DomeState, after: DomeState, field: ForceField
) -> DomeSlip:
    """Update a slip record by one step.

    A node that joins the contact starts with the slip of the contact so far, as on the chain. Under
    an object that only turns about its contact one point is at rest, usually between nodes: this is
    no slip.

    Parameters
    ----------
    before, after: states at the start and the end of the step
    field: contact forces of the state `after`
    """
    touching, path = np.flatnonzero(field.contact), np.full_like(record.path, np.nan)
    if not len(touching):
        return DomeSlip(
            path=path,
            lateral_displacement=record.lateral_displacement,
            rigid_slip=record.rigid_slip,
        )
    nearest = 0.6  # how far a point of the skin may be from the nearest node [pitches]
    # What touched in neither state has not moved in contact: its path begins after this step.
    least, slides = add_slip(
        record.path, touching, lattice(dome).points, before.displacement, after.displacement,
        after.normals, (before.rotation, before.place), (after.rotation, after.place),
        nearest * dome.spacing, path,
    )  # fmt: skip
    return DomeSlip(
        path=path,
        current=least,
        lateral_displacement=max(record.lateral_displacement, least),
        rigid_slip=record.rigid_slip + slides,
    )
