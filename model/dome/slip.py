"""Slip of an object over a dome, with the same measures as `chain.metrics`."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..force_field import ForceField
from .dome import SoftBody, lattice
from .state import DomeState

Array = NDArray[np.float64]

#: Places of the axes that follow each one, and those after them.
_NEXT = np.array([1, 2, 0])
_AFTER = np.array([2, 0, 1])


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
    touching = field.contact
    path = np.full_like(record.path, np.nan)
    if not touching.any():
        return DomeSlip(
            path=path,
            lateral_displacement=record.lateral_displacement,
            rigid_slip=record.rigid_slip,
        )
    step = _sliding(dome, before, after, touching)
    old = record.path[touching]
    sizes = np.linalg.norm(old, axis=1)
    known = np.isfinite(sizes)
    slid = old[known][np.argmin(sizes[known])] if known.any() else np.zeros(3)
    # What touched in neither state has not moved in contact: its path begins after this step.
    path[touching] = np.where(known[:, None], old + step, slid)
    places = field.position[touching]
    nearest = 0.6  # how far a point of the skin may be from the nearest node [pitches]
    half = nearest * dome.spacing
    least = _least(path[touching], places, after.normals[touching], half)
    slides = _least(step[known], places[known], after.normals[touching][known], half)
    return DomeSlip(
        path=path,
        current=least,
        lateral_displacement=max(record.lateral_displacement, least),
        rigid_slip=record.rigid_slip + slides,
    )


def _least(paths: Array, places: Array, normals: Array, around: float) -> float:
    """Smallest path length in a contact, also at points between the places of known paths.

    Parameters
    ----------
    around: largest distance of a point of the contact from the nearest place [m]
    """
    if not len(paths):
        return 0.0
    away = places - places.mean(axis=0)
    # The cross product; `np.cross` takes ten times as long for so few.
    arms = normals[:, _NEXT] * away[:, _AFTER] - normals[:, _AFTER] * away[:, _NEXT]
    size = (arms**2).sum()
    turn = abs((arms * (paths - paths.mean(axis=0))).sum()) / size if size > 0.0 else 0.0
    return max(0.0, float(np.linalg.norm(paths, axis=1).min()) - turn * around)


def _sliding(
    dome: SoftBody, before: DomeState, after: DomeState, nodes: NDArray[np.bool_]
) -> Array:
    """Slip of the object over some nodes in a step, in its tangent planes [m], shape (n, 3)."""
    points = lattice(dome).points[nodes]
    normals = after.normals[nodes]
    then = points + before.displacement[nodes]
    now = points + after.displacement[nodes]
    # The object's material point that was at the node before
    carried = (then - before.place) @ before.rotation @ after.rotation.T + after.place
    path = carried - now
    return path - normals * np.einsum("ij,ij->i", path, normals)[:, None]
