"""The thesis's method as a baseline: a dense stiffness matrix, assembled at every evaluation.

It uses plain NumPy and explicit integrators (thesis section 3 and Fig. 6), with the friction force
in the state (Eq. 13). It shares only parameters and surface geometry with the implicit integrators,
so that it checks them. It is also the reference for their speed, and never the default.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from ...errors import UserError
from ..errors import DivergedError
from ..kernels.contact import Contact, contact_frames, frictions_at
from ..kernels.springs import AXIAL, SPLIT
from .assembly import Chain
from .drive import Drive
from .plant import History, history
from .state import Deformation, State

Array = NDArray[np.float64]


def stiffness_matrix(ch: Chain, u: Array, rigid: float) -> Array:
    """Stiffness matrix K (thesis Fig. 6): x of the N nodes and the rigid part, then z of them.

    Parameters
    ----------
    ch: chain with one of the split laws
    u: node displacements (x, z) in the ground frame [m], shape (N, 2)
    rigid: displacement of the rigid part along z [m]

    Returns
    -------
    Matrix from displacements to spring forces on nodes and rigid part [N/m], (2N + 2, 2N + 2).
    """
    n = len(u)
    size = n + 1
    k = np.zeros((2 * size, 2 * size))
    node = np.arange(n)
    reach = ch.rest + u - [0.0, rigid]
    _add_springs(k, node, np.full(n, n), reach, ch.tissue, ch.cross_tissue, ch.law)
    between = np.diff(ch.rest + u, axis=0)
    _add_springs(k, node[1:], node[:-1], between, ch.membrane, ch.cross_membrane, ch.law)
    return k


def _add_springs(
    k: Array,
    one: NDArray[np.intp],
    other: NDArray[np.intp],
    reach: Array,
    stiffness: Array,
    cross: Array,
    law: int,
) -> None:
    """Add springs between nodes `one` and `other` (thesis Eq. 3 with E6, or Eq. 17)."""
    size = len(k) // 2
    sin, cos = (abs(reach) / np.linalg.norm(reach, axis=1)[:, None]).T
    across, along = (cos, sin) if law == SPLIT else (sin, cos)
    block = {
        (0, 0): stiffness * sin,
        (0, 1): stiffness * cross * across,
        (1, 0): -stiffness * cross * along,
        (1, 1): stiffness * cos,
    }
    for (row, column), values in block.items():
        r, c = row * size, column * size
        np.add.at(k, (r + one, c + one), values)
        np.add.at(k, (r + other, c + other), values)
        np.add.at(k, (r + one, c + other), -values)
        np.add.at(k, (r + other, c + one), -values)


def axial_forces(ch: Chain, u: Array, rigid: float) -> Array:
    """Spring forces of the Sensor Model (thesis Eq. 14) on nodes and rigid part [N], (N + 1, 2)."""
    forces = np.zeros((len(u) + 1, 2))
    held = ch.rest + u - [0.0, rigid]
    tissue = _hooke(held, ch.rest, ch.tissue)
    forces[:-1] += tissue
    forces[-1] -= tissue.sum(axis=0)
    membrane = _hooke(np.diff(ch.rest + u, axis=0), np.diff(ch.rest, axis=0), ch.membrane)
    forces[1:-1] += membrane
    forces[:-2] -= membrane
    return forces


def _hooke(reach: Array, rest: Array, stiffness: Array) -> Array:
    """Forces of axial springs with vectors `reach` between their ends, and `rest` unloaded."""
    length = np.linalg.norm(reach, axis=1)
    stretch = length - np.linalg.norm(rest, axis=1)
    return (stiffness * stretch / length)[:, None] * reach


Rates = Callable[[float, Array], Array]


def equations(ch: Chain, ct: Contact, drive: Drive) -> Rates:
    """Make the right-hand side dy/dt of fingertip and object; y as in `pack`."""
    n = len(ch.share)
    damping = ch.damping[:, None]

    def rates(time: float, y: Array) -> Array:
        u, rigid, object_x, held_friction = unpack(y, n)
        goal, slope = drive.at(np.array([time]))[0], drive.rate(np.array([time]))[0]
        if ch.law == AXIAL:
            forces = axial_forces(ch, u, rigid)
        else:
            moved = np.concatenate([u[:, 0], [0.0], u[:, 1], [rigid]])
            forces = (stiffness_matrix(ch, u, rigid) @ moved).reshape(2, n + 1).T
        gap, normal = contact_frames(ct, ch.rest + u, object_x)
        tangent = np.column_stack([-normal[:, 1], normal[:, 0]])
        f_n = ct.stiffness * ch.share * np.maximum(0.0, -gap)
        mu = frictions_at(ct, ch.rest[:, 0] + u[:, 0] - object_x)
        limit = mu * f_n
        f_f = np.clip(held_friction, -limit, limit)
        on_node = f_n[:, None] * normal + f_f[:, None] * tangent
        v = (on_node - forces[:-1]) / damping
        on_object = (ct.travel * f_n * normal[:, 0] + f_f * tangent[:, 0]).sum()
        # The outer nodes are held to the rigid part, which feels what pulls on them.
        pull = goal[0] - forces[-1, 1] - forces[0, 1] - forces[n - 1, 1]
        v_rigid = slope[0] if drive.held[0] else pull / ch.damping_rigid
        v_object = slope[1] if drive.held[1] else (goal[1] - on_object) / ct.drag
        v[0] = v[-1] = 0.0, v_rigid
        relative = np.array([v_object, 0.0]) - v
        speed = (relative * tangent).sum(axis=1)
        approach = np.array([ct.travel * v_object, 0.0]) - v
        closing = ct.stiffness * ch.share * (approach * normal).sum(axis=1) * (gap < 0.0)
        friction = _dahl_rate(held_friction, speed, limit, mu * closing, ch, ct)
        return np.concatenate([v[:, 0], v[:, 1], [v_rigid, v_object], friction])

    return rates


def _dahl_rate(
    friction: Array, speed: Array, limit: Array, limit_rate: Array, ch: Chain, ct: Contact
) -> Array:
    """dF/dt of the Dahl law (thesis Eq. 5), kept in the cone µFn as the normal force changes."""
    safe = np.maximum(limit, 1e-300)
    # Friction that a falling normal force leaves outside its cone comes back at this share of the
    # bristle's own rate σ0/c.
    cone_share = 0.2
    back = cone_share * ct.bristle * ch.share / ch.damping
    z = 1.0 - np.clip(friction / safe, -1.0, 1.0) * np.sign(speed)
    rate = ct.bristle * ch.share * z**ct.exponent * speed
    side = np.sign(friction)
    outwards = np.minimum(side * rate, limit_rate)  # on the cone it can only follow the cone
    excess = np.maximum(abs(friction) - limit, 0.0)
    on_cone = side * (outwards - back * excess)
    rate = np.where(abs(friction) >= safe, on_cone, rate)
    return np.where(limit > 0.0, rate, -back * friction)


def pack(state: State) -> Array:
    """State vector (3N + 2,): x of the nodes, z of the nodes, rigid part, object, friction."""
    d = state.deformation
    poses = [d.rigid_part, d.object_position]
    return np.concatenate([d.nodes[:, 0], d.nodes[:, 1], poses, state.friction])


def unpack(y: Array, n: int) -> tuple[Array, float, float, Array]:
    """Split a state vector into displacements (N, 2), rigid part, object and friction (N,)."""
    return y[: 2 * n].reshape(2, n).T, float(y[2 * n]), float(y[2 * n + 1]), y[2 * n + 2 :]


def unpacked(y: Array, rates: Array, time: float, dt: float, n: int) -> State:
    """Make a State from a state vector; its rates hold at its time, and are no step means."""
    u, rigid, object_x, friction = unpack(y, n)
    v, v_rigid, v_object, _ = unpack(rates, n)
    return State(
        time=time,
        deformation=Deformation(nodes=u.copy(), rigid_part=rigid, object_position=object_x),
        friction=friction.copy(),
        slip_rate=v_object - v[:, 0],
        rate=np.concatenate([v, [[v_rigid, v_object]]]),
        step=dt,
    )


def euler(rates: Rates, time: float, y: Array, dt: float) -> Array:
    """Make one forward Euler step."""
    return y + dt * rates(time, y)


def rk4(rates: Rates, time: float, y: Array, dt: float) -> Array:
    """Make one step of the classical Runge–Kutta method."""
    k1 = rates(time, y)
    k2 = rates(time + dt / 2, y + dt / 2 * k1)
    k3 = rates(time + dt / 2, y + dt / 2 * k2)
    k4 = rates(time + dt, y + dt * k3)
    return y + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def fixed(
    advance: Callable[[Rates, float, Array, float], Array],
    rates: Rates,
    time: float,
    y: Array,
    dt: float,
    steps: int,
) -> Iterator[tuple[int, Array]]:
    """Make explicit steps; yield the number of steps so far and the state vector after each."""
    for k in range(steps):
        y = advance(rates, time + k * dt, y, dt)
        yield k + 1, y


def adaptive(
    method: Literal["RK45", "LSODA", "BDF"],
    rates: Rates,
    time: float,
    y: Array,
    dt: float,
    steps: int,
) -> Iterator[tuple[int, Array]]:
    """Make steps that SciPy subdivides as needed; yield their number and the last state vector."""
    end = time + steps * dt
    absolute, relative = 1e-9, 1e-6
    solution = scipy.integrate.solve_ivp(
        rates, (time, end), y, method, t_eval=[end], max_step=dt, atol=absolute, rtol=relative
    )
    yield steps, solution.y[:, -1] if solution.success else np.full_like(y, np.nan)


#: Largest stable |λ|·dt on the negative real axis.
STABLE = {"euler": 2.0, "rk4": 2.785293563405282}


@dataclass(frozen=True)
class Dense:
    """Integrator of the baseline.

    Attributes
    ----------
    name: name of the method, for messages and its stable step
    advance: function like `fixed` with its first argument bound
    """

    name: str
    advance: Callable[[Rates, float, Array, float, int], Iterator[tuple[int, Array]]]

    def march(
        self,
        ch: Chain,
        ct: Contact,
        state: State,
        drive: Drive,
        dt: float,
        steps: int,
        every: int,
    ) -> History:
        """Run a number of steps; see `Integrator`.

        Raises
        ------
        DivergedError
            When a node moves by more than 1 m.
        """
        if ch.half:
            raise UserError(f"a half chain runs with implicit or lagged, not {self.name}")
        n, rates = len(ch.share), equations(ch, ct, drive)
        states = [state]
        # A run that diverges overflows on its way; its state is checked instead.
        with np.errstate(over="ignore", invalid="ignore"):
            for before in range(0, steps, every):
                start = states[-1].time
                for done, y in self.advance(rates, start, pack(states[-1]), dt, every):
                    _refuse_lost(self.name, y, before + done, ch, ct, state, dt)
                end = start + every * dt
                states.append(unpacked(y, rates(end, y), end, dt, n))
        return history(states)


EULER = partial(Dense, "euler", partial(fixed, euler))
RK4 = partial(Dense, "rk4", partial(fixed, rk4))
RK45 = partial(Dense, "rk45", partial(adaptive, "RK45"))
LSODA = partial(Dense, "lsoda", partial(adaptive, "LSODA"))
BDF = partial(Dense, "bdf", partial(adaptive, "BDF"))


def _refuse_lost(
    method: str, y: Array, step: int, ch: Chain, ct: Contact, state: State, dt: float
) -> None:
    """Raise DivergedError for a state vector that has diverged."""
    lost = 1.0  # a run has diverged when a node is further than this from rest [m]
    if not abs(y[: 2 * len(ch.share) + 1]).max() < lost:
        limit = stable_step(ch, ct, state, method)
        raise DivergedError(
            f"{method} diverged at step {step} with dt = {dt:.3g} s; linear theory predicts "
            f"stability up to {limit:.3g} s",
            step,
            limit,
        )


def stable_step(ch: Chain, ct: Contact, state: State, method: str = "euler") -> float:
    """Largest stable step of an explicit method, 2c/λmax for forward Euler [s].

    λmax/c is the largest eigenvalue of the Jacobian of `equations` at a state, by finite
    differences. It includes contact, friction and the rotation of springs.
    """
    rates = equations(ch, ct, Drive.constant(0.0))
    y = pack(state)
    still = rates(0.0, y)
    jacobian = np.empty((len(y), len(y)))
    nudge = 1e-9  # step of differences: small beside contact depths, large beside rounding [m or N]
    for k in range(len(y)):
        nudged = y.copy()
        nudged[k] += nudge
        jacobian[:, k] = (rates(0.0, nudged) - still) / nudge
    largest = abs(np.linalg.eigvals(jacobian)).max()
    return float(STABLE.get(method, 2.0) / largest)
