"""How the skin stiffens as it is pressed towards the core, as a factor on each normal force.

Against Neo-Hookean finite elements the linear dome has the right contact and the right stiffness in
shear and twist, and too little force along the normal. The factor s = 1 + c·ε^p mends it, ε the
indentation of a node over the thickness of the silicone. Its constants were fitted to presses of
`fixtures/hyperelastic`. Of exact contacts it is within 4 % to ε = .4 and 7 % to .6, on domes that
it was not fitted on. With the error of the nodes' contact the force is within 7 % to ε = .4 and
12 % at .6. This holds for a silicone of .1 to .4 of the radius and ν from .45 to .495.

A pad has the law of a dome whose silicone is a twentieth of its radius, which was fitted to balls
on a flat layer.
"""

import math

import numpy as np
from numpy.typing import NDArray

from ..kernels.dome.posed_kernels import stiffening_by
from ..kernels.dome.touch_kernels import Stiffening
from .dome import SoftBody

Array = NDArray[np.float64]


def law_of(dome: SoftBody) -> Array:
    """Constants of the law, as `stiffening_by` takes them.

    They are the thickness [m], which is 0 where nothing stiffens; without friction the widest
    contact in thicknesses, a factor, its power, and p; where it sticks the widest contact, c of it,
    its power, and p.
    """
    if not dome.stiffening:
        return np.zeros(9)
    # A wide contact squeezes the silicone, which gives way by its bulk: more so, the less it is
    # compressible.
    bulk = 2.0 * (1.0 + dome.poisson) / (3.0 * (1.0 - 2.0 * dome.poisson))  # over the shear modulus
    slipping = [0.402 * math.sqrt(bulk), 3.103 * dome.slenderness**-0.184, 0.511, 1.536]
    return np.array([dome.thickness, *slipping, 0.807, 2.556, 2.347, 1.425])


def stiffening_of(
    dome: SoftBody, friction: float, areas: Array, forces: Array, tangential: Array
) -> Stiffening:
    """Law of the next step, from the contact before it.

    Parameters
    ----------
    friction: coefficient µ
    areas: of the nodes [m²], shape (n,)
    forces, tangential: on the nodes, and their friction [N], shape (n, 3)
    """
    share, power = stiffening_by(law_of(dome), friction, areas, forces, tangential)
    return Stiffening(share, power, dome.thickness)
