"""Dahl friction of one node as a return map (thesis Eq. 5, closed form of facts for every n)."""

import numpy as np

from ...compiled import njit


@njit()
def dahl_step(
    force: float, slip: float, normal: float, mu: float, stiffness: float, exponent: float
) -> tuple[float, float]:
    """Friction force after a slip increment of constant direction, and its secant modulus.

    The Dahl equation dF/ds = σ0·|1 − sF/(µFn)|ⁿ·sign(1 − sF/(µFn)) has a closed form while the
    direction s does not change. It is entered from the friction cone of the *new* normal force and
    cannot leave it.

    Parameters
    ----------
    force: friction force before the step [N]
    slip: tangential motion of the object relative to the node [m]
    normal: normal force at the end of the step [N]
    mu: friction coefficient
    stiffness: bristle stiffness σ0 [N/m]
    exponent: Dahl exponent n

    Returns
    -------
    force: friction force on the node, along the object's motion [N]
    secant: (force − clipped old force) / slip, the modulus that keeps an implicit step on its
        trajectory where the tangent oscillates [N/m]
    """
    limit = mu * normal
    if limit <= 0.0:
        return 0.0, 0.0
    start = min(max(force, -limit), limit)
    if abs(slip) < 1e-16:
        return start, stiffness
    sign = 1.0 if slip > 0.0 else -1.0
    z = 1.0 - sign * start / limit
    travel = stiffness * abs(slip) / limit
    if exponent == 1.0:
        z_new = z * 2.718281828459045**-travel
    else:
        # A reversal starts at z > 1; every n below 1 reaches the plateau at a finite slip.
        power = 1.0 - exponent
        if z > 0.0:
            base = z**power - power * travel
            z_new = base ** (1.0 / power) if base > 0.0 else 0.0
        else:
            z_new = 0.0
    end = sign * limit * (1.0 - z_new)
    return end, (end - start) / slip


#: Parts of a step in which the normal force changes, and the change below which there is one.
PARTS, STEADY = 8, 0.02


@njit()
def dahl_path(
    force: float,
    slip: float,
    before: float,
    normal: float,
    mu: float,
    stiffness: float,
    exponent: float,
) -> tuple[float, float]:
    """Friction after a slip increment during which the normal force went straight to `normal`.

    A node that comes into contact sticks or slips under the little normal force of its first
    moments; with that of the end of the step alone, it would remember too much friction.

    Parameters
    ----------
    before: normal force at the start of the step, negative where a gap was still to close [N]

    Others, and what is returned, as in `dahl_step`.
    """
    if normal <= 0.0:
        return 0.0, 0.0
    if abs(normal - before) <= STEADY * normal or abs(slip) < 1e-16:
        return dahl_step(force, slip, normal, mu, stiffness, exponent)
    start = force if before > 0.0 else 0.0
    share = 1.0 if before > 0.0 else normal / (normal - before)  # of the slip while in contact
    low = max(before, 0.0)
    end = start
    for k in range(PARTS):
        now = low + (normal - low) * (k + 1.0) / PARTS
        end, _ = dahl_step(end, slip * share / PARTS, now, mu, stiffness, exponent)
    limit = mu * normal
    return end, max((end - min(max(start, -limit), limit)) / slip, 0.0)


@njit()
def dahl_tangent(
    force: float, slip: float, normal: float, mu: float, stiffness: float, exponent: float
) -> float:
    """Slope dF/ds of the Dahl law at a force, for motion that goes on in the direction of `slip`.

    Parameters and units as in `dahl_step`.
    """
    limit = mu * normal
    if limit <= 0.0:
        return 0.0
    z = 1.0 - np.sign(slip) * force / limit
    return stiffness * z**exponent if z > 0.0 else 0.0
