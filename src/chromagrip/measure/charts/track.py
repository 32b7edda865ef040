"""Time per frame of each tracker against its error, and the Cramér–Rao bound."""

from collections.abc import Callable
from itertools import product

import numpy as np

from ...errors import UserError
from ...output.processes import one_thread
from ...render import LAYERS
from ...tracking import DEFAULT_TRACKER, tracker_names
from ..worlds.track_scenes import SCENES, Sequence, sequence
from ..worlds.track_scores import follow, scores
from .chart import Axis, Chart, Peer, Point

#: Scenes of the chart, and the label of the error in each.
_SCENES = {"clean": "press and shear", "sway": "the skin sways by 6 px"}
#: Frames of a scene, and those of a quick run.
_FRAMES = 24
_QUICK_FRAMES = 2
#: Repeats, and those of a quick run.
_TURNS = 5
_QUICK_TURNS = 1
#: Origin of the figures of the peers.
_ELSEWHERE = "200 discs of one layer, 640×480, measured on two cores when this project began"
#: Name of the least error.
_LIMIT = "Cramér–Rao"
#: Errors are of displacements from rest.
_PEERS = (
    Peer(name="least squares, NumPy", milliseconds=26.0, error=0.0094, source=_ELSEWHERE),
    Peer(name="trackpy", milliseconds=27.0, error=0.0137, source=_ELSEWHERE),
    Peer(name="weighted centroid, NumPy", milliseconds=8.0, error=0.0105, source=_ELSEWHERE),
)


def chart_track(quick: bool, progress: Callable[[str], None]) -> Chart:
    """Measure every tracker; a quick run has few frames of one scene."""
    frames, turns = (_QUICK_FRAMES, _QUICK_TURNS) if quick else (_FRAMES, _TURNS)
    points = [
        Point(
            name=name,
            times=[],
            errors={},
            ours=name in (DEFAULT_TRACKER, "quick"),
            settings=text,
            command=f"chromagrip bench track --tracker {name}",
        )
        for name, text in tracker_names().items()
    ]
    axes = []
    with one_thread():
        for scene, label in list(_SCENES.items())[: 1 if quick else None]:
            progress(f"{scene}: frames and their limit")
            frames_of_scene = sequence(SCENES[scene], frames)
            axis = Axis(
                key=f"{scene}/rms",
                label=f"RMS error of the worse layer [px], {label}",
                unit="px",
                lines={_LIMIT: _limit(frames_of_scene)},
                peers=_PEERS if scene == "clean" else (),
            )
            axes.append(axis)
            for turn, point in product(range(turns), points):
                progress(f"{scene}: {point.name}, turn {turn + 1}")
                try:
                    followed = follow(point.name, frames_of_scene)
                except UserError:
                    continue  # the tracker refuses such frames
                point.times.append(float(np.median(followed.times)))
                if turn == 0:
                    errors = scores(followed, frames_of_scene)
                    point.errors[axis.key] = max(errors[f"{layer}_rms"] for layer in LAYERS)
    title = "Trackers: 400 markers in two layers, 640×480, noise of 2 levels"
    complete = [point for point in points if len(point.errors) == len(axes)]
    return Chart(
        part="track",
        title=title,
        per="frame",
        points=complete,
        axes=axes,
        levels={_LIMIT: "least error that the noise allows"},
        compared="other tools, measured earlier",
    )


def _limit(frames: Sequence) -> float:
    """Bound of single frames, of the worse layer [px]."""
    limit = np.stack([shot.limit for shot in frames.shots])
    return max(float(np.sqrt(np.nanmean(limit[:, k] ** 2))) for k in range(len(LAYERS)))
