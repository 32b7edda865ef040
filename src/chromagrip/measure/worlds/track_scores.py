"""What a tracker said of a sequence, against what is true of it.

Numbers are matched once: each marker of each layer belongs to the number whose position at rest is
mutually nearest to it, within half a radius. From then on a number stands for that marker. One that
is not reported at rest is matched in the same way when it first is; until then it counts as lost.
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
from .track_scenes import SCENES, Sequence, sequence

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Distances of the share of points within [px]; TAP-Vid's 1, 2, 4, 8 and 16, and on to the fine.
WITHIN = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
#: A marker is right within this distance of its own place [px].
RIGHT = 0.5
#: Name of the tracker that never looks.
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
}


class Constant:
    """Says that everything stays where it was at rest: what every bench must tell from a tracker.

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
        visible = np.asarray(np.isfinite(position).all(axis=-1))
        layers, count = visible.shape
        self._tracks = Tracks(
            time=rest[-1].time,
            position=position,
            log_size=np.full((layers, count), np.nan),
            hue=np.full(count, np.nan),
            visible=visible,
            ambiguous=np.zeros_like(visible),
            last_seen=np.where(visible, rest[-1].time, np.nan),
            covariance=np.full((count, 3 * layers, 3 * layers), np.nan),
        )
        return self._tracks

    def update(self, frame: Frame) -> Tracks:
        """The same again."""
        return replace(self._tracks, time=frame.time)


def tracker_class(choice: Choice) -> Callable[[Palette, float], Tracker]:
    """Factory of a tracker, also of `constant`; see `load_tracker`."""
    return Constant if choice == CONSTANT else load_tracker(choice)


@dataclass(frozen=True, kw_only=True)
class Followed:
    """What a tracker said: at rest, and of F frames; and how long each took [ms]."""

    rest: Tracks
    tracks: list[Tracks]
    times: list[float]


def follow(choice: Choice, seen: Sequence) -> Followed:
    """Run a tracker over prepared frames, in one thread.

    Raises
    ------
    UserError
        When the tracker refuses the frames, with its reason.
    """
    with one_thread():
        tracker = tracker_class(choice)(seen.palette, seen.noise)
        rest = tracker.reset(seen.rest)
        tracks, times = [], []
        for shot in seen.shots:
            begin = time.perf_counter()
            tracks.append(tracker.update(shot.frame))
            times.append(1e3 * (time.perf_counter() - begin))
    return Followed(rest=rest, tracks=tracks, times=times)


def numbers(rest: Tracks, seen: Sequence) -> NDArray[np.intp]:
    """Number that the tracker gave each marker at rest, −1 for none, shape (2, M)."""
    found = np.full(seen.there.shape, -1, dtype=np.intp)
    _match(found, rest, seen.centre, seen.there, 0.5 * seen.radius)
    return found


def all_numbers(said: Followed, seen: Sequence) -> NDArray[np.intp]:
    """Number that the tracker gave each marker at rest or when it first saw it, (2, M)."""
    found = numbers(said.rest, seen)
    for tracks, shot in zip(said.tracks, seen.shots, strict=True):
        _match(found, tracks, shot.centre, shot.visible, 0.5 * seen.radius)
    return found


def _match(
    found: NDArray[np.intp], tracks: Tracks, centre: Array, there: Mask, reach: Array
) -> None:
    """Give markers without a number (2, M) one that is mutually nearest, and not given yet."""
    for layer in range(2):
        mine = np.setdiff1d(np.flatnonzero(tracks.visible[layer]), found[layer])
        true = np.flatnonzero(there[layer] & (found[layer] < 0))
        if len(mine) == 0 or len(true) == 0:
            continue
        at, place = tracks.position[layer, mine], centre[layer, true]
        distance, near = (np.asarray(v) for v in KDTree(at).query(place))
        back = np.asarray(KDTree(place).query(at)[1])
        mutual = (back[near] == np.arange(len(true))) & (distance < reach[layer])
        found[layer, true[mutual]] = mine[near[mutual]]


