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

from ..kernels.touch_kernels import Stiffening
from .dome import Pad, SoftBody

Array = NDArray[np.float64]

#: Thickness over radius of the dome whose law a pad has.
_FLAT = 0.05


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
    normal = np.linalg.norm(forces - tangential, axis=1)
    whole = float(normal.sum())
    if not dome.stiffening or whole == 0.0:
        return Stiffening(0.0, 1.0, dome.thickness)
    radius = math.sqrt(float(areas[normal > 0.0].sum()) / math.pi)
    slips = float(np.linalg.norm(tangential, axis=1).sum()) / (friction * whole)
    share, power = 0.0, 0.0
    for part, (c, p) in (
        (slips, _slipping(dome, radius)),
        (1.0 - slips, _sticking(dome, radius)),
    ):
        share += part * c
        power += part * p
    return Stiffening(share, power, dome.thickness)


def _slipping(dome: SoftBody, radius: float) -> tuple[float, float]:
    """Constants c and p of a contact without friction, of a radius [m].

    A wide contact squeezes the silicone, which gives way by its bulk: more so, the less it is
    compressible.
    """
    bulk = 2.0 * (1.0 + dome.poisson) / (3.0 * (1.0 - 2.0 * dome.poisson))  # over the shear modulus
    widest = 0.402 * math.sqrt(bulk)
    wide = widest * _levelled(radius / dome.thickness / widest, 2.0)
    slender = _FLAT if isinstance(dome, Pad) else dome.thickness / dome.radius
    return 3.103 * wide**0.511 * slender**-0.184, 1.536


def _sticking(dome: SoftBody, radius: float) -> tuple[float, float]:
    """Constants c and p of a contact that does not slip, of a radius [m]."""
    return 2.556 * _levelled(radius / dome.thickness / 0.807, 4.0) ** 2.347, 1.425


def _levelled(x: float, power: float) -> float:
    """The value x where it is small, 1 where it is large."""
    return x / (1.0 + x**power) ** (1.0 / power)
