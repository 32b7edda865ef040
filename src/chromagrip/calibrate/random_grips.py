"""Random grips and loads: those of a hand at will, and those of closed loops."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model import Drive
from .ranges import RANGES, Contact, Range, by_factor, evenly

Array = NDArray[np.float64]

#: Onset of the grip, while there is no load [s].
ONSET = 0.03
#: Largest ratio of the load to the friction limit µ·Fn: somewhat above 1 the object slides.
_MOST_HELD = 1.02


@dataclass(frozen=True)
class GripTask:
    """Limits of a random drive.

    Attributes
    ----------
    times: times of the start and of the end of each step of the plant [s], shape (T,)
    middle, half: loads are drawn within middle ± half, as a ratio to the grip
    largest: largest grip that the object carries [N]
    above: largest excess of a load over those that the object holds [N]
    drag: damper of the object [N·s/m]
    """

    times: Array
    middle: float
    half: float
    largest: float
    above: float
    drag: float

    @property
    def duration(self) -> float:
        """Length [s]."""
        return float(self.times[-1])


def random_drive(rng: np.random.Generator, contact: Contact, times: Array) -> tuple[Drive, str]:
    """Drive of any kind in DRIVES, and which.

    Parameters
    ----------
    rng: source
    contact: what is gripped
    times: at the start and at the end of each step of the plant [s], shape (T,)
    """
    cone = np.arctan(contact.obj.friction)
    low, high = (np.tan(contact.tilt + side * cone) for side in (-1.0, 1.0))
    # Share of the drives on a tilted surface whose load is about that which holds the object
    # without friction; in the others it is about none, and what is beyond the limit is cut off.
    balanced_share = 0.5
    task = GripTask(
        times=times,
        middle=(high + low) / 2 if rng.random() < balanced_share else 0.0,
        half=(high - low) / 2,
        largest=contact.largest,
        above=min(RANGES.slides_by_n, 1e-3 * RANGES.slides_at_mm_per_s[1] * contact.obj.drag),
        drag=contact.obj.drag,
    )
    kind = str(rng.choice(list(DRIVES), p=[share for share, _ in DRIVES.values()]))
    grip, load = DRIVES[kind][1](rng, task)
    trembling_share = 0.25  # share of the drives of the other kinds in which the grip trembles
    most_tremble = 0.15  # most by which such a grip trembles, as a share of it
    if kind != "tremble" and rng.random() < trembling_share:
        grip = grip * _tremble(rng, task, (RANGES.tremble[0], most_tremble))
    onset = np.minimum(task.times / ONSET, 1.0)
    touch = 0.02  # grip at the very start as a share of the first one
    grip = np.minimum(grip, task.largest) * np.maximum(onset, touch)
    load = np.clip(load, low * grip - task.above, high * grip + task.above)
    load[task.times <= ONSET] = 0.0
    return Drive(times=task.times, normal=grip, lateral=load), kind


def _limit(task: GripTask, grip: Array, share: Array | float) -> Array:
    """Load [N] that is a share, from −1 to 1, of the friction limit."""
    load: Array = grip * (task.middle + share * task.half)
    return load


def _grips(rng: np.random.Generator, task: GripTask, count: int) -> Array:
    """Grips [N]; those that the object does not carry are replaced by some that it does."""
    low, high = RANGES.grip_n
    kind = rng.random()
    if kind < 0.7:
        level = rng.uniform(*RANGES.usual_grip_n, count)
    elif kind < 0.88:
        level = np.exp(rng.uniform(np.log(low), np.log(RANGES.usual_grip_n[1]), count))
    else:
        level = rng.uniform(0.5 * RANGES.usual_grip_n[1], high, count)
    return np.where(level > task.largest, task.largest * rng.uniform(0.1, 1.0, count), level)


def _knots(rng: np.random.Generator, task: GripTask) -> Array:
    inner = np.sort(rng.uniform(ONSET, task.duration, rng.integers(2, 7)))
    return np.concatenate([[0.0, ONSET], inner, [task.duration]])


def _rests(rng: np.random.Generator, level: Array, share: float, first: int = 2) -> None:
    """Some values become that before, in place."""
    for k in range(first, len(level)):
        if rng.random() < share:
            level[k] = level[k - 1]


def _wander(rng: np.random.Generator, task: GripTask) -> Array:
    """Grip whose logarithm is straight between some times, and rests at times."""
    knots = _knots(rng, task)
    level = _grips(rng, task, len(knots))
    _rests(rng, level, 0.4)
    wandering: Array = np.exp(np.interp(task.times, knots, np.log(level)))
    return wandering


def _tremble(rng: np.random.Generator, task: GripTask, sizes: Range) -> Array:
    """Factors of a grip that trembles, each held for some steps."""
    count = len(task.times)
    # Length of time that a value of a tremble is held [s]: white to 50 Hz at the longest.
    held_for = (2e-3, 10e-3)
    held = max(round(evenly(rng, held_for) / task.times[1]), 1)
    noise = rng.standard_normal(count // held + 1).repeat(held)[:count]
    size = by_factor(rng, sizes)
    least_factor = 0.3  # smallest factor of a grip that trembles
    return np.maximum(1.0 + size * noise, least_factor)


def _side(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _share_held(rng: np.random.Generator, task: GripTask) -> Array:
    """Ratio of the load to the friction limit: ramps, rests, jumps, and it turns round."""
    knots = _knots(rng, task)
    count = len(knots)
    share = _MOST_HELD * rng.random(count) ** 0.6  # more of them near the limit
    share[:2] = 0.0
    _rests(rng, share, 0.3)
    if rng.random() < 0.4:  # pressed alone, first
        share[2] = 0.0
    share *= _side(rng)
    if rng.random() < 0.25:
        share[rng.integers(2, count) :] *= -1.0
    held = np.interp(task.times, knots, share)
    if rng.random() < 0.3:  # a weight is put on, or taken off
        at = rng.integers(len(held) // 10, len(held))
        held[at:] = np.clip(held[at:] + rng.uniform(-0.6, 0.6), -_MOST_HELD, _MOST_HELD)
    return held


def _shared(rng: np.random.Generator, task: GripTask) -> tuple[Array, Array]:
    """The load is a share of the friction limit; in some it is above it for a moment."""
    grip, share = _wander(rng, task), _share_held(rng, task)
    sliding_share = 0.2  # share of the drives in which the object slides for a moment
    slides_by = (1.05, 2.5)  # … by this ratio of load to friction limit
    moment = (0.02, 0.15)  # … and for this time [s]
    if rng.random() < sliding_share:
        start = rng.uniform(2.0 * ONSET, task.duration)
        during = (task.times >= start) & (task.times < start + evenly(rng, moment))
        share[during] = (np.sign(share[during].sum()) or _side(rng)) * evenly(rng, slides_by)
    return grip, _limit(task, grip, share)


def _own_load(rng: np.random.Generator, task: GripTask, most: float) -> Array:
    """Load [N] up to a largest one that steps, ramps, swings and rests by itself."""
    side, times = _side(rng), task.times
    if rng.random() < 0.2:
        period, phase = by_factor(rng, (0.05, 1.0)), rng.uniform(0.0, 2.0 * np.pi)
        mean = rng.uniform(0.0, 0.7)
        swing = mean + (1.0 - mean) * np.sin(2.0 * np.pi * times / period + phase)
        return side * most * swing * np.clip((times - ONSET) / 0.05, 0.0, 1.0)
    knots = _knots(rng, task)
    level = most * rng.random(len(knots)) ** 0.6
    level[: rng.integers(2, 4)] = 0.0
    _rests(rng, level, 0.5, 3)
    if rng.random() < 0.2:  # it turns round
        level[rng.integers(2, len(knots)) :] *= -1.0
    if rng.random() < 0.5:  # in steps
        load = level[np.searchsorted(knots, times, side="right") - 1]
    else:
        load = np.interp(times, knots, level)
    return side * load


def _independent(rng: np.random.Generator, task: GripTask) -> tuple[Array, Array]:
    """Draw grip and load independently; the grip is raised where it could not hold the load."""
    grip = _wander(rng, task)
    load = _own_load(rng, task, task.half * by_factor(rng, (0.2, 2.0)) * float(grip.max()))
    return np.maximum(grip, abs(load) / (_MOST_HELD * task.half)), load + task.middle * grip


def _stepping(rng: np.random.Generator, task: GripTask) -> tuple[Array, Array]:
    """The grip steps up once or twice under a load near the friction limit, and rests."""
    reacts = rng.random() < 0.3
    reacting = (0.5, 2.0)  # grip that React To Slip starts with, and adds [N]
    grip = min(reacting[0], 0.3 * task.largest) if reacts else float(_grips(rng, task, 1)[0])
    if rng.random() < 0.6:
        grip *= rng.uniform(0.15, 0.6)
    side = _side(rng)
    share = rng.uniform(0.75, 1.05)
    now = ONSET + rng.uniform(0.0, 0.05)
    knots, grips, loads = [0.0, now], [grip, grip], [0.0, 0.0]

    def to(after: float, load: float) -> None:
        knots.append(knots[-1] + after)
        grips.append(grip)
        loads.append(load)

    rise = (2e-3, 30e-3)  # length of a step of the grip [s]
    for _ in range(rng.integers(1, 4)):
        load = float(_limit(task, np.array(grip), side * share))
        to(by_factor(rng, (1e-3, 0.2)), load)
        to(rng.uniform(0.0, 0.1), load)
        grip = grip + reacting[1] if reacts else grip * by_factor(rng, RANGES.grip_step)
        to(by_factor(rng, rise), load)
        to(rng.uniform(0.02, 0.3), load)
        if rng.random() < 0.5:  # the same load for good
            break
    times = np.array(knots)
    return np.interp(task.times, times, grips), np.interp(task.times, times, loads)


def _following(rng: np.random.Generator, task: GripTask) -> tuple[Array, Array]:
    """The grip follows the load to a safety margin, late and with noise, as controllers do."""
    dt = float(task.times[1])
    taken = (0.75, 1.4)  # ratio of the µ that the controller takes to the true one
    desired = (0.1, 0.6)  # desired safety margins
    ratio = task.half * evenly(rng, taken) * (1.0 - evenly(rng, desired))
    load = _own_load(rng, task, ratio * float(_grips(rng, task, 1)[0]))
    least = min(by_factor(rng, (0.03, 0.8)), 0.3 * task.largest)
    noise = by_factor(rng, (0.005, 0.1)) * rng.standard_normal(len(load))
    need = np.maximum(abs(load) / ratio * (1.0 + noise), least)
    frame = max(round(rng.choice([dt, 0.01, 1 / 60, 1 / 30]) / dt), 1)
    late = frame * int(rng.integers(1, 3))
    need = np.concatenate([np.full(late, least), need])[: len(load)]
    need = need[np.arange(len(need)) // frame * frame]
    lag = (4e-3, 80e-3)  # time constant by which a grip follows a load [s]
    follows = 1.0 - np.exp(-dt / by_factor(rng, lag))
    falls = dt * by_factor(rng, (1.0, 100.0))
    grip, now = np.empty(len(load)), least
    for k, goal in enumerate(need):
        now += max(follows * (goal - now), -falls)
        grip[k] = now
    return grip, load + task.middle * grip


def _releasing(rng: np.random.Generator, task: GripTask) -> tuple[Array, Array]:
    """The grip falls slowly under a standing load, until the object slides."""
    high = float(_grips(rng, task, 1)[0])
    share = rng.uniform(0.15, 0.85)
    low = high * share * rng.uniform(0.8, 1.1)
    pulled = ONSET + by_factor(rng, (2e-3, 0.1))
    starts = pulled + rng.uniform(0.0, 0.3) * task.duration
    ends = rng.uniform(0.6, 1.0) * task.duration
    knots = np.array([0.0, starts, max(ends, starts + 0.02)])
    grip = np.exp(np.interp(task.times, knots, np.log([high, high, low])))
    load = _side(rng) * share * task.half * high
    rise = np.clip((task.times - ONSET) / (pulled - ONSET), 0.0, 1.0)
    return grip, rise * load + task.middle * grip


def _sliding(rng: np.random.Generator, task: GripTask) -> tuple[Array, Array]:
    """The load is above the friction limit for long: dragged slowly, or too heavy."""
    grip = (
        _wander(rng, task)
        if rng.random() < 0.5
        else np.full(len(task.times), _grips(rng, task, 1)[0])
    )
    side = _side(rng)
    start = ONSET + rng.uniform(0.0, 0.4) * task.duration
    ends = task.duration if rng.random() < 0.4 else start + rng.uniform(0.05, 0.5)
    speed = 1e-3 * by_factor(rng, RANGES.slides_at_mm_per_s)
    before, after = rng.uniform(0.0, 1.0), rng.uniform(-0.2, 1.0)
    share = np.interp(task.times, [ONSET, start], [0.0, before])
    share[task.times > ends] = after
    load = _limit(task, grip, side * share)
    during = (task.times > start) & (task.times <= ends)
    above = min(task.drag * speed, task.above)
    load[during] = _limit(task, grip, side)[during] + side * above
    return grip, load


def _trembling(rng: np.random.Generator, task: GripTask) -> tuple[Array, Array]:
    """The grip trembles all the time, as where a controller takes noise for a change."""
    grip, load = _following(rng, task) if rng.random() < 0.5 else _independent(rng, task)
    if rng.random() < 0.3:
        grip = np.full(len(grip), grip.mean())
    # Least by which a grip trembles that does so all the time, as a share of it.
    least_tremble = 0.04
    return grip * _tremble(rng, task, (least_tremble, RANGES.tremble[1])), load


#: Kinds of drive, each with its share.
DRIVES: dict[str, tuple[float, Callable[[np.random.Generator, GripTask], tuple[Array, Array]]]] = {
    "shared": (0.28, _shared),
    "independent": (0.12, _independent),
    "step": (0.17, _stepping),
    "follow": (0.16, _following),
    "release": (0.08, _releasing),
    "slide": (0.09, _sliding),
    "tremble": (0.10, _trembling),
}
