"""What the trackers beside our own share: where to look, what is lost, and since when.

A marker is looked for where it was, a lost one where its neighbours say that it went; each tracker
only adds how a marker near there is found. All of them are local: a marker that moves by more than
half a pitch between two frames is taken for its neighbour.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ...errors import UserError
from ...render import Frame
from ..detection import RestFrame, neighbours, read_rest
from ..palette import Palette
from ..trackers import check_frame
from ..tracks import Tracks

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: A marker that jumps further than this could have come from a neighbour's place [pitches]:
#: there would be one nearly as near, the other way round.
_DOUBTFUL_JUMP = 0.375
#: Markers of one layer are further apart than this [pitches].
_APART = 0.25
#: Fewer markers than this share, seen in the rest frame itself, are no start.
_FEWEST = 0.5
_NEIGHBOURS = 6


class Measured(NamedTuple):
    """What a tracker finds in one frame, as in `Tracks`; None for what it does not measure."""

    position: Array
    log_size: Array | None = None
    hue: Array | None = None
    covariance: Array | None = None


class Follower:
    """Base of the trackers that look for each marker near its last place.

    A subclass gives `_prepare`, which reads what it needs from the rest frame, and `_find`. What
    changes from frame to frame goes into the dictionary `_state`.

    Parameters
    ----------
    palette: of the markers
    noise: standard deviation of the camera noise [grey levels]; rounding is added to it
    """

    def __init__(self, palette: Palette, noise: float) -> None:
        self._palette = palette
        self._noise = noise
        self._state: dict[str, Any] = {}

    def _prepare(self, rest: RestFrame, image: Image) -> None:
        """Keep what is needed of the rest frame; `image` is its mean, rounded."""
        raise NotImplementedError

    def _find(self, image: Image, expected: Array) -> Measured:
        """Markers in an image (H, W, 3), by where they are expected [px], shape (L, M, 2)."""
        raise NotImplementedError

    @property
    def state(self) -> dict[str, Any]:
        """All that changes from frame to frame, by name."""
        return {name: np.copy(value) for name, value in self._state.items()}

    @state.setter
    def state(self, state: dict[str, Any]) -> None:
        self._state = {name: np.copy(value) for name, value in state.items()}

    def reset(self, rest: list[Frame]) -> Tracks:
        """Find the markers in frames of the unloaded sensor; their mean is the rest frame.

        Raises
        ------
        UserError
            When there is no frame, or it does not show the markers.
        """
        seen = read_rest(rest, self._palette)
        self._origin, self._pitch = seen.position, seen.pitch
        self._near = neighbours(np.nanmean(seen.position, axis=0), _NEIGHBOURS)
        self._state = {
            "shift": np.zeros_like(seen.position),
            "last_seen": np.full(seen.position.shape[:2], np.nan),
        }
        image = np.rint(seen.image).astype(np.uint8)
        self._shape = image.shape
        self._prepare(seen, image)
        tracks = self._follow(Frame(image=image, time=rest[-1].time))
        there = int(np.isfinite(self._origin[..., 0]).sum())
        if tracks.visible.sum() < _FEWEST * there:
            raise UserError(
                f"only {tracks.visible.sum()} of {there} markers of the rest frame are found by "
                f"this tracker, at least {_FEWEST:.0%} must be"
            )
        # Shifts count from where the tracker itself sees a marker at rest.
        self._origin = np.where(tracks.visible[..., None], tracks.position, self._origin)
        self._state["shift"] = np.zeros_like(self._origin)
        tracks.covariance[:] /= len(rest)
        return tracks

    def update(self, frame: Frame) -> Tracks:
        """Markers in the next frame.

        Raises
        ------
        UserError
            When the frame has another size or type than the rest frame.
        """
        check_frame(frame, self._shape)
        return self._follow(frame)

    def _follow(self, frame: Frame) -> Tracks:
        shift = self._state["shift"]
        measured = self._find(np.ascontiguousarray(frame.image), self._origin + shift)
        position, (layers, count, _) = measured.position, self._origin.shape
        height, width, _ = self._shape
        corner = np.array([width - 1, height - 1])
        visible = np.all((position >= 0.0) & (position <= corner), axis=-1)
        moved = position - self._origin
        jump = np.linalg.norm(moved - shift, axis=-1)
        apart = np.linalg.norm(position[:, :, None] - position[:, self._near], axis=-1)
        claimed = (apart < _APART * self._pitch).any(axis=-1)
        seen = visible[..., None]
        last_seen = np.where(visible, frame.time, self._state["last_seen"])
        self._state["last_seen"] = last_seen
        self._state["shift"] = _carry(np.where(seen, moved, shift), visible, self._near)
        unknown = np.full((layers, count), np.nan)
        size = unknown if measured.log_size is None else measured.log_size
        hue = unknown[0] if measured.hue is None else measured.hue
        covariance = measured.covariance
        if covariance is None:
            covariance = np.full((count, 3 * layers, 3 * layers), np.nan)
        return Tracks(
            time=frame.time,
            position=np.where(seen, position, np.nan),
            log_size=np.where(visible, size, np.nan),
            hue=np.where(visible[0], hue, np.nan),
            visible=visible,
            ambiguous=visible & ((jump > _DOUBTFUL_JUMP * self._pitch) | claimed),
            last_seen=last_seen,
            covariance=covariance,
        )


def nearest(found: Array, expected: Array, reach: float, mutual: bool) -> NDArray[np.intp]:
    """Which of the found points (n, 2) is nearest to each expected one (M, 2), −1 for none.

    Parameters
    ----------
    reach: a point further away is none [px]
    mutual: whether a point goes only to the one that it is nearest to
    """
    which = np.full(len(expected), -1)
    there = np.flatnonzero(np.isfinite(expected).all(axis=-1))
    if len(found) == 0 or len(there) == 0:
        return which
    distance, partner = KDTree(found).query(expected[there])
    taken = np.asarray(distance) < reach
    if mutual:
        back = np.asarray(KDTree(expected[there]).query(found)[1])
        taken &= back[partner] == np.arange(len(there))
    which[there[taken]] = np.asarray(partner)[taken]
    return which


def _carry(shift: Array, visible: NDArray[np.bool_], near: NDArray[np.intp]) -> Array:
    """Shifts (L, M, 2); a lost marker's is the median of its visible neighbours', if there are."""
    lost = ~visible & visible[:, near].any(axis=-1)
    for layer, m in np.argwhere(lost):
        around = near[m][visible[layer, near[m]]]
        shift[layer, m] = np.median(shift[layer, around], axis=0)
    return shift
