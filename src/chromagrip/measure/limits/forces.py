"""Information of an image on the forces: smallest standard deviations of ΣFn, ΣFf, µ and Γ.

The bounds are computed in three steps:

1. (x, y, log size) of both layers of each marker pair against rest: the Cramér–Rao bound from the
   pixels, with light, dyes and all other markers known. The effect of tilt on an outline beyond its
   size is left out, because no tracker here reads it.
2. *Any forces*: ΣFn and ΣFf of nodal forces in the true contact zone with a smooth prior.
   Stiffness, zone and normals are known.
3. *Of an object*: ΣFn, ΣFf, µ and Γ of a contact of the node model with unknown µ, curvature,
   stiffness, grip, load and history. The history is one of four paths to the same grip and load
   (`histories`), plus a field of nodal forces as large as random histories leave.

Both are posterior deviations: the smallest mean square error over scenes that scatter like the
prior, if the response is linear around the truth. Errors of the calibration, of the fingertip's
stiffness and of the camera, and defects of the image are not included.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...errors import located
from ...model import (
    ContactObject,
    Drive,
    Fingertip,
    ForceField,
    State,
    chain_compliance,
    contact_forces,
    refuse_flattening,
    rest_state,
)
from ...model.chain import QUASI_STATIC, chain, contact, march
from ...model.kernels import contact_frames
from ...render import MembraneMap, SensorDesign
from ...tracking.forces.chain import MarkerResponse
from .body import reserve_of
from .positions import pair_limits

Array = NDArray[np.float64]

#: Prior standard deviation of µ, uniform in 0.2…0.9.
_MU = 0.2
#: Prior standard deviation of the curvature, uniform in 0…230 /m [1/m].
_CURVATURE = 66.0
#: Prior standard deviation of log k_c, uniform in log 80…log 1000 N/m.
_LOG_STIFFNESS = 0.73
#: Prior standard deviation of ΣFn, uniform in 0.4…6 N [N].
_GRIP = 1.6
#: Prior standard deviation of the load, from Γ uniform in 0.05…0.85 [N].
_LOAD = 0.8
#: Standard deviation of the amount of each history, see `histories`.
_HISTORY = 0.3
#: Nodal friction that random histories leave beyond those paths, as a share of µ·Fn (geometric mean
#: over poses; a test measures it).
LEFT_FRICTION = 0.2
#: Nodal normal forces that they leave, as a share of Fn (geometric mean over poses).
LEFT_NORMAL = 0.03
#: Correlation length of both [m].
_LEFT_LENGTH = 0.2e-3
#: Correlation length of any forces [m].
_LENGTH = 0.8e-3
#: Smallest prior deviation of a nodal force at 251 nodes; otherwise it is the largest nodal force
#: [N].
_AMPLITUDE = 5e-3
#: Slope below which the jump of the stiffness is smoothed.
_BLUNT = 0.05
#: Steps of each stage of a path.
_PARTS = 40
#: Steps in which the end of a path settles.
_SETTLE = 5
#: Length of a step [s]: dampers carry a millionth of the forces, and a spring that snaps through is
#: still caught.
_SECONDS = 1.0
#: Largest step of differences in µ and grip as a share of them, and in the load as one of µ·grip.
#: Springs snap from node to node, so that derivatives are rough: half or twice the steps change the
#: limit of Γ by up to a tenth on a flat object, and by up to a half on one of 5 mm radius.
_SHARE = 0.03
#: Step of differences in the curvature [1/m].
_BEND = 6.0
#: Multiples of the stiffness for its difference.
_SOFTER = (0.94, 1.06)


@dataclass(frozen=True, kw_only=True)
class Press:
    """A contact, and its derivatives by everything that is unknown of it.

    Attributes
    ----------
    fingertip, mu: of the contact
    displacement: node displacements relative to the camera [m], shape (N, 2)
    field: contact forces
    moves: change of `displacement` by a prior standard deviation of (µ, curvature, log k_c, grip,
        load, four histories) [m], shape (N, 2, 9)
    sums: change of (ΣFn, signed ΣFf) by each of them [N], shape (2, 9)
    nodes: indices of the nodes in contact, shape (K,)
    axes: the object's normal and tangent at them, pointing as the forces on the node do, (K, 2, 2)
    """

    fingertip: Fingertip
    mu: float
    displacement: Array
    field: ForceField
    moves: Array
    sums: Array
    nodes: NDArray[np.intp]
    axes: Array


@dataclass(frozen=True, kw_only=True)
class ForceLimit:
    """Smallest standard deviations of an estimate from an image.

    Attributes
    ----------
    any_normal, any_friction: of ΣFn and ΣFf of forces that are only known to be smooth [N]
    normal, friction: of ΣFn and ΣFf of an object's contact [N]
    mu, margin: of µ and Γ
    """

    any_normal: float
    any_friction: float
    normal: float
    friction: float
    mu: float
    margin: float


def press(fingertip: Fingertip, obj: ContactObject, grip: float, load: float) -> Press:
    """Contact of an object that is gripped and then loaded, and its derivatives.

    Derivatives by the state are central differences. Those by a history are differences over one
    standard deviation, because friction is not smooth where a path turns back.

    Raises
    ------
    UserError
        When the grip does not hold the load, or the model finds no equilibrium.
    """
    refuse_flattening(fingertip, obj, grip)
    reserve = reserve_of(grip, load, obj.friction)
    mu, step = obj.friction, min(_SHARE, reserve / 4)
    nudge = step * mu * grip

    def straight(of: ContactObject, grip: float, load: float) -> tuple[Array, Array]:
        state = follow_path(fingertip, of, [(grip, 0.0), (grip, load)])
        return _seen_and_sums(fingertip, of, state)

    slippery, rough = (replace(obj, friction=mu * (1 + s)) for s in (-step, step))
    blunt, sharp = (replace(obj, curvature=obj.curvature + s) for s in (-_BEND, _BEND))
    soft, stiff = (replace(obj, stiffness=obj.stiffness * s) for s in _SOFTER)
    # Contacts on either side, and the number of standard deviations between the two.
    sides = [
        ((slippery, grip, load), (rough, grip, load), 2 * step * mu / _MU),
        ((blunt, grip, load), (sharp, grip, load), 2 * _BEND / _CURVATURE),
        ((soft, grip, load), (stiff, grip, load), np.log(_SOFTER[1] / _SOFTER[0]) / _LOG_STIFFNESS),
        ((obj, grip * (1 - step), load), (obj, grip * (1 + step), load), 2 * step * grip / _GRIP),
        ((obj, grip, load - nudge), (obj, grip, load + nudge), 2 * nudge / _LOAD),
    ]
    with located(f"grip {grip:g} N with load {load:g} N, or one near it, cannot be held"):
        state = follow_path(fingertip, obj, [(grip, 0.0), (grip, load)])
        here = _seen_and_sums(fingertip, obj, state)
        ends = [(straight(*down), straight(*up), span) for down, up, span in sides]
        ends += [
            (here, _seen_and_sums(fingertip, obj, follow_path(fingertip, obj, way)), 1.0)
            for way in histories(mu, grip, load)
        ]
    pushed, axes = _frames(fingertip, obj, state)
    nodes = np.flatnonzero(pushed > 0.0)
    return Press(
        fingertip=fingertip,
        mu=obj.friction,
        displacement=state.deformation.seen,
        field=contact_forces(fingertip, obj, state),
        moves=np.stack([(up[0] - down[0]) / span for down, up, span in ends], axis=-1),
        sums=np.stack([(up[1] - down[1]) / span for down, up, span in ends], axis=-1),
        nodes=nodes,
        axes=axes[nodes],
    )


def histories(mu: float, grip: float, load: float) -> list[list[tuple[float, float]]]:
    """Four paths of (grip, load) to the same end.

    The grip overshoots, the load overshoots, the load acts the other way before, or the load acts
    before the last part of the grip.
    """
    reserve = mu * grip - abs(load)
    side = 1.0 if load >= 0.0 else -1.0
    low = grip * (1.0 - _HISTORY * reserve / (mu * grip))
    end = (grip, load)
    return [
        [(grip * (1.0 + _HISTORY), 0.0), (grip, 0.0), end],
        [(grip, 0.0), (grip, load + side * _HISTORY * reserve), end],
        [(grip, 0.0), (grip, -side * _HISTORY * mu * grip), end],
        [(low, 0.0), (low, load), end],
    ]


def follow_path(fingertip: Fingertip, obj: ContactObject, path: list[tuple[float, float]]) -> State:
    """Equilibrium at the end of a path of (grip, load) from rest, linear between its points."""
    points = np.array([(0.0, 0.0), *path])
    stages = len(path)
    drive = Drive(
        times=_PARTS * _SECONDS * np.arange(stages + 1.0), normal=points[:, 0], lateral=points[:, 1]
    )
    steps = stages * _PARTS + _SETTLE
    start, ch, ct = rest_state(fingertip), chain(fingertip), contact(fingertip, obj)
    return march(ch, ct, start, drive, _SECONDS, steps, steps, QUASI_STATIC).state(-1)


def _frames(fingertip: Fingertip, obj: ContactObject, state: State) -> tuple[Array, Array]:
    """Normal force on each node (N,) [N], and the object's normal and tangent there (N, 2, 2)."""
    ch, place = chain(fingertip), state.deformation
    gap, normal = contact_frames(
        contact(fingertip, obj), ch.rest + place.nodes, place.object_position
    )
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=-1)
    return obj.stiffness * ch.share * np.maximum(0.0, -gap), np.stack([normal, tangent], axis=1)


