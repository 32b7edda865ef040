"""Trackers by name: ours, and anybody's by `module:Class` or an entry point."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from ..by_name import Choice, Registry
from ..errors import UserError
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
        UserError
            When there is no frame, or it does not show the markers.
        """
        ...

    def update(self, frame: Frame) -> Tracks:
        """Markers in the next frame.

        Raises
        ------
        UserError
            When the frame has another size than the rest frame.
        """
        ...


def check_frame(frame: Frame, shape: tuple[int, ...]) -> None:
    """Refuse a frame whose image is not as the rest frame's was.

    Raises
    ------
    UserError
        With what was found and what was expected.
    """
    if frame.image.shape != shape or frame.image.dtype != np.uint8:
        raise UserError(
            f"frame has shape {frame.image.shape} and type {frame.image.dtype}, the rest frame "
            f"had {shape} and uint8"
        )


#: Trackers by name.
TRACKERS = Registry(
    protocol=Tracker,
    package=__package__,
    entries={
        "fit": (".fit.tracker:MarkerTracker", "least-squares fit of the shape of both layers"),
        "thrifty": (".fit.thrifty:ThriftyTracker", "fit, every fourth frame for still markers"),
        "sparse": (".fit.thrifty:SparseTracker", "thrifty, on every other row of the image"),
        "quick": (".fit.tracker:QuickTracker", "fit of positions alone, on every other row"),
        "centroid": (".baselines.centroid:WeightedCentroid", "weighted centroids of dye cover"),
        "lk": (".baselines.flow:LucasKanade", "Lucas-Kanade from the rest frame, warm started"),
        "dis": (".baselines.flow:DenseInverseSearch", "dense flow (DIS) from the rest frame"),
        "farneback": (".baselines.flow:Farneback", "dense flow (Farnebäck) from the rest frame"),
        "blob": (".baselines.blob:BlobDetector", "OpenCV's blob detector on dye density"),
        "chromatouch": (
            ".baselines.chromatouch:ChromaTouch",
            "the published pipeline: top-hat, HSV mask, hue",
        ),
    },
)
DEFAULT_TRACKER = "fit"


def tracker_names() -> dict[str, str]:
    """One line about each tracker, by name."""
    return TRACKERS.descriptions()


def load_tracker(
    choice: Choice, arguments: Mapping[str, Any] | None = None
) -> Callable[[Palette, float], Tracker]:
    """Factory of trackers, called with a palette and the camera's noise [grey levels].

    Parameters
    ----------
    choice: name of ours or of an entry point, `module:Class`, or a class or other factory
    arguments: further arguments of the class, by name

    Raises
    ------
    UserError
        When there is none of that name, or it cannot be imported.
    """
    factory: Callable[[Palette, float], Tracker] = TRACKERS.load(choice, arguments)
    return factory
