"""Fingertip and object in contact, stepped in time by the implicit integrator (thesis Eq. 2).

The object carries the load and a drag to ground, is massless and free along x; the rigid part is
driven along z by the grip force and held in x (E9).
"""

from functools import lru_cache

import numpy as np

from .fingertip import Fingertip
from .kernels import Coefficients, implicit_step
from .objects import ContactObject
from .state import Deformation, State

#: A step has converged when no unknown moved more than this in its last iteration [m].
TOLERANCE = 1e-12
MAX_ITERATIONS = 60
#: A step that does not converge is halved at most this often.
MAX_HALVINGS = 8


class ConvergenceError(RuntimeError):
    """An implicit step did not converge even after halving it."""


@lru_cache(maxsize=64)
def coefficients(fingertip: Fingertip, obj: ContactObject) -> Coefficients:
    """Numbers of the compiled kernels, scaled to the node spacing."""
    ratio = fingertip.spacing_ratio
    return Coefficients(
        rest=fingertip.rest_positions(),
        sign=fingertip.poisson_signs(),
        tissue=fingertip.tissue_stiffness * ratio,
        membrane=fingertip.membrane_stiffness / ratio,
        poisson_tissue=fingertip.poisson_tissue,
        poisson_membrane=fingertip.poisson_membrane,
        damping_node=fingertip.damping_node * ratio,
        damping_rigid=fingertip.damping_rigid,
        drag=obj.drag,
        contact=obj.stiffness * ratio,
        curvature=obj.curvature,
        apex=fingertip.radius,
        mu=obj.friction,
        bristle=obj.dahl_stiffness * ratio,
        exponent=obj.dahl_exponent,
    )


def step(
    fingertip: Fingertip, obj: ContactObject, state: State, dt: float, grip: float, load: float
) -> State:
    """State after one implicit (backward Euler) step under constant grip force and load.

    Parameters
    ----------
    fingertip, obj: the plant
    state: state at the start of the step
    dt: step [s]; stable at any length, first-order accurate
    grip: force on the rigid part along z [N]
    load: force on the object along x [N]

    Raises
    ------
    ConvergenceError
        When the nonlinear equations were not solved even after halving the step eight times.
    """
    if not (dt > 0.0 and np.isfinite([dt, grip, load]).all()):
        raise ValueError(f"a step needs dt > 0 and finite forces, got {dt=}, {grip=}, {load=}")
    return _step(coefficients(fingertip, obj), state, dt, grip, load, halvings=0)


def _step(
    c: Coefficients, state: State, dt: float, grip: float, load: float, halvings: int
) -> State:
    before = state.deformation
    u = before.nodes.copy()
    friction = state.friction.copy()
    slip = np.zeros(u.shape[0])
    pose = np.array([before.rigid_part, before.object_position])
    iterations = implicit_step(
        c, u, friction, slip, pose, dt, grip, load, TOLERANCE, MAX_ITERATIONS
    )
    if iterations > 0:
        return State(
            time=state.time + dt,
            deformation=Deformation(
                nodes=u, rigid_part=float(pose[0]), object_position=float(pose[1])
            ),
            friction=friction,
            slip_rate=slip / dt,
        )
    if halvings == MAX_HALVINGS:
        raise ConvergenceError(
            f"no equilibrium found at t = {state.time:.6g} s with dt = {dt:.3g} s, "
            f"grip {grip:.4g} N, load {load:.4g} N"
        )
    half = _step(c, state, dt / 2, grip, load, halvings + 1)
    return _step(c, half, dt / 2, grip, load, halvings + 1)
