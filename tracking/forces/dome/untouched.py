"""Force field of a body of silicone that nothing touches."""

import numpy as np

from ....model import ForceField, SoftBody
from ....model.dome import lattice


def untouched_field(body: SoftBody, variance: float = 0.0) -> ForceField:
    """No forces on the nodes at rest.

    Parameters
    ----------
    variance: of both sums [N²]; infinite where it is not known that nothing touches
    """
    points = lattice(body).points
    return ForceField(
        position=points,
        normal=np.zeros(len(points)),
        friction=np.zeros_like(points),
        contact=np.zeros(len(points), np.bool_),
        totals_covariance=np.full((2, 2), variance),
        directions=np.zeros_like(points),
        wrench_covariance=np.zeros((4, 4)) if variance == 0.0 else None,
    )
