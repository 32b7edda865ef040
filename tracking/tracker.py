"""The marker tracker: optical flow predicts, a least-squares fit of both layers measures.

Each frame is fitted afresh to the known shape, so errors do not add up; the flow only says where
to start. A pair whose fit does not explain its pixels is reported as lost, and looked for in the
next frame where its neighbours say it should be.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ..render import Frame
from ..render.colour import decoding_table
from ..render.coverage import edge_width
from .detection import DetectionError, read_rest
from .fit_kernels import Optics, fit_pairs, mean_hues
from .palette import Palette
from .trackers import FrameError
from .tracks import Tracks

Array = NDArray[np.float64]

#: Fits with a larger mean squared residual over the noise variance are called lost …
MAX_MISFIT = 6.0
#: … as are layers that jump further than this from where flow predicts them [px].
MAX_JUMP = 6.0
_NEIGHBOURS = 6


class MarkerTracker:
    """Follows the marker pairs of one sensor from frame to frame.

    Parameters
    ----------
    palette: of the markers
    noise: standard deviation of the camera noise [grey levels]; rounding is added to it
    """

    def __init__(self, palette: Palette, noise: float) -> None:
        self._palette = palette
        self._noise = noise

    def reset(self, rest: list[Frame]) -> Tracks:
        """Find the markers in frames of the unloaded sensor; their mean is the rest they keep.

        Raises
        ------
        DetectionError
            When there is no frame, or it does not show the sensor's markers.
        """
        seen_rest = read_rest(rest, self._palette)
        pairs = seen_rest.position[:, :, :][:, np.isfinite(seen_rest.position).all(axis=(0, 2))]
        count = pairs.shape[1]
        near = np.asarray(KDTree(pairs[0]).query(pairs[0], k=_NEIGHBOURS + 1)[1])
        linear = decoding_table()
        sensor = self._palette.sensor
        self._share = np.ones(2) if sensor is None else sensor.follow / sensor.follow[0]
        self._optics = Optics(
            linear=linear,
            weight=1.0 / (np.gradient(linear) ** 2 * (self._noise**2 + 1.0 / 12.0)),
            ground=seen_rest.ground,
            absorbed=1.0 - self._palette.transmittance,
            shapes=np.tile(seen_rest.radius[:, None, None, None] * np.eye(2), (1, count, 1, 1)),
            neighbours=near[:, 1:].astype(np.int64),
            width=edge_width(0.8),
        )
        start = np.zeros((count, 2, 5))
        start[:, :, :2] = np.swapaxes(pairs, 0, 1)
        seen = [self._fit(frame, start, iterations=8) for frame in rest]
        fits = np.mean([fit for fit, _ in seen], axis=0)
        found = ~np.isnan(fits).any(axis=(1, 2))
        if found.sum() < 0.9 * count:
            raise DetectionError(
                f"only {found.sum()} of {count} marker pairs of the rest frame look like markers"
            )
        covariance = np.mean([covariance for _, covariance in seen], axis=0) / len(rest)
        self._rest = np.where(found[:, None, None], fits, start)
        self._fits = self._rest.copy()
        self._previous = self._grey(rest[-1])
        self._last_seen = np.full((2, count), np.nan)
        self.rest = self._tracks(rest[-1], fits, covariance)
        return self.rest

    def update(self, frame: Frame) -> Tracks:
        """Markers in the next frame."""
        expected = self._optics.ground.shape
        if frame.image.shape != expected or frame.image.dtype != np.uint8:
            raise FrameError(
                f"frame has shape {frame.image.shape} and type {frame.image.dtype}, the rest frame "
                f"had {expected} and uint8"
            )
        grey = self._grey(frame)
        start = self._fits[:, 0, :2].astype(np.float32)
        flowed, found, _ = cv2.calcOpticalFlowPyrLK(
            self._previous, grey, start, start.copy(), winSize=(21, 21), maxLevel=2
        )
        shift = np.where(found == 1, flowed - start, 0.0)
        # The flow sees the darkest layer, magenta; the other one moves in proportion.
        predicted = self._fits.copy()
        predicted[:, :, :2] += self._share[:, None] * shift[:, None, :]
        fits, covariance = self._fit(frame, predicted, iterations=6)
        self._previous = grey
        self._remember(fits)
        return self._tracks(frame, fits, covariance)

    def _fit(self, frame: Frame, predicted: Array, iterations: int) -> tuple[Array, Array]:
        """Fits (M, 2, 5), NaN where lost, and their covariances (M, 10, 10)."""
        fits = predicted.copy()
        covariance = np.empty((len(fits), 10, 10))
        misfit = np.empty(len(fits))
        fit_pairs(frame.image, self._optics, fits, covariance, misfit, iterations)
        jump = np.abs(fits[:, :, :2] - predicted[:, :, :2]).max(axis=(1, 2))
        fits[~((misfit < MAX_MISFIT) & (jump < MAX_JUMP))] = np.nan
        return fits, covariance

    def _tracks(self, frame: Frame, fits: Array, covariance: Array) -> Tracks:
        p, q = fits[:, :, 3].T, fits[:, :, 4].T
        measured = np.array([0, 1, 2, 5, 6, 7])  # (x, y, log size) of both layers
        visible = ~np.isnan(fits[:, :, 0].T)
        self._last_seen = np.where(visible, frame.time, self._last_seen)
        return Tracks(
            time=frame.time,
            position=np.swapaxes(fits[:, :, :2], 0, 1),
            log_size=fits[:, :, 2].T + 0.5 * np.log(1.0 - p**2 - q**2),
            hue=mean_hues(frame.image, self._optics.shapes, fits),
            visible=visible,
            ambiguous=np.zeros_like(visible),
            last_seen=self._last_seen,
            covariance=covariance[:, measured[:, None], measured],
        )

    def _remember(self, fits: Array) -> None:
        """Start of the next frame; lost markers go with their neighbours."""
        lost = np.isnan(fits[:, 0, 0])
        self._fits = fits.copy()
        for m in np.flatnonzero(lost):
            near = self._optics.neighbours[m][~lost[self._optics.neighbours[m]]]
            self._fits[m] = self._rest[m]
            if len(near):
                self._fits[m] += np.median(fits[near] - self._rest[near], axis=0)

    @staticmethod
    def _grey(frame: Frame) -> NDArray[np.uint8]:
        """Green channel, where magenta is darkest and yellow almost clear."""
        return np.ascontiguousarray(frame.image[:, :, 1])
