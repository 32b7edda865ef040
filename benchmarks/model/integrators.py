"""Other integrators of the chain, with which its own is compared and checked.

`euler` and `rk4` are the thesis's method (section 3 and Fig. 6): a dense stiffness matrix in NumPy,
assembled at every evaluation, with the friction force in the state (Eq. 13). `rk45`, `lsoda` and
`bdf` are SciPy's, on the same equations. They share only parameters and surface geometry with
`simulate`, and take forces alone. `lagged` is one linear solve a step, with everything linearised
at its start.
"""

from collections.abc import Callable
from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from chromagrip.model import (
    ContactObject,
    Drive,
    Fingertip,
    History,
    ModelError,
    State,
    rest_state,
    simulate,
)
from chromagrip.model.chain.assembly import Chain, chain, contact
from chromagrip.model.chain.plant import march
from chromagrip.model.kernels.contact import Contact, contact_frames, frictions_at
from chromagrip.model.kernels.implicit_kernels import Rule
from chromagrip.model.kernels.springs import AXIAL, SPLIT

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
    """Make the right-hand side dy/dt of fingertip and object; y as in `_pack`."""
    n = len(ch.share)
    damping = ch.damping[:, None]

    def rates(time: float, y: Array) -> Array:
        u, rigid, object_x, held_friction = _unpack(y, n)
        goal = drive.at(np.array([time]))[0]
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
        v_rigid, v_object = pull / ch.damping_rigid, (goal[1] - on_object) / ct.drag
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


def _pack(state: State) -> Array:
    """State vector (3N + 2,): x of the nodes, z of the nodes, rigid part, object, friction."""
    d = state.deformation
    poses = [d.rigid_part, d.object_position]
    return np.concatenate([d.nodes[:, 0], d.nodes[:, 1], poses, state.friction])


def _unpack(y: Array, n: int) -> tuple[Array, float, float, Array]:
    """Split a state vector into displacements (N, 2), rigid part, object and friction (N,)."""
    return y[: 2 * n].reshape(2, n).T, float(y[2 * n]), float(y[2 * n + 1]), y[2 * n + 2 :]


def _euler(rates: Rates, time: float, y: Array, dt: float) -> Array:
    """Make one forward Euler step."""
    return y + dt * rates(time, y)


def _rk4(rates: Rates, time: float, y: Array, dt: float) -> Array:
    """Make one step of the classical Runge–Kutta method."""
    k1 = rates(time, y)
    k2 = rates(time + dt / 2, y + dt / 2 * k1)
    k3 = rates(time + dt / 2, y + dt / 2 * k2)
    k4 = rates(time + dt, y + dt * k3)
    return y + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


#: Step of each explicit method, and its largest stable |λ|·dt on the negative real axis.
EXPLICIT = {"euler": (_euler, 2.0), "rk4": (_rk4, 2.785293563405282)}
#: SciPy's name of each adaptive method.
ADAPTIVE: dict[str, Literal["RK45", "LSODA", "BDF"]] = {
    "rk45": "RK45",
    "lsoda": "LSODA",
    "bdf": "BDF",
}
LAGGED = Rule(tolerance=0.0, max_iterations=1, turning=0.0, second_order=False, lagged=True)


def integrate(
    method: str,
    fingertip: Fingertip,
    obj: ContactObject,
    drive: Drive,
    *,
    dt: float,
    duration: float,
    state: State | None = None,
    every: int = 1,
) -> History:
    """Simulate the node model by a method: `implicit`, `lagged`, or one of EXPLICIT or ADAPTIVE.

    Parameters
    ----------
    dt: step [s]; the longest one for an adaptive method
    others: as of `simulate`

    Raises
    ------
    ModelError
        When a step has no solution, or a node moves by more than 1 m.
    """
    if method == "implicit":
        return simulate(fingertip, obj, drive, dt=dt, duration=duration, state=state, every=every)
    ch, ct = chain(fingertip), contact(fingertip, obj)
    start = rest_state(fingertip) if state is None else state
    steps = round(duration / dt)
    if method == "lagged":
        return march(ch, ct, start, drive, dt, steps, every, LAGGED)
    n, rates, y, time = fingertip.nodes, equations(ch, ct, drive), _pack(start), start.time
    rows = [(time, y, start.slip_rate, start.rate, start.step)]

    def refuse_lost(y: Array, step: int) -> None:
        if not abs(y[: 2 * n + 1]).max() < 1.0:
            raise ModelError(
                f"{method} diverged at step {step} with dt = {dt:.3g} s; linear theory predicts "
                f"stability up to {explicit_limit(fingertip, obj, start, method):.3g} s"
            )

    # A run that diverges overflows on its way; its state is checked instead.
    with np.errstate(over="ignore", invalid="ignore"):
        for before in range(0, steps, every):
            if method in EXPLICIT:
                for k in range(every):
                    y = EXPLICIT[method][0](rates, time + k * dt, y, dt)
                    refuse_lost(y, before + k + 1)
            else:
                span = (time, time + every * dt)
                found = scipy.integrate.solve_ivp(
                    rates, span, y, ADAPTIVE[method],
                    t_eval=span[1:], max_step=dt, atol=1e-9, rtol=1e-6,
                )  # fmt: skip
                y = found.y[:, -1] if found.success else np.full_like(y, np.nan)
                refuse_lost(y, before + every)
            time += every * dt
            v, v_rigid, v_object, _ = _unpack(rates(time, y), n)
            rate = np.concatenate([v, [[v_rigid, v_object]]])
            rows.append((time, y, v_object - v[:, 0], rate, dt))
    times, states, slips, moved, lengths = map(np.array, zip(*rows, strict=True))
    return History(
        time=times,
        nodes=states[:, : 2 * n].reshape(-1, 2, n).swapaxes(1, 2),
        pose=states[:, 2 * n : 2 * n + 2],
        friction=states[:, 2 * n + 2 :],
        slip_rate=slips,
        rate=moved,
        step=lengths,
    )


def explicit_limit(
    fingertip: Fingertip, obj: ContactObject, state: State | None = None, method: str = "euler"
) -> float:
    """Largest step at which linear theory keeps an explicit method stable, 2c/λmax for Euler [s].

    λmax/c is the largest eigenvalue of the Jacobian of `equations` at a state, by finite
    differences. It includes contact, friction and the rotation of springs.
    """
    rates = equations(chain(fingertip), contact(fingertip, obj), Drive.constant(0.0))
    y = _pack(rest_state(fingertip) if state is None else state)
    still = rates(0.0, y)
    jacobian = np.empty((len(y), len(y)))
    nudge = 1e-9  # step of differences: small beside contact depths, large beside rounding [m or N]
    for k in range(len(y)):
        nudged = y.copy()
        nudged[k] += nudge
        jacobian[:, k] = (rates(0.0, nudged) - still) / nudge
    largest = abs(np.linalg.eigvals(jacobian)).max()
    return float(EXPLICIT.get(method, EXPLICIT["euler"])[1] / largest)
