"""How the skin stiffens as it is pressed towards the core, as a factor on each normal force."""

import numpy as np
from numpy.typing import NDArray

from ..kernels.touch_kernels import Stiffening
from .dome import Dome

Array = NDArray[np.float64]

#: Share and power of s = 1 + share·ε^power, share = base + slope·min(a/t, widest), where the
#: contact slips and where it sticks; a is its radius and t the thickness of the silicone.
_SLIP = (2.26, 1.37, 1.54)
_STICK = (0.22, 1.13, 1.31)
_WIDEST = 2.0


def stiffening_of(
    dome: Dome, friction: float, areas: Array, forces: Array, tangential: Array
) -> Stiffening:
    """Law of the next step, from the contact before it.

    Parameters
    ----------
    friction: coefficient µ
    areas: of the nodes [m²], shape (n,)
    forces, tangential: on the nodes, and their friction [N], shape (n, 3)
    """
    normal = np.linalg.norm(forces - tangential, axis=1)
    whole = float(normal.sum())
    if not dome.stiffening or whole == 0.0:
        return Stiffening(0.0, 1.0, dome.thickness)
    radius = np.sqrt(areas[normal > 0.0].sum() / np.pi)
    wide = min(float(radius) / dome.thickness, _WIDEST)
    slips = float(np.linalg.norm(tangential, axis=1).sum()) / (friction * whole)
    share, power = 0.0, 0.0
    for part, (base, slope, exponent) in ((slips, _SLIP), (1.0 - slips, _STICK)):
        share += part * (base + slope * wide)
        power += part * exponent
    return Stiffening(share, power, dome.thickness)
