"""Dahl friction in the tangent plane of a node: a return map in closed form, and its tangent."""

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit

Array = NDArray[np.float64]

#: Slip below which nothing moves [m].
STILL = 1e-14


@njit(forceinline=True)
def dahl_vector(
    old_b: float,
    old_c: float,
    slip_b: float,
    slip_c: float,
    limit: float,
    stiffness: float,
    exponent: float,
    secant: bool,
    out: Array,
) -> None:
    """Friction after a slip of constant direction, with its derivatives.

    With e = L·ŝ − F, z = |e|/L and the closed form of the Dahl law in one line,
    k = (z^(1−n) − (1−n)·σ0|s|/L)^(1/(1−n))/z, the force is F' = L·ŝ − k·e: it never leaves the
    cone, is the law in one dimension exactly, and n = 0 is Coulomb friction with elastic stick.

    Parameters
    ----------
    old_b, old_c: friction before the step [N]; what is outside the cone is clipped to it
    slip_b, slip_c: motion of the object relative to the node [m]
    limit: L = µ·Fn at the end of the step, positive [N]
    stiffness: σ0 [N/m]
    exponent: n
    secant: whether the derivatives are those of the isotropic secant (1 − k)·L/|s|
    out: F (2), ∂F_b/∂s (2), ∂F_c/∂s (2), ∂F/∂L (2)
    """
    clip_b, clip_c = 0.0, 0.0
    size = np.sqrt(old_b * old_b + old_c * old_c)
    if size > limit:
        clip_b, clip_c = old_b / size, old_c / size
        old_b, old_c = clip_b * limit, clip_c * limit
    slip = np.sqrt(slip_b * slip_b + slip_c * slip_c)
    if slip < STILL:
        out[0], out[1] = old_b, old_c
        out[2], out[3], out[4], out[5] = stiffness, 0.0, 0.0, stiffness
        out[6], out[7] = clip_b, clip_c
        return
    b, c = slip_b / slip, slip_c / slip
    e_b, e_c = limit * b - old_b, limit * c - old_c
    e = np.sqrt(e_b * e_b + e_c * e_c)
    z = e / limit
    kept, by_slip, by_z, by_limit = _kept(z, stiffness * slip / limit, exponent)
    by_slip, by_limit = by_slip / slip, by_limit / limit
    out[0], out[1] = limit * b - kept * e_b, limit * c - kept * e_c
    gone = 1.0 - kept
    if secant:
        share = gone * limit / slip
        out[2], out[3], out[4], out[5] = share, 0.0, 0.0, share
        out[6], out[7] = 0.0, 0.0
        return
    turn = limit / slip
    bb, bc, cc = turn * (1.0 - b * b), -turn * b * c, turn * (1.0 - c * c)
    per = 1.0 / (e * limit) if e > 0.0 else 0.0
    k_b = by_slip * b + by_z * (e_b * bb + e_c * bc) * per
    k_c = by_slip * c + by_z * (e_b * bc + e_c * cc) * per
    out[2], out[3] = gone * bb - k_b * e_b, gone * bc - k_c * e_b
    out[4], out[5] = gone * bc - k_b * e_c, gone * cc - k_c * e_c
    g_b, g_c = b - clip_b, c - clip_c
    k_limit = by_limit + by_z * ((e_b * g_b + e_c * g_c) * per - z / limit)
    out[6] = b - kept * g_b - k_limit * e_b
    out[7] = c - kept * g_c - k_limit * e_c


@njit(forceinline=True)
def _kept(z: float, travel: float, exponent: float) -> tuple[float, float, float, float]:
    """Share k of the distance to the limit that is kept, and its derivatives.

    Parameters
    ----------
    z: distance to the limit over the limit
    travel: σ0·|s|/L

    Returns
    -------
    k, and s·∂k/∂s, ∂k/∂z at a given travel, L·∂k/∂L at a given z.
    """
    if z < 1e-9:
        return 0.0, 0.0, 0.0, 0.0
    power = 1.0 - exponent
    if abs(power) < 1e-9:
        k = np.exp(-travel)
        return k, -travel * k, 0.0, travel * k
    spent = power * travel / z**power
    if spent >= 1.0:
        return 0.0, 0.0, 0.0, 0.0
    k = (1.0 - spent) ** (1.0 / power)
    slope = k / (1.0 - spent) * spent / power
    return k, -slope, slope * power / z, slope
