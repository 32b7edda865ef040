"""Scores of force and friction estimates of grasps against the truth.

Four quantities are scored: ΣFn [N], ΣFf [N], µ and Γ. A frame without an estimate counts as the
values that a controller is given then: no force, hence no µ, and the margin of a grip without load.
"""

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...by_name import Choice
from ...control import GripObservation
from ...errors import UserError
from ...model import ForceField, FrictionReading
from ...output.processes import one_thread
from ...sensing.observers import ForceObserver, margin_interval
from ...tracking import FRICTION, Z90, NoEstimateError, load_reconstructor
from ..limits.forces import force_limit, press
from .force_scenes import HELD_FRAMES, NOISE, PERIOD, REST_FRAMES, ForceScene

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

QUANTITIES = ("normal", "friction", "mu", "margin")
#: Number of frames that are read one after the other after a reset, by name: the last one, those
#: of 0.1 s, or all since before the touch.
READ = {"single": 1, "0.1s": HELD_FRAMES, "way": 1_000_000}
#: Reconstructor that follows a contact from its first frame on; others are not read in that way.
FOLLOWING = "way"
#: Name of the answer that uses no image.
CONSTANT = "constant"
#: Range of Γ around the value at which grips are held.
NEAR = (0.2, 0.4)
#: Γ below which enough of the contact slips to show µ.
OBSERVABLE = 0.85
#: Values that a controller is given where there is no estimate: nothing touches.
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
    "far_off": "%",
    "scenes": "",
}


@dataclass(frozen=True, kw_only=True)
class Answers:
    """Estimates of (ΣFn [N], ΣFf [N], µ, Γ) in S scenes.

    Attributes
    ----------
    value: shape (S, 4)
    interval: 90 % intervals, NaN where there is none and infinite where it has no end, (S, 4, 2)
    flagged: whether the reconstructor reported that it has no estimate, shape (S,)
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
    return np.array([field.total_normal, field.total_friction, scene.friction, scene.margin])


def reads_of(name: str) -> tuple[str, ...]:
    """Keys of READ in which a reconstructor is read."""
    return ("way",) if name == FOLLOWING else ("single", "0.1s")


def answers(name: str, reconstructor: Choice, scene: ForceScene) -> dict[str, dict[str, Answers]]:
    """Estimates of a scene, each of shape (1, …), by the key of READ and by name.

    The observer's estimates have the reconstructor's name. `reading_name` are those with another
    reading of friction off the field of a single frame, flagged where it gives no µ.

    Parameters
    ----------
    name: of the reconstructor
    reconstructor: see `load_reconstructor`
    scene: whose last frame is estimated
    """
    if scene.refused:
        return refused(name)
    fresh = ForceObserver(scene.known, scene.rest, reconstructor, HELD_FRAMES * PERIOD)
    result: dict[str, dict[str, Answers]] = {read: {} for read in READ}
    for read in reads_of(name):
        frames, observer = READ[read], deepcopy(fresh)
        for tracks in scene.tracks[-frames:]:
            observation = observer.observe(tracks.time, tracks)
        result[read][name] = answer_of(observation)
        if frames == 1:
            for method, reading in FRICTION.items():
                field = observation.field
                result[read][reading_name(name, method)] = _read(field, reading(field))
    return result


def answer_of(observation: GripObservation) -> Answers:
    """What an observer says of one frame, of shape (1, …)."""
    return _answer(
        observation.field,
        (observation.friction, observation.margin),
        (observation.friction_interval, observation.margin_interval),
        bool(observation.no_estimate),
    )


def refused(name: str) -> dict[str, dict[str, Answers]]:
    """Answers of a reconstructor, or of its tracker, that refuses the frames, as of `answers`."""
    nothing = Answers(
        value=_NOTHING[None], interval=np.full((1, 4, 2), np.nan), flagged=np.array([True])
    )
    result: dict[str, dict[str, Answers]] = {read: {} for read in READ}
    for read in reads_of(name):
        result[read] = {name: nothing}
    if name != FOLLOWING:
        result["single"] |= {reading_name(name, method): nothing for method in FRICTION}
    return result


def reading_name(reconstructor: str, method: str) -> str:
    """Name of a method of reading friction off a reconstructor's field."""
    return f"{reconstructor}+{method}"


def _read(field: ForceField, reading: FrictionReading) -> Answers:
    mu, margin = reading.value, field.safety_margin(reading.value)
    spread = Z90 * reading.deviation
    intervals = (mu - spread, mu + spread), margin_interval(field, mu, reading.deviation)
    return _answer(field, (mu, margin), intervals, not np.isfinite(mu))


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
        interval=np.where(flagged, np.nan, interval)[None],
        flagged=np.array([flagged]),
    )


