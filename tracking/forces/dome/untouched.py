"""Force field of a body of silicone that nothing touches."""

import numpy as np

from ....model import ForceField, SoftBody
from ....model.dome import lattice


def untouched_field(body: SoftBody, variance: float = 0.0) -> ForceField:
    """No forces on the nodes at rest.

    Parameters
    ----------
    variance: of both sums [N²], of a touch too light to be seen; infinite where it is not known
        that nothing touches
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