def _seen_and_sums(fingertip: Fingertip, obj: ContactObject, state: State) -> tuple[Array, Array]:
    """Displacements (N, 2), and (ΣFn, signed ΣFf) of all nodes in contact, without a threshold."""
    pushed, _ = _frames(fingertip, obj, state)
    return state.deformation.seen, np.array([pushed.sum(), state.friction.sum()])


def force_limit(
    sensor: SensorDesign, pressed: Press, noise: float, *, frames: int = 1, rest_frames: int = 16
) -> ForceLimit:
    """Smallest standard deviations of a contact's forces, µ and Γ from images of a sensor.

    Parameters
    ----------
    sensor: design, a dome with stiff discs
    pressed: the contact, see `press`
    noise: standard deviation of each sRGB level
    frames: averaged at the contact
    rest_frames: averaged at rest

    Raises
    ------
    UserError
        For a sensor whose markers are not stiff discs.
    """
    tip, field, nodes = pressed.fingertip, pressed.field, pressed.nodes
    white_forces, white_moves = _response(sensor, pressed, noise, frames, rest_frames)
    share, arc = tip.shares()[nodes, None], tip.arc_lengths()[nodes]

    largest = float(np.hypot(field.normal, field.friction).max())
    free = max(_AMPLITUDE, largest) * share * _root(arc, _LENGTH)
    columns = np.concatenate([axis @ free for axis in white_forces], axis=1)
    any_forces = _posterior(columns, np.kron(np.eye(2), free.sum(axis=0)))

    left = field.normal[nodes, None] * _root(arc, _LEFT_LENGTH)
    left -= left.mean(axis=0)  # the sums are those of grip and load for every history
    sizes = (LEFT_NORMAL, LEFT_FRICTION * pressed.mu)
    others = [size * axis @ left for size, axis in zip(sizes, white_forces, strict=True)]
    columns = np.concatenate([white_moves, *others], axis=1)
    outputs = np.zeros((3, columns.shape[1]))
    outputs[:2, : pressed.sums.shape[1]] = pressed.sums
    outputs[2, 0] = _MU
    covariance = _posterior(columns, outputs)

    # Γ = 1 − |ΣFf|/(µ·ΣFn)
    total, mu, friction = field.total_normal, pressed.mu, float(field.friction.sum())
    side = 1.0 if friction >= 0.0 else -1.0
    gradient = np.array([abs(friction) / total, -side, abs(friction) / mu]) / (mu * total)
    deviation = np.sqrt(np.diag(covariance))
    return ForceLimit(
        any_normal=float(np.sqrt(any_forces[0, 0])),
        any_friction=float(np.sqrt(any_forces[1, 1])),
        normal=float(deviation[0]),
        friction=float(deviation[1]),
        mu=float(deviation[2]),
        margin=float(np.sqrt(gradient @ covariance @ gradient)),
    )


