"""Random grips and loads on random objects: what a read-out is trained on.

Wider than anything it will be asked about, so that it need not be right by chance at an edge. The
object's Dahl parameters and drag vary too: they are its own, and no estimator knows them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model import ContactObject, Drive, Fingertip, ModelError, contact_forces, simulate

Array = NDArray[np.float64]

#: Length of a history and step of the plant [s]; every so many steps are looked at.
DURATION, STEP, EVERY = 1.0, 2e-3, 5
#: Onset of the grip, while there is no load [s].
_ONSET = 0.03
#: The load is at most so many times what friction holds: somewhat more slides.
_MOST_HELD = 1.02
#: Share of the drives in which it slides for a moment: load over what friction holds, at most so
#: much more [N], and how long [s].
_SLIDING, _SLIDES_BY, _MOST_MORE, _MOMENT = 0.3, (1.05, 2.5), 0.5, (0.02, 0.15)
#: Share of the drives in which the grip trembles: by which share of itself, standard deviation,
#: what at least is left of it, and how many steps a value is held.
_TREMBLING, _TREMBLES_BY, _LEAST_OF_GRIP, _HELD_STEPS = 0.3, (0.003, 0.15), 0.3, (1, 6)
#: Instants kept of a history, spread over the margin in so many bins.
_KEPT, _BINS = 12, 8


@dataclass(frozen=True, kw_only=True)
class Snapshots:
    """Instants of many histories.

    Attributes
    ----------
    seen: node displacements relative to the rigid part [m], shape (S, N, 2)
    normal, friction: true nodal forces [N], shape (S, N)
    totals: true ΣFn, signed ΣFf [N] and µ, shape (S, 3)
    history: number of the history, shape (S,)
    """

    seen: NDArray[np.float32]
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
    """Grip and load that ramp, rest, jump and turn, the load never far above what friction holds.

    In half of the drives the load is a share of what the grip can hold, in the others grip and load
    go their own ways, as where a controller grips harder under a standing load. Now and then it is
    more for a moment, as where a weight is put on before a controller grips harder. Some grips
    tremble, as where a controller takes noise of the image for a change.

    Parameters
    ----------
    rng: source
    friction: µ of the object
    """
    times = np.linspace(0.0, DURATION, 501)
    onset = times <= _ONSET
    apart = rng.random() < 0.5
    grip = np.exp(np.interp(times, *_wander(rng, 0.05, 7.0)))
    if apart:
        load = _own_load(rng, times, friction)
        load[onset] = 0.0
        grip = np.maximum(grip, abs(load) / (_MOST_HELD * friction))
    grip[onset] = np.maximum(grip[onset] * times[onset] / _ONSET, 0.02)
    if not apart:
        load = _share_held(rng, times) * friction * grip
        load[onset] = 0.0
    if rng.random() < _SLIDING:
        _slide(rng, times, friction * grip, load)
    if rng.random() < _TREMBLING:
        grip *= _tremble(rng, len(times))
    return Drive(times=times, normal=grip, lateral=load)


def _slide(rng: np.random.Generator, times: Array, held: Array, load: Array) -> None:
    """Let the load be more than what is held [N] for a moment, in place."""
    start = rng.uniform(2.0 * _ONSET, DURATION)
    during = (times >= start) & (times < start + rng.uniform(*_MOMENT))
    side = np.sign(load[during].sum()) or rng.choice([-1.0, 1.0])
    more = np.minimum((rng.uniform(*_SLIDES_BY) - 1.0) * held[during], _MOST_MORE)
    load[during] = side * (held[during] + more)


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
    """Load over what friction holds."""
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
    """Load [N] that steps, ramps and rests, whatever the grip does."""
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
            # Many histories rest without a load: they need not be seen again and again.
            if bins[place] >= (1 if place == _BINS - 1 else 2):
                continue
            bins[place] += 1
            signed = float(field.friction[field.contact].sum())
            totals = (field.total_normal, signed, obj.friction)
            seen = state.deformation.seen
            kept.append((seen, field.normal, field.friction, totals, number))
            if bins.sum() == _KEPT:
                break
    moved, press, drag, sums, history = zip(*kept, strict=True)
    return Snapshots(
        seen=np.array(moved, dtype=np.float32),
        normal=np.array(press, dtype=np.float32),
        friction=np.array(drag, dtype=np.float32),
        totals=np.array(sums),
        history=np.array(history),
    )


def with_mirrored(seen: Snapshots) -> Snapshots:
    """Snapshots, and the same with x turned round, which the model does not tell apart."""
    flip = np.array([-1.0, 1.0], dtype=np.float32)
    turn = np.array([1.0, -1.0, 1.0])
    return Snapshots(
        seen=np.concatenate([seen.seen, seen.seen[:, ::-1] * flip]),
        normal=np.concatenate([seen.normal, seen.normal[:, ::-1]]),
        friction=np.concatenate([seen.friction, -seen.friction[:, ::-1]]),
        totals=np.concatenate([seen.totals, seen.totals * turn]),
        history=np.concatenate([seen.history, seen.history]),
    )
