"""Trackers by name, `module:Class`, entry point, class or other factory."""

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

    Attributes
    ----------
    state: everything that changes from frame to frame, as one value that is never changed in place.
        A tracker that was reset with the same rest frames and receives another tracker's state
        continues like that one
    """

    state: Any

    def reset(self, rest: list[Frame]) -> Tracks:
        """Find the markers in frames of the unloaded sensor.

        Raises
        ------
        UserError
            When there is no frame, or it does not show the markers.
        """
        ...

    def update(self, frame: Frame) -> Tracks:
        """Find the markers in the next frame.

        Raises
        ------
        UserError
            When the frame has another size than the rest frame.
        """
        ...


def check_frame(frame: Frame, shape: tuple[int, ...]) -> None:
    """Refuse a frame whose image has another shape or type than the rest frame's.

    Raises
    ------
    UserError
        With both shapes.
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
    given=2,
    entries={
        "fit": (".fit.tracker:MarkerTracker", "least-squares fit of the shape of both layers"),
        "quick": (
            ".fit.tracker:quick",
            "fit, from every other row of the image, with templates that are kept for longer",
        ),
        "detect": (
            ".baselines.detected:DetectedMarkers",
            "markers of any form, detected in every frame",
        ),
        "lk": (".baselines.flow:LucasKanade", "Lucas-Kanade from the rest frame, warm started"),
        "centroid": (
            ".baselines.centroid:WeightedCentroid",
            "centroid of dye density in a window that follows the marker",
        ),
        "chromatouch": (
            ".baselines.chromatouch:ChromaTouch",
            "the published pipeline: top-hat, HSV mask, hue",
        ),
    },
)
#: Name of the default tracker.
DEFAULT_TRACKER = "fit"


def tracker_names() -> dict[str, str]:
    """One-line description of each tracker, by name."""
    return TRACKERS.descriptions()


def load_tracker(
    choice: Choice, arguments: Mapping[str, Any] | None = None
) -> Callable[[Palette, float], Tracker]:
    """Load a factory of trackers, which takes a palette and the camera's noise [grey levels].

    Parameters
    ----------
    choice: name of a built-in tracker or of an entry point, `module:Class`, or a class or other
        factory
    arguments: further arguments of the class, by name

    Raises
    ------
    UserError
        When no tracker has that name, or it cannot be imported.
    """
    factory: Callable[[Palette, float], Tracker] = TRACKERS.load(choice, arguments)
    return factory