def in_order(values: Array, number: NDArray[np.intp]) -> Array:
    """Values (2, K, …) of a tracker's numbers in the order of the true markers, (2, M, …)."""
    found = np.full((*number.shape, *values.shape[2:]), np.nan)
    for layer in range(2):
        known = number[layer] >= 0
        found[layer, known] = values[layer, number[layer, known]]
    return found


def positions(tracks: Tracks, number: NDArray[np.intp]) -> Array:
    """Positions of the true markers as reported, NaN where not, shape (2, M, 2) [px]."""
    return in_order(np.where(tracks.visible[..., None], tracks.position, np.nan), number)


def swapped(at: Array, seen: Sequence, k: int) -> Mask:
    """Markers that are reported where another one of their layer is, shape (2, M)."""
    shot = seen.shots[k]
    found = np.zeros(at.shape[:2], dtype=np.bool_)
    for layer in range(2):
        there = np.flatnonzero(~shot.hidden[layer])
        reported = np.flatnonzero(np.isfinite(at[layer, :, 0]))
        if len(there) == 0 or len(reported) == 0:
            continue
        nearest = there[KDTree(shot.centre[layer, there]).query(at[layer, reported])[1]]
        off = np.linalg.norm(at[layer] - shot.centre[layer], axis=-1)[reported]
        found[layer, reported] = (nearest != reported) & (off > seen.radius[layer])
    return found


def errors_of(
    said: Followed, number: NDArray[np.intp], seen: Sequence
) -> tuple[Array, Array, Mask]:
    """Positions of the true markers as reported, errors of visible ones, and which are reported.

    Returns
    -------
    Shapes (F, 2, M, 2) [px], (F, 2, M, 2) [px] and (F, 2, M); NaN where there is none.
    """
    at = np.stack([positions(tracks, number) for tracks in said.tracks])
    reported = np.asarray(np.isfinite(at).all(axis=-1))
    visible = np.stack([shot.visible for shot in seen.shots])
    truth = np.stack([shot.centre for shot in seen.shots])
    return at, np.where((reported & visible)[..., None], at - truth, np.nan), reported


def scores(said: Followed, seen: Sequence) -> dict[str, float]:
    """Every score of UNITS; NaN for what the tracker does not measure.

    Counts are of markers in frames. Errors are those of markers that are seen whole and reported,
    wrong ones too; markers that are partly covered count neither way.
    """
    number = all_numbers(said, seen)
    at, error, reported = errors_of(said, number, seen)
    visible = np.stack([shot.visible for shot in seen.shots])
    hidden = np.stack([shot.hidden for shot in seen.shots])
    limit = np.stack([shot.limit for shot in seen.shots])
    squared = _normalised(said, seen, number, at)
    found: dict[str, float] = {}
    for layer, name in enumerate(LAYERS):
        mine = error[:, layer]
        mean = _nanmean(mine, axis=(0, 1))
        length = np.linalg.norm(mine, axis=-1)
        found[f"{name}_bias"] = float(np.hypot(*mean))
        found[f"{name}_bias_x"] = float(mean[0])
        found[f"{name}_rms"] = _rms(mine)
        finite = length[np.isfinite(length)]
        found[f"{name}_p95"] = float(np.percentile(finite, 95)) if len(finite) else np.nan
        found[f"{name}_ratio"] = _rms(mine / limit[:, layer])
        found[f"{name}_nees"] = float(_nanmean(squared[:, layer][visible[:, layer]])) / 2.0
    # Numbers that no marker ever had stand for nothing that is there.
    strangers = [
        int(tracks.visible[layer].sum() - reported[k, layer].sum())
        for k, tracks in enumerate(said.tracks)
        for layer in range(2)
    ]
    found["swaps"] = float(sum(swapped(at[k], seen, k).sum() for k in range(len(at))))
    # Also what was not found at rest.
    found["lost"] = float((visible & ~reported).sum())
    found["false"] = float((hidden & reported).sum() + sum(strangers))
    found["ambiguous"] = float(sum((t.ambiguous & t.visible).sum() for t in said.tracks))
    found["right"] = 100.0 * right_share(error, reported, visible, hidden & seen.there)
    found |= _tap(error, reported, visible, hidden & seen.there)
    found["hue"] = _hue_error(said, seen, number)
    found["normal"] = 1e3 * _normal_error(said, seen, number)
    found["time"] = float(np.median(said.times))
    return found


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


