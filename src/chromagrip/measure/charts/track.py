"""Time per frame of each tracker against its error, and the Cramér–Rao bound."""

from collections.abc import Callable

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from ...errors import UserError
from ...render import LAYERS
from ...tracking import DEFAULT_TRACKER, tracker_names
from ..worlds.track_scenes import SCENES, Sequence, sequence
from ..worlds.track_scores import follow, scores
from .chart import Axis, Chart, Peer, Point

#: Scenes of the chart, and what an error in them is called.
_SCENES = {"clean": "press and shear", "sway": "the skin sways by 6 px"}
_FRAMES, _TURNS = 24, 5
_QUICK_FRAMES, _QUICK_TURNS = 2, 1
_ELSEWHERE = "200 discs of one layer, 640×480, measured on two cores when this project began"
#: Errors are of displacements from rest.
_PEERS = (
    Peer(name="least squares, NumPy", milliseconds=26.0, error=0.0094, source=_ELSEWHERE),
    Peer(name="trackpy", milliseconds=27.0, error=0.0137, source=_ELSEWHERE),
    Peer(name="weighted centroid, NumPy", milliseconds=8.0, error=0.0105, source=_ELSEWHERE),
)


def chart_track(quick: bool, progress: Callable[[str], None]) -> Chart:
    """Measure every tracker that is there; few frames of one scene where it has to be quick."""
    frames, turns = (_QUICK_FRAMES, _QUICK_TURNS) if quick else (_FRAMES, _TURNS)
    names = list(tracker_names())
    times: dict[str, list[float]] = {}
    errors: dict[str, dict[str, float]] = {}
    axes = []
    with threadpool_limits(1):
        cv2.setNumThreads(1)
        for scene, label in list(_SCENES.items())[: 1 if quick else None]:
            progress(f"{scene}: frames and their limit")
            seen = sequence(SCENES[scene], frames)
            key = f"{scene}/rms"
            axes.append(
                Axis(
                    key=key,
                    label=f"RMS error of the worse layer [px], {label}",
                    unit="px",
                    lines={"Cramér–Rao": _limit(seen)},
                    peers=_PEERS if scene == "clean" else (),
                )
            )
            for turn in range(turns):
                for name in names:
                    progress(f"{scene}: {name}, turn {turn + 1}")
                    try:
                        said = follow(name, seen)
                    except UserError:
                        continue  # refuses such frames
                    times.setdefault(name, []).append(float(np.median(said.times)))
                    if turn == 0:
                        found = scores(said, seen)
                        worst = max(found[f"{layer}_rms"] for layer in LAYERS)
                        errors.setdefault(name, {})[key] = worst
    points = [
        Point(
            name=name,
            times=times[name],
            errors=errors[name],
            ours=name in (DEFAULT_TRACKER, "quick"),
            settings=tracker_names()[name],
            command=f"chromagrip bench track --tracker {name}",
        )
        for name in names
        if len(errors.get(name, ())) == len(axes)
    ]
    title = "Trackers: 400 markers in two layers, 640×480, noise of 2 levels"
    return Chart(part="track", title=title, per="frame", points=points, axes=axes)


def _limit(seen: Sequence) -> float:
    """Bound of single frames, of the worse layer [px]."""
    limit = np.stack([shot.limit for shot in seen.shots])
    return max(float(np.sqrt(np.nanmean(limit[:, k] ** 2))) for k in range(len(LAYERS)))
