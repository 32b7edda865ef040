"""Scores of a tracker's reports of a sequence against the truth.

The numbers that a tracker gives markers are matched once: each marker of each layer belongs to the
number whose position at rest is mutually nearest to it, within half a radius. From then on a number
stands for that marker. A marker that is not reported at rest is matched when it is first reported;
until then it counts as lost.
"""

import multiprocessing
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ...by_name import Choice
from ...errors import UserError
from ...output.processes import one_thread
from ...render import LAYERS, Frame
from ...tracking import Palette, Tracker, Tracks, load_tracker, read_rest
from .slowest import SLOWEST, slowest
from .track_scenes import SCENES, Sequence, sequence

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Distances of the share of points within [px]: TAP-Vid's 1, 2, 4, 8 and 16, and smaller ones.
WITHIN = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
#: A report is right within this distance of the marker's own place [px].
RIGHT = 0.5
#: Name of the tracker that uses no image after rest.
CONSTANT = "constant"
#: Unit of every score; those of a layer are named after it.
UNITS = {
    **{
        f"{layer}_{name}": unit
        for layer in LAYERS
        for name, unit in {
            "bias": "px",
            "bias_x": "px",
            "rms": "px",
            "p95": "px",
            "ratio": "× limit",
            "nees": "",
        }.items()
    },
    "swaps": "",
    "lost": "",
    "false": "",
    "ambiguous": "",
    "right": "%",
    "within": "%",
    "jaccard": "%",
    "occlusion": "%",
    "hue": "°",
    "normal": "mm",
    "time": "ms",
    **dict.fromkeys(SLOWEST, "ms"),
}


class Constant:
    """Reports that every marker stays where it was at rest, which scores must tell from tracking.

    Parameters
    ----------
    palette: of the markers
    noise: of the camera [grey levels]
    """

    def __init__(self, palette: Palette, noise: float) -> None:
        self._palette = palette
        self.state: dict[str, object] = {}

    def reset(self, rest: list[Frame]) -> Tracks:
        """Find the markers."""
        position = read_rest(rest, self._palette).position
        self._tracks = Tracks.of_positions(rest[-1].time, position)
        return self._tracks

    def update(self, frame: Frame) -> Tracks:
        """Markers at rest, with the time of the frame."""
        return replace(self._tracks, time=frame.time)


def tracker_class(choice: Choice) -> Callable[[Palette, float], Tracker]:
    """Factory of a tracker, also of `constant`; see `load_tracker`."""
    return Constant if choice == CONSTANT else load_tracker(choice)


@dataclass(frozen=True, kw_only=True)
class Followed:
    """Reports of a tracker at rest and of F frames, and the time that each took [ms]."""

    rest: Tracks
    tracks: list[Tracks]
    times: list[float]


def follow(choice: Choice, scene: Sequence) -> Followed:
    """Run a tracker over prepared frames, in one thread.

    Raises
    ------
    UserError
        When the tracker refuses the frames, with its reason.
    """
    with one_thread():
        tracker = tracker_class(choice)(scene.palette, scene.noise)
        rest = tracker.reset(scene.rest)
        tracks, times = [], []
        for shot in scene.shots:
            begin = time.perf_counter()
            tracks.append(tracker.update(shot.frame))
            times.append(1e3 * (time.perf_counter() - begin))
    return Followed(rest=rest, tracks=tracks, times=times)


def numbers(rest: Tracks, scene: Sequence) -> NDArray[np.intp]:
    """Number that the tracker gave each marker at rest, −1 for none, shape (2, M)."""
    result = np.full(scene.there.shape, -1, dtype=np.intp)
    _match(result, rest, scene.centre, scene.there, 0.5 * scene.radius)
    return result


def all_numbers(followed: Followed, scene: Sequence) -> NDArray[np.intp]:
    """Number that the tracker gave each marker at rest or in its first report, shape (2, M)."""
    result = numbers(followed.rest, scene)
    for tracks, shot in zip(followed.tracks, scene.shots, strict=True):
        _match(result, tracks, shot.centre, shot.visible, 0.5 * scene.radius)
    return result


def _match(
    result: NDArray[np.intp], tracks: Tracks, centre: Array, there: Mask, reach: Array
) -> None:
    """Give markers without a number (2, M) a free one that is mutually nearest."""
    for layer in range(2):
        own = np.setdiff1d(np.flatnonzero(tracks.visible[layer]), result[layer])
        true = np.flatnonzero(there[layer] & (result[layer] < 0))
        if len(own) == 0 or len(true) == 0:
            continue
        at, place = tracks.position[layer, own], centre[layer, true]
        distance, near = (np.asarray(v) for v in KDTree(at).query(place))
        back = np.asarray(KDTree(place).query(at)[1])
        mutual = (back[near] == np.arange(len(true))) & (distance < reach[layer])
        result[layer, true[mutual]] = own[near[mutual]]