def _normalised(said: Followed, seen: Sequence, number: NDArray[np.intp], at: Array) -> Array:
    """Squared error of displacements from rest over their covariance, shape (F, 2, M)."""
    start = positions(said.rest, number) - seen.centre
    before = _blocks(said.rest, number)
    found = []
    for k, tracks in enumerate(said.tracks):
        error = at[k] - seen.shots[k].centre - start
        inverse = _inverse(_blocks(tracks, number) + before)
        found.append(np.einsum("lmi,lmij,lmj->lm", error, inverse, error))
    return np.stack(found)


def _blocks(tracks: Tracks, number: NDArray[np.intp]) -> Array:
    """Covariances of (x, y) of each marker, shape (2, M, 2, 2)."""
    blocks = [tracks.covariance[:, 3 * k : 3 * k + 2, 3 * k : 3 * k + 2] for k in range(2)]
    return in_order(np.stack(blocks), number)


def _inverse(matrices: Array) -> Array:
    """Inverses of 2×2 matrices (…, 2, 2); NaN where there is none."""
    (a, b), (c, d) = np.moveaxis(matrices, (-2, -1), (0, 1))
    determinant = np.where(a * d - b * c > 0.0, a * d - b * c, np.nan)
    return np.moveaxis(np.array([[d, -b], [-c, a]]) / determinant, (0, 1), (-2, -1))


def _hue_error(said: Followed, seen: Sequence, number: NDArray[np.intp]) -> float:
    """RMS error of the hue of outer markers that are seen [°]."""
    errors = []
    for shot, tracks in zip(seen.shots, said.tracks, strict=True):
        known = (number[0] >= 0) & shot.visible[0]
        error = tracks.hue[number[0, known]] - shot.hue[known]
        errors.append((error + 180.0) % 360.0 - 180.0)
    return _rms(np.concatenate(errors))


def _normal_error(said: Followed, seen: Sequence, number: NDArray[np.intp]) -> float:
    """RMS error of displacements along the normal, read from sizes [m].

    Seen from the sphere's centre, size goes as one over the distance.
    """
    start = in_order(said.rest.log_size, number)
    errors = []
    for shot, tracks in zip(seen.shots, said.tracks, strict=True):
        grown = in_order(tracks.log_size, number) - start
        height = seen.distance * np.expm1(-grown)
        errors.append((height - shot.height)[shot.visible])
    return _rms(np.concatenate(errors))


def _nanmean(values: Array, axis: tuple[int, ...] | None = None) -> Array:
    """Mean of what is there; NaN, without a warning, where nothing is."""
    there = np.isfinite(values)
    count = there.sum(axis=axis)
    total = np.where(there, values, 0.0).sum(axis=axis)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _rms(values: Array) -> float:
    return float(np.sqrt(_nanmean(values**2)))


def peak_memory(choice: Choice) -> float | None:
    """Memory that rest and a few frames take at their peak, above that before [MB].

    Counted by the system in a process of its own, machine code that is loaded for it included;
    None where the system does not count.
    """
    if not _STATUS.exists():
        return None
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_measure_memory, (choice,))


_STATUS, _FORGET_PEAK = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def _measure_memory(choice: Choice) -> float:
    cv2.setNumThreads(1)
    seen = sequence(SCENES["clean"], 4, limits=False)
    _FORGET_PEAK.write_text("5")
    before = _memory("VmRSS")
    follow(choice, seen)
    return _memory("VmHWM") - before


def _memory(key: str) -> float:
    """One line of the system's account of this process [MB]."""
    for line in _STATUS.read_text().splitlines():
        if line.startswith(f"{key}:"):
            return float(line.split()[1]) / 1024.0
    raise UserError(f"{_STATUS} has no {key}")
