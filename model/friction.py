"""Dahl friction of one node as a return map (thesis Eq. 5, closed form of facts for every n)."""

from numba import njit


@njit(cache=True)
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