def in_order(values: Array, number: NDArray[np.intp]) -> Array:
    """Values (2, K, …) of a tracker's numbers in the order of the true markers, (2, M, …)."""
    result = np.full((*number.shape, *values.shape[2:]), np.nan)
    for layer in range(2):
        known = number[layer] >= 0
        result[layer, known] = values[layer, number[layer, known]]
    return result


def positions(tracks: Tracks, number: NDArray[np.intp]) -> Array:
    """Positions of the true markers as reported, NaN where not, shape (2, M, 2) [px]."""
    return in_order(np.where(tracks.visible[..., None], tracks.position, np.nan), number)


def swapped(at: Array, scene: Sequence, k: int) -> Mask:
    """Markers that are reported where another one of their layer is, shape (2, M)."""
    shot = scene.shots[k]
    result = np.zeros(at.shape[:2], dtype=np.bool_)
    for layer in range(2):
        there = np.flatnonzero(~shot.hidden[layer])
        reported = np.flatnonzero(np.isfinite(at[layer, :, 0]))
        if len(there) == 0 or len(reported) == 0:
            continue
        nearest = there[KDTree(shot.centre[layer, there]).query(at[layer, reported])[1]]
        off = np.linalg.norm(at[layer] - shot.centre[layer], axis=-1)[reported]
        result[layer, reported] = (nearest != reported) & (off > scene.radius[layer])
    return result


def errors_of(
    followed: Followed, number: NDArray[np.intp], scene: Sequence
) -> tuple[Array, Array, Mask]:
    """Positions of the true markers as reported, errors of visible ones, and which are reported.

    Returns
    -------
    Shapes (F, 2, M, 2) [px], (F, 2, M, 2) [px] and (F, 2, M); NaN where there is none.
    """
    at = np.stack([positions(tracks, number) for tracks in followed.tracks])
    reported = np.asarray(np.isfinite(at).all(axis=-1))
    visible = np.stack([shot.visible for shot in scene.shots])
    truth = np.stack([shot.centre for shot in scene.shots])
    return at, np.where((reported & visible)[..., None], at - truth, np.nan), reported


def scores(followed: Followed, scene: Sequence) -> dict[str, float]:
    """Every score of UNITS; NaN for quantities that the tracker does not measure.

    Counts are of markers in frames. Errors are those of markers that are completely visible and
    reported, also at a wrong place; partly hidden markers do not count.
    """
    number = all_numbers(followed, scene)
    at, error, reported = errors_of(followed, number, scene)
    visible = np.stack([shot.visible for shot in scene.shots])
    hidden = np.stack([shot.hidden for shot in scene.shots])
    limit = np.stack([shot.limit for shot in scene.shots])
    squared = _normalised(followed, scene, number, at)
    result: dict[str, float] = {}
    for layer, name in enumerate(LAYERS):
        own = error[:, layer]
        mean = _nanmean(own, axis=(0, 1))
        length = np.linalg.norm(own, axis=-1)
        result[f"{name}_bias"] = float(np.hypot(*mean))
        result[f"{name}_bias_x"] = float(mean[0])
        result[f"{name}_rms"] = _rms(own)
        finite = length[np.isfinite(length)]
        result[f"{name}_p95"] = float(np.percentile(finite, 95)) if len(finite) else np.nan
        result[f"{name}_ratio"] = _rms(own / limit[:, layer])
        result[f"{name}_nees"] = float(_nanmean(squared[:, layer][visible[:, layer]])) / 2.0
    # Numbers that no marker ever had are false reports.
    strangers = [
        int(tracks.visible[layer].sum() - reported[k, layer].sum())
        for k, tracks in enumerate(followed.tracks)
        for layer in range(2)
    ]
    result["swaps"] = float(sum(swapped(at[k], scene, k).sum() for k in range(len(at))))
    # Also those that were not result at rest.
    result["lost"] = float((visible & ~reported).sum())
    result["false"] = float((hidden & reported).sum() + sum(strangers))
    result["ambiguous"] = float(sum((t.ambiguous & t.visible).sum() for t in followed.tracks))
    result["right"] = 100.0 * right_share(error, reported, visible, hidden & scene.there)
    result |= _tap(error, reported, visible, hidden & scene.there)
    result["hue"] = _hue_error(followed, scene, number)
    result["normal"] = 1e3 * _normal_error(followed, scene, number)
    result["time"] = float(np.median(followed.times))
    result |= slowest(followed.times)
    return result


