"""Shifts of one specimen's marker pairs since rest, the input of every reconstructor."""

import numpy as np
from numpy.typing import NDArray

from ..tracks import Tracks
from .calibration import SensorCalibration
from .pose import CameraPose, alignment, blocks, carried
from .reconstructors import NoEstimateError
from .rest_fit import rest_pose

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Number of measurements of a pair: (x, y, log size) of magenta, then of yellow.
MEASURED = 6


def floor_variances(calibration: SensorCalibration) -> Array:
    """Variances of the model errors of a pair's measurements, shape (6,)."""
    floor = [calibration.position_floor, calibration.position_floor, calibration.size_floor]
    return np.tile(floor, 2) ** 2


class MarkerShifts:
    """Shifts of the P pairs that were visible at rest, up to an angle from the apex.

    All pixels are converted to the design's own camera, by the pose of the specimen's camera.

    Parameters
    ----------
    calibration: calibration of the sensor
    rest: tracks of the unloaded sensor
    reach: angle from the apex up to which pairs are used [rad]
    pose: pose of the specimen's camera; None: estimated from the rest frame

    Attributes
    ----------
    sensor: calibrated design, with the design's camera
    pose: pose of the specimen's camera
    pairs: indices of the used pairs in the tracks, shape (P,): one marker may be worn off
    places: their places on the skin at rest, see `render.skin`, shape (2, P, 2); a missing marker
        gets the place of its partner
    measured: whether a pair has each measurement, shape (P, 6)
    rest_covariance: covariance of the measurements at rest, shape (P, 6, 6)
    floor: variances of the model errors, shape (6,)

    Raises
    ------
    UserError
        When the rest frame does not determine the camera's pose.
    """

    def __init__(
        self,
        calibration: SensorCalibration,
        rest: Tracks,
        reach: float,
        pose: CameraPose | None = None,
    ) -> None:
        self.sensor = sensor = calibration.sensor
        self.pose = rest_pose(sensor, rest) if pose is None else pose
        self._align = alignment(self.pose, sensor.view.camera, rest.position)
        there = rest.visible & ~rest.ambiguous
        pairs = np.flatnonzero(there.any(axis=0))
        at_rest = self._align(rest.position[:, pairs])[..., :2]
        places = np.stack([sensor.places_at(p, k) for k, p in enumerate(at_rest)])
        places = np.where(there[:, pairs, None], places, places[::-1])
        near = places[0, :, 0] < reach
        self.pairs = pairs[near]
        self.places = places[:, near]
        self._there = there[:, self.pairs]
        self.measured = np.repeat(self._there.T, MEASURED // len(there), axis=1)
        # The Jacobian at rest is used throughout, as markers move little.
        self._blocks = blocks(self._align, rest.position[:, self.pairs])
        self.rest_covariance = self.covariance(rest)
        self.floor = floor_variances(calibration)
        self._at_rest = self._seen(rest)

    def __call__(self, tracks: Tracks, least: int) -> tuple[Array, Mask]:
        """Shifts of (x, y, log size) of both layers, (P, 6), and which pairs are certain, (P,).

        A shift that is not measured is 0.

        Raises
        ------
        NoEstimateError
            When fewer than `least` pairs are certain.
        """
        certain = self.whole(tracks.visible & ~tracks.ambiguous)
        if certain.sum() < least:
            raise NoEstimateError(
                f"{certain.sum()} marker pairs visible near the contact, at least {least} "
                "are needed"
            )
        return np.where(self.measured, self._seen(tracks) - self._at_rest, 0.0), certain

    def whole(self, markers: Mask) -> Mask:
        """Mask (P,) of pairs whose markers, if present at rest, are all in `markers` (L, M)."""
        return np.asarray((markers[:, self.pairs] | ~self._there).all(axis=0))

    def covariance(self, tracks: Tracks, some: NDArray[np.bool_] | None = None) -> Array:
        """Covariance of (x, y, log size) of all pairs in one frame, or of some (P,): (…, 6, 6).

        It is NaN for invisible pairs; missing measurements are independent of others.
        """
        of = slice(None) if some is None else some
        return carried(self._blocks[of], self.separated(tracks.covariance[self.pairs[of]], some))

    def separated(self, covariance: Array, some: NDArray[np.bool_] | None = None) -> Array:
        """Make missing measurements independent of others in covariances (…, 6, 6)."""
        measured = self.measured[slice(None) if some is None else some]
        both = measured[:, :, None] & measured[:, None, :]
        return np.where(both, covariance, np.eye(MEASURED))

    def noise(self, tracks: Tracks) -> Array:
        """Covariance of the shifts, including the model errors, shape (P, 6, 6)."""
        return self.covariance(tracks) + self.rest_covariance + np.diag(self.floor)

    def _seen(self, tracks: Tracks) -> Array:
        """Measurements (x, y, log size) of both layers of each pair, shape (P, 6)."""
        seen = self._align(tracks.position[:, self.pairs])
        seen[..., 2] += tracks.log_size[:, self.pairs]
        return np.swapaxes(seen, 0, 1).reshape(-1, MEASURED)
