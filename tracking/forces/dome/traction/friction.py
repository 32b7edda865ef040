"""Estimate of µ from the distribution of the ratios of friction to normal force in a contact.

The ratio is µ where the skin slips, and smaller where it sticks. Slip begins at the rim and grows
inwards with the load. So µ is the mean ratio of the slipping part, which has the largest ones. The
size of that part follows from µ and the load, as for two spheres (Cattaneo, Mindlin).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .....model import Dome
from .....model.dome import lattice
from .settings import SlipSettings

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Slip:
    """Estimate of µ from the ratios.

    Attributes
    ----------
    friction: estimate of µ
    deviation: its relative standard deviation
    """

    friction: float
    deviation: float


def read_slip(
    dome: Dome,
    nodes: Index,
    normal: Array,
    friction: Array,
    load: float,
    rim: float,
    settings: SlipSettings,
) -> Slip:
    """Estimate µ of a contact.

    Parameters
    ----------
    nodes: indices of the nodes in contact, shape (n,)
    normal, friction: forces on them [N], shapes (n,) and (n, 3)
    load: magnitude of the friction that counts in Γ [N]
    rim: share of the normal force at the rim of the contact
    """
    points = lattice(dome).points[nodes] / (settings.smooth * dome.radius)
    squares = (points**2).sum(axis=1)
    near = np.exp(np.minimum(points @ points.T - 0.5 * (squares[:, None] + squares), 0.0))
    ratios = np.linalg.norm(near @ friction, axis=1) / np.maximum(near @ normal, 1e-12)
    order = np.argsort(ratios)
    ratios, weights = ratios[order], normal[order]
    below = (np.cumsum(weights) - 0.5 * weights) / weights.sum()
    used = load / max(float(normal.sum()), 1e-12)
    mu = float(np.interp(0.75, below, ratios))
    for _ in range(settings.rounds):
        first = np.searchsorted(below, 1.0 - _slipping(1.0 - used / max(mu, settings.smallest)))
        part = slice(min(int(first), max(len(ratios) - settings.fewest_nodes, 0)), None)
        mu = 0.5 * (mu + float(ratios[part] @ weights[part] / weights[part].sum()))
    mu = min(max(mu, settings.smallest), settings.largest)
    margin = max(1.0 - used / mu, 0.0)
    sticking = settings.sticking_error * margin**settings.sticking_power
    narrow = settings.narrow_error * rim**3
    return Slip(friction=mu, deviation=math.hypot(settings.least_error, sticking, narrow))


def _slipping(margin: float) -> float:
    """Share of the normal force in the slip zone of two spheres at a Γ (Cattaneo, Mindlin)."""
    return float((1.0 - max(margin, 0.0) ** (2.0 / 3.0)) ** 1.5)
