"""What force and friction estimates said of grasps, against what is true of them.

Four quantities are asked for: ΣFn [N], ΣFf [N], µ and Γ. A frame without an estimate counts as what
a controller is given then: no force, hence no µ, and the margin of a grip that holds nothing.
"""

import time
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from ...errors import UserError
from ...loop.observers import ForceObserver, margin_deviation
from ...model import ForceField, FrictionReading
from ...tracking import Z90, NoEstimateError, load_reconstructor
from ...tracking.forces.friction import FRICTION
from ..limits.forces import force_limit, press
from .grasps import HELD_FRAMES, NOISE, PERIOD, REST_FRAMES, ForceScene

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

QUANTITIES = ("normal", "friction", "mu", "margin")
#: Frames that are read, in order, after a reset.
READ = {"single": 1, "0.1s": HELD_FRAMES}
#: Name of the answer that never looks.
CONSTANT = "constant"
#: Γ around that at which grips are held, and Γ below which enough slips to show µ.
NEAR, OBSERVABLE = (0.2, 0.4), 0.85
#: Nothing touches: what a controller is told where there is no estimate.
_NOTHING = np.array([0.0, 0.0, 0.0, 1.0])
#: Unit of every score.
UNITS = {
    "normal_rms": "%",
    "normal_bias": "%",
    "friction_rms": "N",
    "friction_share": "%",
    "mu_rms": "",
    "mu_bias": "",
    "margin_rms": "",
    "margin_bias": "",
    "margin_near_rms": "",
    **{f"{quantity}_coverage": "%" for quantity in QUANTITIES},
    **{f"{quantity}_width": "× RMS" for quantity in QUANTITIES},
    **{f"{quantity}_limit": "× limit" for quantity in QUANTITIES},
    "flagged": "%",
    "wrong": "%",
    "scenes": "",
}