def constant(true: Array) -> Answers:
    """The best answer without an image: mean and scatter of the true values, shape (S, 4)."""
    spread = Z90 * true.std(axis=0)
    mean = np.broadcast_to(true.mean(axis=0), true.shape)
    return Answers(
        value=mean,
        interval=np.stack([mean - spread, mean + spread], axis=-1),
        flagged=np.zeros(len(true), dtype=np.bool_),
    )


def limits(scene: ForceScene, frames: int) -> Array:
    """Smallest standard deviations of (ΣFn, ΣFf, µ, Γ) after so many frames, shape (4,).

    The limits of the sums are of any smooth forces in the true zone, those of µ and Γ of any
    object. Both are taken at an equilibrium of this object under the true sums, whose history may
    differ. They are NaN where the model has no such equilibrium, or none close to it.
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


def scores(estimate: Answers, true: Array, limit: Array | None = None) -> dict[str, float]:
    """Every score of UNITS; those of the limit only with one. NaN where nothing was observable.

    Parameters
    ----------
    estimate: estimates of S scenes
    true: (ΣFn, ΣFf, µ, Γ) of each, shape (S, 4)
    limit: smallest standard deviations of each, NaN where not known, shape (S, 4)
    """
    error = estimate.value - true
    normal, friction, mu, margin = true.T
    scored = np.ones_like(true, dtype=np.bool_)
    scored[:, 2] = margin < OBSERVABLE
    near = (margin >= NEAR[0]) & (margin <= NEAR[1])
    result = {
        "normal_rms": 100.0 * rms(error[:, 0] / normal),
        "normal_bias": 100.0 * average(error[:, 0] / normal),
        "friction_rms": rms(error[:, 1]),
        "friction_share": 100.0 * rms(error[:, 1]) / rms(friction),
        "mu_rms": rms(error[scored[:, 2], 2]),
        "mu_bias": average(error[scored[:, 2], 2]),
        "margin_rms": rms(error[:, 3]),
        "margin_bias": average(error[:, 3]),
        "margin_near_rms": rms(error[near, 3]),
    }
    low, high = np.moveaxis(estimate.interval, -1, 0)
    # No interval covers nothing, nor does one without an end.
    covers = (low <= true) & (true <= high) & np.isfinite(high - low)
    for k, name in enumerate(QUANTITIES):
        known = ~estimate.flagged & scored[:, k]
        result[f"{name}_coverage"] = 100.0 * average(covers[known, k])
        half, size = 0.5 * average((high - low)[known, k]), rms(error[known, k])
        result[f"{name}_width"] = half / size if size > 0.0 else float("nan")
        if limit is not None:
            there = scored[:, k] & np.isfinite(limit[:, k])
            result[f"{name}_limit"] = rms(error[there, k] / limit[there, k])
    result["flagged"] = 100.0 * average(estimate.flagged)
    far = (abs(error[:, 0]) > 0.5 * normal) | (abs(error[:, 3]) > 0.5)
    far |= scored[:, 2] & (abs(error[:, 2]) > 0.5 * mu)
    result["far_off"] = 100.0 * average(far & ~estimate.flagged)
    result["scenes"] = float(len(true))
    return result


def times(
    reconstructors: Mapping[str, Choice], scenes: Sequence[ForceScene], turns: int
) -> dict[str, list[float]]:
    """Time per field of each reconstructor in each turn, in one thread [ms].

    The reconstructors take turns, so that other load on the machine falls on all of them.
    """
    spent: dict[str, list[float]] = {name: [] for name in reconstructors}
    with one_thread():
        readers = {
            name: [load_reconstructor(choice)(scene.known, scene.rest) for scene in scenes]
            for name, choice in reconstructors.items()
        }
        for _ in range(1 + turns):  # the first turn compiles
            for name, one_per_scene in readers.items():
                most = READ[reads_of(name)[-1]]
                begin = time.perf_counter()
                for reader, scene in zip(one_per_scene, scenes, strict=True):
                    reader.reset()
                    for tracks in scene.tracks[-most:]:
                        with suppress(NoEstimateError):
                            reader.update(tracks)
                passed = time.perf_counter() - begin
                frames = sum(min(most, len(scene.tracks)) for scene in scenes)
                spent[name].append(1e3 * passed / frames)
    return {name: all_turns[1:] for name, all_turns in spent.items()}


def rms(values: Array) -> float:
    """Root of the mean square of the finite values; NaN if there are none."""
    return float(np.sqrt(average(values**2)))


def average(values: Array | Mask) -> float:
    """Mean of the finite values; NaN if there are none."""
    there = values[np.isfinite(values)]
    return float(there.mean()) if len(there) else float("nan")