def _response(
    sensor: SensorDesign, pressed: Press, noise: float, frames: int, rest_frames: int
) -> tuple[Array, Array]:
    """Response of the markers, in standard deviations of their noise.

    Returns
    -------
    forces: to a unit normal, then to a unit tangential force on each node in contact, (2, Y, K)
    moves: to `pressed.moves`, shape (Y, 9)
    """
    tip, nodes = pressed.fingertip, pressed.nodes
    at_rest, now = _rest_covariance(sensor), pair_covariance(sensor, pressed.displacement)
    covariance = noise**2 * (now / frames + at_rest / rest_frames)
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    loads = np.zeros((tip.nodes, 2, 2, len(nodes)))
    loads[nodes, :, :, np.arange(len(nodes))] = np.swapaxes(pressed.axes, -1, -2)
    forced = chain_compliance(tip, pressed.displacement, loads.reshape(tip.nodes, 2, -1), _BLUNT)
    response = MarkerResponse(sensor, np.stack([sensor.places] * 2), tip.angles())
    _, derivative = response(pressed.displacement, np.concatenate([forced, pressed.moves], axis=-1))
    white = (whiten @ derivative).reshape(-1, derivative.shape[-1])
    count = 2 * len(nodes)
    return np.moveaxis(white[:, :count].reshape(len(white), 2, -1), 1, 0), white[:, count:]


def pair_covariance(sensor: SensorDesign, displacement: Array) -> Array:
    """Cramér–Rao bound of (x, y, log size) of both layers' markers, (M, 6, 6), at noise 1 level.

    An invisible marker is infinitely uncertain.

    Parameters
    ----------
    sensor: design, with disc markers
    displacement: node displacements relative to the camera [m], shape (N, 2)
    """
    return pair_limits(sensor, MembraneMap(sensor, len(displacement))(displacement))


@lru_cache(maxsize=4)
def _rest_covariance(sensor: SensorDesign) -> Array:
    return pair_covariance(sensor, np.zeros((11, 2)))


def _root(arc: Array, length: float) -> Array:
    """Root of a smooth correlation of nodes at places along the skin [m], shape (K, K)."""
    smooth: Array = np.exp(-0.5 * ((arc[:, None] - arc) / length) ** 2) + 1e-6 * np.eye(len(arc))
    return np.linalg.cholesky(smooth).astype(np.float64)


def _posterior(columns: Array, outputs: Array) -> Array:
    """Covariance of outputs (O, D) of unit normal unknowns seen through columns (Y, D), white."""
    information = columns.T @ columns + np.eye(columns.shape[1])
    return outputs @ np.linalg.solve(information, outputs.T)