@dataclass(frozen=True, kw_only=True)
class Answers:
    """What was said of S scenes: (ΣFn, ΣFf, µ, Γ) in the last axis but one or the last.

    Attributes
    ----------
    value: shape (S, 4)
    interval: 90 % intervals, NaN where there is none, shape (S, 4, 2)
    flagged: said to be without an estimate, shape (S,)
    """

    value: Array
    interval: Array
    flagged: Mask

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Answers to the scenes of several."""
        return cls(
            value=np.concatenate([part.value for part in parts]),
            interval=np.concatenate([part.interval for part in parts]),
            flagged=np.concatenate([part.flagged for part in parts]),
        )


def truth(scene: ForceScene) -> Array:
    """True (ΣFn, ΣFf, µ, Γ) of a scene, shape (4,)."""
    field = scene.field
    return np.array([field.total_normal, field.total_friction, scene.obj.friction, scene.margin])


def answers(reconstructor: str, scene: ForceScene) -> dict[tuple[str, str], Answers]:
    """What is said of a scene, each of shape (1, …), by (name, READ).

    The observer's answer bears the reconstructor's name; `reconstructor+method` are those with each
    reading of friction off the last field alone, flagged where there is none.

    Parameters
    ----------
    reconstructor: see `load_reconstructor`
    scene: of which the last frame is asked for
    """
    fresh = ForceObserver(scene.known, scene.rest, reconstructor, HELD_FRAMES * PERIOD)
    found = {}
    for read, frames in READ.items():
        observer = deepcopy(fresh)  # that has seen nothing
        said = [observer.observe(tracks.time, tracks) for tracks in scene.tracks[-frames:]][-1]
        found[reconstructor, read] = _answer(
            said.field,
            (said.friction, said.margin),
            (said.friction_interval, said.margin_interval),
            bool(said.no_estimate),
        )
        for method, reading in FRICTION.items():
            found[f"{reconstructor}+{method}", read] = _read(said.field, reading(said.field))
    return found


def _read(field: ForceField, reading: FrictionReading) -> Answers:
    mu, margin = reading.value, field.safety_margin(reading.value)
    off = Z90 * np.array([reading.deviation, margin_deviation(field, mu, reading.deviation)])
    low, high = np.array([mu, margin]) - off, np.array([mu, margin]) + off
    return _answer(field, (mu, margin), ((low[0], high[0]), (low[1], high[1])), not np.isfinite(mu))


def _answer(
    field: ForceField,
    ratios: tuple[float, float],
    intervals: tuple[tuple[float, float], tuple[float, float]],
    flagged: bool,
) -> Answers:
    """One answer from a field and (µ, Γ) with their intervals."""
    value = np.array([field.total_normal, field.total_friction, *ratios])
    spread = Z90 * np.sqrt(np.diag(field.totals_covariance))
    sums = np.stack([value[:2] - spread, value[:2] + spread], axis=1)
    interval = np.concatenate([sums, intervals])
    return Answers(
        value=np.where(np.isfinite(value), value, _NOTHING)[None],
        interval=np.where(np.isfinite(interval), interval, np.nan)[None],
        flagged=np.array([flagged]),
    )


def constant(true: Array) -> Answers:
    """The best answer that does not look: the mean of all scenes (S, 4), and how they scatter."""
    spread = Z90 * true.std(axis=0)
    mean = np.broadcast_to(true.mean(axis=0), true.shape)
    return Answers(
        value=mean,
        interval=np.stack([mean - spread, mean + spread], axis=-1),
        flagged=np.zeros(len(true), dtype=np.bool_),
    )


def limits(scene: ForceScene, frames: int) -> Array:
    """Smallest standard deviations of (ΣFn, ΣFf, µ, Γ) that so many frames leave, shape (4,).

    Those of the sums are of any smooth forces in the true zone, those of µ and Γ of any object;
    both where this object is in balance under the true sums, however it came there. NaN where it
    is not, or not with a little more of anything.
    """
    field = scene.field
    try:
        pressed = press(
            scene.specimen.fingertip, scene.obj, field.total_normal, field.total_friction
        )
    except UserError:
        return np.full(4, np.nan)
    bound = force_limit(
        scene.specimen.sensor, pressed, NOISE, frames=frames, rest_frames=REST_FRAMES
    )
    return np.array([bound.any_normal, bound.any_friction, bound.mu, bound.margin])


def scores(said: Answers, true: Array, limit: Array | None = None) -> dict[str, float]:
    """Every score of UNITS; those of the limit only with one, NaN for what was not to be seen.

    Parameters
    ----------
    said: answers to S scenes
    true: (ΣFn, ΣFf, µ, Γ) of each, shape (S, 4)
    limit: smallest standard deviations of each, NaN where not known, shape (S, 4)
    """
    error = said.value - true
    normal, friction, mu, margin = true.T
    asked = np.ones_like(true, dtype=np.bool_)
    asked[:, 2] = margin < OBSERVABLE
    near = (margin >= NEAR[0]) & (margin <= NEAR[1])
    found = {
        "normal_rms": 100.0 * _rms(error[:, 0] / normal),
        "normal_bias": 100.0 * _mean(error[:, 0] / normal),
        "friction_rms": _rms(error[:, 1]),
        "friction_share": 100.0 * _rms(error[:, 1]) / _rms(friction),
        "mu_rms": _rms(error[asked[:, 2], 2]),
        "mu_bias": _mean(error[asked[:, 2], 2]),
        "margin_rms": _rms(error[:, 3]),
        "margin_bias": _mean(error[:, 3]),
        "margin_near_rms": _rms(error[near, 3]),
    }
    low, high = np.moveaxis(said.interval, -1, 0)
    covers = (low <= true) & (true <= high)  # no interval covers nothing
    for k, name in enumerate(QUANTITIES):
        known = ~said.flagged & asked[:, k]
        found[f"{name}_coverage"] = 100.0 * _mean(covers[known, k])
        half, rms = 0.5 * _mean((high - low)[known, k]), _rms(error[known, k])
        found[f"{name}_width"] = half / rms if rms > 0.0 else float("nan")
        if limit is not None:
            there = asked[:, k] & np.isfinite(limit[:, k])
            found[f"{name}_limit"] = _rms(error[there, k] / limit[there, k])
    found["flagged"] = 100.0 * _mean(said.flagged)
    far = (abs(error[:, 0]) > 0.5 * normal) | (abs(error[:, 3]) > 0.5)
    far |= asked[:, 2] & (abs(error[:, 2]) > 0.5 * mu)
    found["wrong"] = 100.0 * _mean(far & ~said.flagged)
    found["scenes"] = float(len(true))
    return found


def times(names: Sequence[str], scenes: Sequence[ForceScene], turns: int) -> dict[str, list[float]]:
    """Time per field of each reconstructor in each turn, in one thread [ms].

    All take their turns one after the other, so that what else the machine does falls on all.
    """
    spent: dict[str, list[float]] = {name: [] for name in names}
    with threadpool_limits(1):
        made = {n: [load_reconstructor(n)(s.known, s.rest) for s in scenes] for n in names}
        for _ in range(1 + turns):  # the first compiles and warms up
            for name, readers in made.items():
                begin = time.perf_counter()
                for reader, scene in zip(readers, scenes, strict=True):
                    reader.reset()
                    for tracks in scene.tracks:
                        try:
                            reader.update(tracks)
                        except NoEstimateError:
                            continue
                passed = time.perf_counter() - begin
                spent[name].append(1e3 * passed / (len(scenes) * HELD_FRAMES))
    return {name: all_turns[1:] for name, all_turns in spent.items()}


def _rms(values: Array) -> float:
    return float(np.sqrt(_mean(values**2)))


def _mean(values: Array | Mask) -> float:
    """Mean of what is there."""
    there = values[np.isfinite(values)]
    return float(there.mean()) if len(there) else float("nan")
