"""Random grips and loads on random objects, on which a read-out is trained.

Their ranges are wider than those of use, so that no use lies at an edge of the training. The
object's Dahl parameters and drag vary too: they belong to the object, and no estimator knows them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model import ContactObject, Drive, Fingertip, ModelError, contact_forces, simulate

Array = NDArray[np.float64]

#: Length of a history [s].
DURATION = 1.0
#: Step of the plant [s].
STEP = 2e-3
#: Number of steps from one instant that may be kept to the next.
EVERY = 5
#: Onset of the grip, while there is no load [s].
_ONSET = 0.03
#: Largest ratio of the load to the friction limit µ·Fn: somewhat above 1 the object slides.
_MOST_HELD = 1.02
#: Share of the drives in which the object slides for a moment.
_SLIDING = 0.3
#: Ratio of load to friction limit while it slides, smallest and largest.
_SLIDES_BY = (1.05, 2.5)
#: Largest load above the friction limit while it slides [N].
_MOST_ABOVE = 0.5
#: Length of such a slide, shortest and longest [s].
_MOMENT = (0.02, 0.15)
#: Share of the drives in which the grip trembles.
_TREMBLING = 0.3
#: Standard deviation of the tremble as a share of the grip, smallest and largest.
_TREMBLES_BY = (0.003, 0.15)
#: Smallest factor of a grip that trembles.
_LEAST_OF_GRIP = 0.3
#: Number of steps that a value of the tremble is held, smallest and one more than the largest.
_HELD_STEPS = (1, 6)
#: Instants kept of a history.
_KEPT = 12
#: Bins of Γ over which they are spread.
_BINS = 8


@dataclass(frozen=True, kw_only=True)
class Snapshots:
    """Instants of many histories.

    Attributes
    ----------
    displacement: of the nodes relative to the rigid part [m], shape (S, N, 2)
    normal, friction: true nodal forces [N], shape (S, N)
    totals: true ΣFn, signed ΣFf [N] and µ, shape (S, 3)
    history: number of the history, shape (S,)
    """

    displacement: NDArray[np.float32]
    normal: NDArray[np.float32]
    friction: NDArray[np.float32]
    totals: Array
    history: NDArray[np.int64]


def random_object(rng: np.random.Generator) -> ContactObject:
    """Flat or round object from soft to stiff, from slippery to rough."""
    return ContactObject(
        stiffness=float(np.exp(rng.uniform(np.log(70.0), np.log(1200.0)))),
        friction=rng.uniform(0.15, 1.0),
        curvature=0.0 if rng.random() < 0.15 else rng.uniform(0.0, 240.0),
        dahl_stiffness=float(np.exp(rng.uniform(np.log(4000.0), np.log(6300.0)))),
        dahl_exponent=rng.uniform(0.65, 0.75),
        drag=rng.uniform(80.0, 160.0),
    )


def random_drive(rng: np.random.Generator, friction: float) -> Drive:
    """Grip and load that ramp, rest, jump and turn, the load never far above the friction limit.

    In half of the drives the load is a share of the friction limit, in the others grip and load are
    independent, as where a controller grips harder under a standing load. In some the load is above
    the limit for a moment, as where a weight is added before a controller grips harder. In some the
    grip trembles, as where a controller takes noise of the image for a change.

    Parameters
    ----------
    rng: source
    friction: µ of the object
    """
    times = np.linspace(0.0, DURATION, 501)
    onset = times <= _ONSET
    independent = rng.random() < 0.5
    grip = np.exp(np.interp(times, *_wander(rng, 0.05, 7.0)))
    if independent:
        load = _own_load(rng, times, friction)
        load[onset] = 0.0
        grip = np.maximum(grip, abs(load) / (_MOST_HELD * friction))
    grip[onset] = np.maximum(grip[onset] * times[onset] / _ONSET, 0.02)
    if not independent:
        load = _share_held(rng, times) * friction * grip
        load[onset] = 0.0
    if rng.random() < _SLIDING:
        _slide(rng, times, friction * grip, load)
    if rng.random() < _TREMBLING:
        grip *= _tremble(rng, len(times))
    return Drive(times=times, normal=grip, lateral=load)


def _slide(rng: np.random.Generator, times: Array, limit: Array, load: Array) -> None:
    """Raise the load above the friction limit [N] for a moment, in place."""
    start = rng.uniform(2.0 * _ONSET, DURATION)
    during = (times >= start) & (times < start + rng.uniform(*_MOMENT))
    side = np.sign(load[during].sum()) or rng.choice([-1.0, 1.0])
    above = np.minimum((rng.uniform(*_SLIDES_BY) - 1.0) * limit[during], _MOST_ABOVE)
    load[during] = side * (limit[during] + above)


def _tremble(rng: np.random.Generator, count: int) -> Array:
    """Factors of a grip that trembles, each held for some steps."""
    held = rng.integers(*_HELD_STEPS)
    noise = rng.standard_normal(count // held + 1).repeat(held)[:count]
    size = np.exp(rng.uniform(*np.log(_TREMBLES_BY)))
    return np.maximum(1.0 + size * noise, _LEAST_OF_GRIP)


def _wander(rng: np.random.Generator, low: float, high: float) -> tuple[Array, Array]:
    """Times [s] and logarithms of a force [N] that is straight between them, and rests at times."""
    knots = _knots(rng)
    count = len(knots)
    level = np.log(rng.uniform(low, high, count))
    if rng.random() < 0.3:
        level = rng.uniform(np.log(low), np.log(high), count)
    for k in range(2, count):
        if rng.random() < 0.4:
            level[k] = level[k - 1]
    return knots, level


def _knots(rng: np.random.Generator) -> Array:
    inner = np.sort(rng.uniform(_ONSET, DURATION, rng.integers(2, 8)))
    return np.concatenate([[0.0, _ONSET], inner, [DURATION]])


def _share_held(rng: np.random.Generator, times: Array) -> Array:
    """Ratio of the load to the friction limit."""
    knots = _knots(rng)
    count = len(knots)
    share = rng.uniform(0.0, _MOST_HELD, count)
    share[:2] = 0.0
    for k in range(2, count):
        if rng.random() < 0.3:
            share[k] = share[k - 1]
    if rng.random() < 0.5:  # pressed alone, first
        share[2] = 0.0
    share *= rng.choice([-1.0, 1.0])
    if rng.random() < 0.25:  # the load turns round
        share[rng.integers(2, count) :] *= -1.0
    held = np.interp(times, knots, share)
    if rng.random() < 0.3:  # a weight is put on, or taken off
        at = rng.integers(30, 480)
        held[at:] = np.clip(held[at:] + rng.uniform(-0.6, 0.6), -_MOST_HELD, _MOST_HELD)
    return held


def _own_load(rng: np.random.Generator, times: Array, friction: float) -> Array:
    """Load [N] that steps, ramps and rests, independent of the grip."""
    knots = _knots(rng)
    most = friction * np.exp(rng.uniform(np.log(0.1), np.log(6.0)))
    level = most * rng.uniform(0.0, 1.0, len(knots))
    level[: rng.integers(2, 4)] = 0.0
    for k in range(3, len(knots)):
        if rng.random() < 0.5:
            level[k] = level[k - 1]
    if rng.random() < 0.2:  # the load turns round
        level[rng.integers(2, len(knots)) :] *= -1.0
    if rng.random() < 0.5:  # in steps
        load = level[np.searchsorted(knots, times, side="right") - 1]
    else:
        load = np.interp(times, knots, level)
    return rng.choice([-1.0, 1.0]) * load


def snapshots(fingertip: Fingertip, numbers: range) -> Snapshots:
    """Instants of the histories of these numbers; the same number gives the same history.

    A history that the plant cannot follow to its end is left out.
    """
    kept = []
    for number in numbers:
        rng = np.random.default_rng([77, number])
        obj = random_object(rng)
        drive = random_drive(rng, obj.friction)
        try:
            run = simulate(fingertip, obj, drive, dt=STEP, duration=DURATION, every=EVERY)
        except ModelError:
            continue
        bins = np.zeros(_BINS, dtype=int)
        for index in rng.permutation(np.arange(3, len(run))):
            state = run.state(int(index))
            field = contact_forces(fingertip, obj, state)
            if not field.contact.any():
                continue
            margin = field.safety_margin(obj.friction)
            place = int(np.clip(margin * _BINS, 0, _BINS - 1))
            # Many histories rest without a load, of which few instants suffice.
            if bins[place] >= (1 if place == _BINS - 1 else 2):
                continue
            bins[place] += 1
            signed = float(field.friction[field.contact].sum())
            totals = (field.total_normal, signed, obj.friction)
            displacement = state.deformation.seen
            kept.append((displacement, field.normal, field.friction, totals, number))
            if bins.sum() == _KEPT:
                break
    displacements, press, drag, sums, history = zip(*kept, strict=True)
    return Snapshots(
        displacement=np.array(displacements, dtype=np.float32),
        normal=np.array(press, dtype=np.float32),
        friction=np.array(drag, dtype=np.float32),
        totals=np.array(sums),
        history=np.array(history),
    )


def with_mirrored(instants: Snapshots) -> Snapshots:
    """Snapshots, and the same with x turned round, under which the model is symmetric."""
    flip = np.array([-1.0, 1.0], dtype=np.float32)
    turn = np.array([1.0, -1.0, 1.0])
    return Snapshots(
        displacement=np.concatenate([instants.displacement, instants.displacement[:, ::-1] * flip]),
        normal=np.concatenate([instants.normal, instants.normal[:, ::-1]]),
        friction=np.concatenate([instants.friction, -instants.friction[:, ::-1]]),
        totals=np.concatenate([instants.totals, instants.totals * turn]),
        history=np.concatenate([instants.history, instants.history]),
    )
