"""Trackers by name: ours, and anybody's by `module:Class` or an entry point."""

from collections.abc import Callable
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, Protocol

import numpy as np

from ..by_name import import_class
from ..render import Frame
from .palette import Palette
from .tracks import Tracks


class Tracker(Protocol):
    """Follows the markers of one sensor from frame to frame; made by `Class(palette, noise)`.

    `state` holds everything that changes from frame to frame, as arrays and numbers by name: a
    tracker that was reset with the same rest frames and is given another's state goes on as that
    one would have.
    """

    state: dict[str, Any]

    def reset(self, rest: list[Frame]) -> Tracks:
        """Find the markers in frames of the unloaded sensor.

        Raises
        ------
        DetectionError
            When there is no frame, or it does not show the markers.
        """
        ...

    def update(self, frame: Frame) -> Tracks:
        """Markers in the next frame.

        Raises
        ------
        FrameError
            When the frame has another size than the rest frame.
        """
        ...


class TrackerError(ValueError):
    """A tracker that is not there, or is none."""


class FrameError(ValueError):
    """A frame that does not go with the rest frame."""


def check_frame(frame: Frame, shape: tuple[int, ...]) -> None:
    """Refuse a frame whose image is not as the rest frame's was.

    Raises
    ------
    FrameError
        With what was found and what was expected.
    """
    if frame.image.shape != shape or frame.image.dtype != np.uint8:
        raise FrameError(
            f"frame has shape {frame.image.shape} and type {frame.image.dtype}, the rest frame "
            f"had {shape} and uint8"
        )


#: Module:Class of each tracker of ours, and one line about it.
TRACKERS = {
    "fit": ("fit.tracker:MarkerTracker", "least-squares fit of the known shape of both layers"),
    "thrifty": (
        "fit.thrifty:ThriftyTracker",
        "the same fit, of what holds still every fourth frame",
    ),
    "sparse": ("fit.thrifty:SparseTracker", "thrifty, from every other row of the image"),
    "quick": ("fit.tracker:QuickTracker", "the same fit of places alone, to every second row"),
    "centroid": (
        "baselines.centroid:WeightedCentroid",
        "weighted centroids of what each dye covers",
    ),
    "lk": ("baselines.flow:LucasKanade", "Lucas-Kanade from the rest frame, warm started"),
    "dis": ("baselines.flow:DenseInverseSearch", "dense flow (DIS) from the rest frame"),
    "farneback": ("baselines.flow:Farneback", "dense flow (Farnebäck) from the rest frame"),
    "blob": ("baselines.blob:BlobDetector", "OpenCV's blob detector on dye density"),
    "chromatouch": (
        "baselines.chromatouch:ChromaTouch",
        "the published pipeline: top-hat, HSV mask, hue",
    ),
}
DEFAULT_TRACKER = "fit"
#: Entry points of installed packages that are trackers.
ENTRY_POINTS = "chromagrip.trackers"


def tracker_names() -> dict[str, str]:
    """Name of every tracker that is there, and one line about it."""
    theirs = {p.name: f"{p.value}, installed" for p in entry_points(group=ENTRY_POINTS)}
    return theirs | {name: text for name, (_, text) in TRACKERS.items()}


def load_tracker(name: str) -> Callable[[Palette, float], Tracker]:
    """What makes a tracker from a palette and the camera's noise [grey levels].

    Parameters
    ----------
    name: of one of ours or of an entry point, or `module:Class`

    Raises
    ------
    TrackerError
        When there is none of that name, or it cannot be imported.
    """
    if name in TRACKERS:
        module, _, kind = TRACKERS[name][0].partition(":")
        found: Callable[[Palette, float], Tracker]
        found = getattr(import_module(f".{module}", __package__), kind)
        return found
    target = next((p.value for p in entry_points(group=ENTRY_POINTS) if p.name == name), name)
    if ":" not in target:
        known = ", ".join(tracker_names())
        raise TrackerError(f"no tracker {name!r}; there is {known}, or give module:Class")
    found = import_class(target, name, Tracker, TrackerError)
    return found
