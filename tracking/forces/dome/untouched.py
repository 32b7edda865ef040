"""Force field of a silicone body without contact."""

import numpy as np

from ....model import ForceField, SoftBody
from ....model.dome import lattice


def untouched_field(body: SoftBody, variance: float = 0.0) -> ForceField:
    """Make a force field without forces on the nodes at rest.

    Parameters
    ----------
    body: silicone body
    variance: variance of both sums [N²], due to an undetectable light touch; infinite if it is
        unknown whether anything touches
    """
    points = lattice(body).points
    return ForceField(
        position=points,
        normal=np.zeros(len(points)),
        friction=np.zeros_like(points),
        contact=np.zeros(len(points), np.bool_),
        totals_covariance=np.full((2, 2), variance),
        directions=np.zeros_like(points),
        # A light contact is about as wide as the silicone is thick.
        wrench_covariance=np.diag([variance] * 3 + [variance * body.thickness**2])
        if np.isfinite(variance)
        else None,
    )
