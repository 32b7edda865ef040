"""The marker tracker: optical flow predicts, a least-squares fit of both layers measures.

Each frame is fitted afresh to the known shape, so errors do not add up; the flow only says where
to start. A pair whose fit does not explain its pixels is reported as lost, and looked for in the
next frame where its neighbours say it should be.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ..render import Frame, SensorDesign
from ..render.colour import decode_srgb, decoding_table
from ..render.coverage import edge_width
from .detection import DetectionError, detect_markers
from .fit_kernels import Optics, fit_pairs, mean_hues
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
    sensor: calibration
    noise: standard deviation of the camera noise [grey levels]; rounding is added to it
    """

    def __init__(self, sensor: SensorDesign, noise: float) -> None:
        self._sensor = sensor
        self._noise = noise

    def reset(self, rest: list[Frame]) -> Tracks:
        """Find the markers in frames of the unloaded sensor; their mean is the rest they keep.

        Raises
        ------
        DetectionError
            When there is no frame, or it does not show the sensor's markers.
        """
        if not rest:
            raise DetectionError("the tracker needs at least one rest frame")
        mean = np.mean([frame.image for frame in rest], axis=0)
        pairs, ground = detect_markers(decode_srgb(mean), self._sensor)
        #: Places of the markers on the skin, read off the rest frame, shape (2, M, 2).
        self.places = np.stack([self._sensor.places_at(p, k) for k, p in enumerate(pairs)])
        count = pairs.shape[1]
        near = np.asarray(KDTree(pairs[0]).query(pairs[0], k=_NEIGHBOURS + 1)[1])
        linear = decoding_table()
        self._optics = Optics(
            linear=linear,
            weight=1.0 / (np.gradient(linear) ** 2 * (self._noise**2 + 1.0 / 12.0)),
            ground=ground,
            absorbed=1.0 - self._sensor.transmittance,
            shapes=self._nominal_shapes(),
            neighbours=near[:, 1:].astype(np.int64),
            width=edge_width(self._sensor.camera.blur_px),
        )
        start = np.zeros((count, 2, 5))
        start[:, :, :2] = np.swapaxes(pairs, 0, 1)
        seen = [self._fit(frame, start, iterations=8) for frame in rest]
        fits = np.mean([fit for fit, _ in seen], axis=0)
        found = ~np.isnan(fits).any(axis=(1, 2))
        if found.sum() < 0.9 * len(self._sensor.places):
            raise DetectionError(
                f"only {found.sum()} of {count} marker pairs of the rest frame look like markers "
                f"of the sensor"
            )
        covariance = np.mean([covariance for _, covariance in seen], axis=0) / len(rest)
        self._rest = np.where(found[:, None, None], fits, start)
        self._fits = self._rest.copy()
        self._previous = self._grey(rest[-1])
        self.rest = self._tracks(rest[-1], fits, covariance)
        return self.rest

    def update(self, frame: Frame) -> Tracks:
        """Markers in the next frame."""
        expected = self._optics.ground.shape
        if frame.image.shape != expected or frame.image.dtype != np.uint8:
            raise ValueError(
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
        share = self._sensor.follow / self._sensor.follow[0]
        predicted = self._fits.copy()
        predicted[:, :, :2] += share[:, None] * shift[:, None, :]
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
        return Tracks(
            time=frame.time,
            position=np.swapaxes(fits[:, :, :2], 0, 1),
            log_size=fits[:, :, 2].T + 0.5 * np.log(1.0 - p**2 - q**2),
            hue=mean_hues(frame.image, self._optics.shapes, fits),
            visible=~np.isnan(fits[:, :, 0].T),
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

    def _nominal_shapes(self) -> Array:
        """Images of the discs' semi-axes at rest, as columns [px], shape (2, M, 2, 2)."""
        shapes = []
        sensor, skin = self._sensor, self._sensor.shape
        layers = zip(self.places, sensor.depths, sensor.half_sizes, strict=True)
        for places, depth, half in layers:
            axes = half * np.stack(skin.tangents(places), axis=-1)
            shapes.append(sensor.view.jacobian(skin.points(places, depth)) @ axes)
        return np.stack(shapes)

    @staticmethod
    def _grey(frame: Frame) -> NDArray[np.uint8]:
        """Green channel, where magenta is darkest and yellow almost clear."""
        return np.ascontiguousarray(frame.image[:, :, 1])
