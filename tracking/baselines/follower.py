"""Common part of the baseline trackers: expected positions, and bookkeeping of lost markers.

A marker is expected at its last position, a lost one at its rest position plus the shift of its
neighbours. Each tracker adds a method that finds a marker near there. All are local: a marker that
moves by more than half a pitch between two frames is confused with its neighbour.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ...errors import UserError
from ...render import Frame
from ..detection import RestFrame, check_each_layer, neighbours, read_rest
from ..doubt import Doubt, doubted, mean_step
from ..edge import Edge
from ..fit.relocate import Relocator
from ..palette import Palette
from ..trackers import check_frame
from ..tracks import Tracks

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True)
class FollowerSettings:
    """Tuned parameters of the baseline trackers; distances are in pitches of the markers.

    Attributes
    ----------
    doubtful_jump: motion between frames above which a marker is ambiguous
    apart: smallest distance between markers of one layer; closer ones are ambiguous
    fewest: smallest share of the rest frame's markers that the tracker must find there itself
    few: number of markers that may be lost at the margin without a doubt that the field jumped
    neighbours: number of neighbours that a lost marker moves with
    reach: largest distance of a marker from its expected position
    """

    doubtful_jump: float = 0.375
    apart: float = 0.25
    fewest: float = 0.5
    few: int = 3
    neighbours: int = 6
    reach: float = 0.5


class Measured(NamedTuple):
    """Measurements of a tracker in one frame, as in `Tracks`; None if it does not measure them.

    Attributes
    ----------
    position, log_size, hue: as in `Tracks`
    variance: of each coordinate of a position [px²], shape (L, M, 2)
    """

    position: Array
    log_size: Array | None = None
    hue: Array | None = None
    variance: Array | None = None


@dataclass(frozen=True)
class Shifts:
    """State of a tracker: everything that changes from frame to frame.

    Attributes
    ----------
    shift: displacement of each marker since rest [px], shape (L, M, 2); a lost marker has that of
        its neighbours
    last_seen: time of the last frame in which each marker was found [s], shape (L, M)
    doubt: markers whose number is not certain
    """

    shift: Array
    last_seen: Array
    doubt: Doubt


class Follower:
    """Base of the trackers that look for each marker near its last position.

    A subclass implements `_prepare`, which stores what it needs of the rest frame, and `_find`.

    Parameters
    ----------
    palette: colours of the markers
    noise: standard deviation of the camera noise [grey levels]; rounding is added to it
    settings: tuned parameters

    Attributes
    ----------
    state: everything that changes from frame to frame, as one frozen value
    """

    state: Shifts

    def __init__(
        self, palette: Palette, noise: float, settings: FollowerSettings = FollowerSettings()
    ) -> None:
        self._palette, self._noise, self._settings = palette, noise, settings

    def _prepare(self, rest: RestFrame, image: Image) -> None:
        """Store what is needed of the rest frame; `image` is its rounded mean image."""
        raise NotImplementedError

    def _find(self, image: Image, expected: Array) -> Measured:
        """Find the markers in an image (H, W, 3) near expected positions [px], (L, M, 2)."""
        raise NotImplementedError

    def reset(self, rest: list[Frame]) -> Tracks:
        """Find the markers in frames of the unloaded sensor; their mean is the rest frame.

        Raises
        ------
        UserError
            When there is no frame, or it does not show the markers.
        """
        settings = self._settings
        at_rest = read_rest(rest, self._palette)
        self._origin, self._pitch = at_rest.position, at_rest.pitch
        self._reach = settings.reach * at_rest.pitch
        self._edge = Edge.of_rest(at_rest, self._palette, at_rest.position)
        self._near = neighbours(np.nanmean(at_rest.position, axis=0), settings.neighbours)
        self.state = Shifts(
            shift=np.zeros_like(at_rest.position),
            last_seen=np.full(at_rest.position.shape[:2], np.nan),
            doubt=Doubt.of_rest(at_rest.position, np.isfinite(at_rest.position[..., 0])),
        )
        self._relocator = Relocator(at_rest, self._palette)
        image = np.rint(at_rest.image).astype(np.uint8)
        self._shape = image.shape
        self._prepare(at_rest, image)
        tracks = self._follow(Frame(image=image, time=rest[-1].time))
        count = int(np.isfinite(self._origin[..., 0]).sum())
        if tracks.visible.sum() < settings.fewest * count:
            raise UserError(
                f"only {tracks.visible.sum()} of {count} markers of the rest frame are found by "
                f"this tracker, at least {settings.fewest:.0%} must be"
            )
        check_each_layer(tracks.visible, self._palette)
        # Shifts are relative to the positions that the tracker itself finds at rest.
        self._origin = np.where(tracks.visible[..., None], tracks.position, self._origin)
        self._edge = self._edge.at_rest(self._origin)
        doubt = replace(self.state.doubt, mask=np.zeros_like(tracks.visible), lost=~tracks.visible)
        self.state = replace(self.state, shift=np.zeros_like(self._origin), doubt=doubt)
        return tracks

    def update(self, frame: Frame) -> Tracks:
        """Find the markers in the next frame.

        Raises
        ------
        UserError
            When the frame has another size or type than the rest frame.
        """
        check_frame(frame, self._shape)
        return self._follow(frame)

    def _follow(self, frame: Frame) -> Tracks:
        """Track one frame and update the state."""
        settings = self._settings
        shift = self.state.shift
        measured = self._find(np.ascontiguousarray(frame.image), self._origin + shift)
        position, (layers, count, _) = measured.position, self._origin.shape
        height, width, _ = self._shape
        corner = np.array([width - 1, height - 1])
        visible = np.all((position >= 0.0) & (position <= corner), axis=-1)
        visible &= ~self._edge.hidden(position)
        moved = position - self._origin
        jump = np.linalg.norm(moved - shift, axis=-1)
        apart = np.linalg.norm(position[:, :, None] - position[:, self._near], axis=-1)
        claimed = (apart < settings.apart * self._pitch).any(axis=-1)
        far = visible & (jump > settings.doubtful_jump * self._pitch)
        before, lost = self.state, ~visible | claimed
        self.state = Shifts(
            shift=_carry(np.where(visible[..., None], moved, shift), visible, self._near),
            last_seen=np.where(visible, frame.time, before.last_seen),
            doubt=before.doubt,
        )
        leap = mean_step(self.state.shift[0], before.shift[0], self._pitch)
        if not before.doubt.stands(lost, far, settings.few, leap):
            self.state = replace(self.state, doubt=self._doubted(before, lost, frame.image))
        unknown = np.full((layers, count), np.nan)
        size = unknown if measured.log_size is None else measured.log_size
        hue = unknown[0] if measured.hue is None else measured.hue
        return Tracks(
            time=frame.time,
            position=np.where(visible[..., None], position, np.nan),
            log_size=np.where(visible, size, np.nan),
            hue=np.where(visible[0], hue, np.nan),
            visible=visible,
            ambiguous=far | (visible & (claimed | self.state.doubt.mask)),
            last_seen=self.state.last_seen.copy(),
            covariance=_covariance(measured.variance, visible),
        )

    def _doubted(self, before: Shifts, lost: NDArray[np.bool_], image: Image) -> Doubt:
        """Judge which numbers are certain."""
        rest, spots = self._origin, self._relocator.blobs(np.ascontiguousarray(image))[0]
        places = (rest, rest + before.shift, rest + self.state.shift)
        return doubted(before.doubt, places, lost, self._pitch, self._near, spots, self._edge)


def _covariance(variance: Array | None, visible: NDArray[np.bool_]) -> Array:
    """Covariance as in `Tracks` of positions with a variance (L, M, 2), if it is known."""
    layers, count = visible.shape
    covariance = np.full((count, layers, 3, layers, 3), np.nan)
    for k in range(layers if variance is not None else 0):
        own = np.where(visible[k, :, None], np.asarray(variance)[k], np.nan)
        covariance[:, k, :2, k, :2] = own[:, :, None] * np.eye(2)
    return covariance.reshape(count, 3 * layers, 3 * layers)


def nearest(points: Array, expected: Array, reach: float, mutual: bool) -> NDArray[np.intp]:
    """Index of the point nearest to each expected position, −1 for none, shape (M,).

    Parameters
    ----------
    points: detected points [px], shape (n, 2)
    expected: expected positions [px], shape (M, 2)
    reach: largest distance of a point [px]
    mutual: whether the expected position must also be the nearest one to the point
    """
    number = np.full(len(expected), -1)
    known = np.flatnonzero(np.isfinite(expected).all(axis=-1))
    if len(points) == 0 or len(known) == 0:
        return number
    distance, partner = scipy.spatial.KDTree(points).query(expected[known])
    taken = np.asarray(distance) < reach
    if mutual:
        back = np.asarray(scipy.spatial.KDTree(expected[known]).query(points)[1])
        taken &= back[partner] == np.arange(len(known))
    number[known[taken]] = np.asarray(partner)[taken]
    return number


def _carry(shift: Array, visible: NDArray[np.bool_], near: NDArray[np.intp]) -> Array:
    """Set shifts (L, M, 2) of lost markers to the median of their visible neighbours, if any."""
    lost = ~visible & visible[:, near].any(axis=-1)
    for layer, m in np.argwhere(lost):
        around = near[m][visible[layer, near[m]]]
        shift[layer, m] = np.median(shift[layer, around], axis=0)
    return shift
