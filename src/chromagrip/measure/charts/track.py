"""Time per frame of each tracker against its error, and the Cramér–Rao bound."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ...by_name import Choice
from ...errors import UserError
from ...render import LAYERS
from ...tracking import DEFAULT_TRACKER, tracker_names
from ..study import Asked, Results, Study, study
from ..worlds.track_scenes import SCENES, Sequence, sequence
from ..worlds.track_scores import follow, scores, tracker_class
from .chart import Axis, Chart, Point
from .page import chart_study

#: Scenes of the chart, and the label of the error in each.
_SCENES = {"clean": "press and shear", "sway": "the skin sways by 6 px"}
#: Frames of a scene, and those of a quick run.
_FRAMES = 24
_QUICK_FRAMES = 2
#: Repeats, and those of a quick run.
_TURNS = 5
_QUICK_TURNS = 1
#: Name of the least error.
_LIMIT = "Cramér–Rao"


class Pass(NamedTuple):
    """One tracker on one scene, once.

    Attributes
    ----------
    scene, tracker: names
    choice: the tracker
    turn: the first one measures the errors too
    frames: of the scene
    """

    scene: str
    tracker: str
    choice: Choice
    turn: int
    frames: int


@study("chart", "track", method="tracker")
def track_chart(asked: Asked) -> Study[Pass, dict[str, float] | str]:
    """Time per frame of each tracker against its error, and the Cramér–Rao bound.

    A quick run has few frames of one scene.
    """
    quick = asked.quick
    frames, turns = (_QUICK_FRAMES, _QUICK_TURNS) if quick else (_FRAMES, _TURNS)
    trackers = asked.chosen(tracker_names(), tracker_class)
    scenes = list(_SCENES)[: 1 if quick else None]
    return chart_study(
        lambda results: _chart(results, scenes),
        _measured,
        dict[str, float] | str,
        timed=[
            Pass(scene, name, choice, turn, frames)
            for scene in scenes
            for turn in range(turns)
            for name, choice in trackers.items()
        ],
        words=lambda one: f"{one.scene}: {one.tracker}, turn {one.turn + 1}",
    )


def _measured(one: Pass) -> dict[str, float] | str:
    """Time of a frame [ms] and, in the first turn, error and bound [px]; or why it refuses."""
    frames = _frames(one.scene, one.frames)
    try:
        followed = follow(one.choice, frames)
    except UserError as error:
        return str(error)
    found = {"time": float(np.median(followed.times))}
    if one.turn == 0:
        errors = scores(followed, frames)
        found["rms"] = max(errors[f"{layer}_rms"] for layer in LAYERS)
        found["limit"] = _limit(frames)
    return found


@lru_cache(maxsize=1)
def _frames(scene: str, count: int) -> Sequence:
    return sequence(SCENES[scene], count)


def _chart(results: Results[Pass, dict[str, float] | str], scenes: list[str]) -> Chart:
    points: dict[str, Point] = {}
    limits: dict[str, float] = {}
    described = tracker_names()
    for one, found in results:
        point = points.setdefault(
            one.tracker,
            Point(
                name=one.tracker,
                times=[],
                errors={},
                ours=one.tracker in (DEFAULT_TRACKER, "quick"),
                settings=described.get(one.tracker, "given on the command line"),
                command=f"chromagrip bench track --tracker {one.tracker}",
            ),
        )
        if isinstance(found, str):
            continue  # the tracker refuses such frames
        point.times.append(found["time"])
        if "rms" in found:
            point.errors[f"{one.scene}/rms"] = found["rms"]
            limits[one.scene] = found["limit"]
    axes = [
        Axis(
            key=f"{scene}/rms",
            label=f"RMS error of the worse layer [px], {_SCENES[scene]}",
            unit="px",
            lines={_LIMIT: limits[scene]} if scene in limits else {},
        )
        for scene in scenes
    ]
    return Chart(
        part="track",
        title="Trackers: 400 markers in two layers, 640×480, noise of 2 levels",
        per="frame",
        points=[point for point in points.values() if len(point.errors) == len(axes)],
        axes=axes,
        levels={_LIMIT: "least error that the noise allows"},
    )


def _limit(frames: Sequence) -> float:
    """Bound of single frames, of the worse layer [px]."""
    limit = np.stack([shot.limit for shot in frames.shots])
    return max(float(np.sqrt(np.nanmean(limit[:, k] ** 2))) for k in range(len(LAYERS)))