def right_share(error: Array, reported: Mask, visible: Mask, hidden: Mask) -> float:
    """Share of markers that are reported within RIGHT of their own place, or rightly not."""
    near = np.linalg.norm(error, axis=-1) < RIGHT
    right = (visible & near) | (hidden & ~reported)
    return float(right.sum() / (visible | hidden).sum())


def _tap(error: Array, reported: Mask, visible: Mask, hidden: Mask) -> dict[str, float]:
    """TAP-Vid's scores, with its definitions and the distances WITHIN [%]."""
    length = np.where(visible & reported, np.linalg.norm(error, axis=-1), np.inf)
    within, jaccard = [], []
    for limit in WITHIN:
        near = length < limit
        within.append(near.sum() / visible.sum())
        wrong = (reported & hidden) | (reported & visible & ~near)
        jaccard.append(near.sum() / (visible.sum() + wrong.sum()))
    asked = visible | hidden
    return {
        "within": 100.0 * float(np.mean(within)),
        "jaccard": 100.0 * float(np.mean(jaccard)),
        "occlusion": 100.0 * float((reported == visible)[asked].mean()),
    }


def _normalised(followed: Followed, scene: Sequence, number: NDArray[np.intp], at: Array) -> Array:
    """Squared error of displacements from rest over their covariance, shape (F, 2, M)."""
    start = positions(followed.rest, number) - scene.centre
    before = _blocks(followed.rest, number)
    result = []
    for k, tracks in enumerate(followed.tracks):
        error = at[k] - scene.shots[k].centre - start
        inverse = _inverse(_blocks(tracks, number) + before)
        result.append(np.einsum("lmi,lmij,lmj->lm", error, inverse, error))
    return np.stack(result)


def _blocks(tracks: Tracks, number: NDArray[np.intp]) -> Array:
    """Covariances of (x, y) of each marker, shape (2, M, 2, 2)."""
    blocks = [tracks.covariance[:, 3 * k : 3 * k + 2, 3 * k : 3 * k + 2] for k in range(2)]
    return in_order(np.stack(blocks), number)


def _inverse(matrices: Array) -> Array:
    """Inverses of 2×2 matrices (…, 2, 2); NaN where there is none."""
    (a, b), (c, d) = np.moveaxis(matrices, (-2, -1), (0, 1))
    determinant = np.where(a * d - b * c > 0.0, a * d - b * c, np.nan)
    return np.moveaxis(np.array([[d, -b], [-c, a]]) / determinant, (0, 1), (-2, -1))


def _hue_error(followed: Followed, scene: Sequence, number: NDArray[np.intp]) -> float:
    """RMS error of the hue of visible outer markers [°]."""
    errors = []
    for shot, tracks in zip(scene.shots, followed.tracks, strict=True):
        known = (number[0] >= 0) & shot.visible[0]
        error = tracks.hue[number[0, known]] - shot.hue[known]
        errors.append((error + 180.0) % 360.0 - 180.0)
    return _rms(np.concatenate(errors))


def _normal_error(followed: Followed, scene: Sequence, number: NDArray[np.intp]) -> float:
    """RMS error of displacements along the normal, read from sizes [m].

    For a camera at the sphere's centre, size is proportional to one over the distance.
    """
    start = in_order(followed.rest.log_size, number)
    errors = []
    for shot, tracks in zip(scene.shots, followed.tracks, strict=True):
        grown = in_order(tracks.log_size, number) - start
        height = scene.distance * np.expm1(-grown)
        errors.append((height - shot.height)[shot.visible])
    return _rms(np.concatenate(errors))


def _nanmean(values: Array, axis: tuple[int, ...] | None = None) -> Array:
    """Mean of the finite values; NaN, without a warning, where there are none."""
    there = np.isfinite(values)
    count = there.sum(axis=axis)
    total = np.where(there, values, 0.0).sum(axis=axis)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _rms(values: Array) -> float:
    return float(np.sqrt(_nanmean(values**2)))


def peak_memory(choice: Choice) -> float | None:
    """Peak of the memory that rest and a few frames add to a process [MB].

    Counted by the system in a process of its own, with the machine code that is loaded; None where
    the system does not count.
    """
    if not _STATUS.exists():
        return None
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_measure_memory, (choice,))


_STATUS, _FORGET_PEAK = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def _measure_memory(choice: Choice) -> float:
    cv2.setNumThreads(1)
    scene = sequence(SCENES["clean"], 4, limits=False)
    _FORGET_PEAK.write_text("5")
    before = _memory("VmRSS")
    follow(choice, scene)
    return _memory("VmHWM") - before


def _memory(key: str) -> float:
    """One line of the system's account of this process [MB]."""
    for line in _STATUS.read_text().splitlines():
        if line.startswith(f"{key}:"):
            return float(line.split()[1]) / 1024.0
    raise UserError(f"{_STATUS} has no {key}")
