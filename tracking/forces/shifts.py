"""How the marker pairs of one specimen have moved since rest: what every reconstructor reads."""

import numpy as np
from numpy.typing import NDArray

from ..tracks import Tracks
from .calibration import SensorCalibration
from .pose import CameraPose, alignment, blocks, carried
from .reconstructors import NoEstimateError
from .rest_fit import rest_pose

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Measurements of a pair, in order: (x, y, log size) of magenta, then of yellow.
MEASURED = 6


def floor_variances(calibration: SensorCalibration) -> Array:
    """Variances that stand for the model's own errors of a pair's measurements, shape (6,)."""
    floor = [calibration.position_floor, calibration.position_floor, calibration.size_floor]
    return np.tile(floor, 2) ** 2


class MarkerShifts:
    """Shifts of the pairs that were visible at rest, up to an angle from the apex.

    All pixels are those of the design's own camera: what the specimen's camera shows is carried
    over by the pose that the rest frame tells.

    Parameters
    ----------
    calibration: of the sensor
    rest: tracks of the unloaded sensor
    reach: pairs further from the apex are left out [rad]
    pose: of the specimen's camera, where it is known; by default the rest frame tells it
    halves: read pairs of which one marker alone was visible at rest, as where the other is worn off

    Attributes
    ----------
    sensor: calibration of the image, with the design's camera
    pose: of the specimen's camera
    pairs: numbers of the pairs read, P of them, shape (P,)
    places: where they are at rest, see `render.skin`, shape (2, P, 2); a marker that is not there
        is taken to be at the other's
    measured: whether a pair has each measurement, shape (P, 6)
    rest_covariance: of the measurements at rest, shape (P, 6, 6)
    floor: variances that stand for the model's own errors, shape (6,)

    Raises
    ------
    UserError
        When the rest frame does not tell the camera's pose.
    """

    def __init__(
        self,
        calibration: SensorCalibration,
        rest: Tracks,
        reach: float,
        pose: CameraPose | None = None,
        *,
        halves: bool = False,
    ) -> None:
        self.sensor = sensor = calibration.sensor
        self.pose = rest_pose(sensor, rest) if pose is None else pose
        self._align = alignment(self.pose, sensor.view.camera, rest.position)
        there = rest.visible & ~rest.ambiguous
        pairs = np.flatnonzero(there.any(axis=0) if halves else there.all(axis=0))
        at_rest = self._align(rest.position[:, pairs])[..., :2]
        places = np.stack([sensor.places_at(p, k) for k, p in enumerate(at_rest)])
        places = np.where(there[:, pairs, None], places, places[::-1])
        near = places[0, :, 0] < reach
        self.pairs = pairs[near]
        self.places = places[:, near]
        self._there = there[:, self.pairs]
        self.measured = np.repeat(self._there.T, MEASURED // len(there), axis=1)
        # Markers move little, and the camera's pose changes little on the way.
        self._blocks = blocks(self._align, rest.position[:, self.pairs])
        self.rest_covariance = self.covariance(rest)
        self.floor = floor_variances(calibration)
        self._at_rest = self._seen(rest)

    def __call__(self, tracks: Tracks, least: int) -> tuple[Array, Mask]:
        """Shifts of (x, y, log size) of both layers, (P, 6), and which pairs are certain, (P,).

        What is not measured has not moved.

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
        """Pairs (P,) of which every marker that was there at rest is among some (L, M)."""
        return np.asarray((markers[:, self.pairs] | ~self._there).all(axis=0))

    def covariance(self, tracks: Tracks, some: NDArray[np.bool_] | None = None) -> Array:
        """Covariance of (x, y, log size) of all pairs in one frame, or of some (P,): (…, 6, 6).

        Where a pair is not visible it is NaN; what is not measured is independent of the rest.
        """
        of = slice(None) if some is None else some
        return carried(self._blocks[of], self.separated(tracks.covariance[self.pairs[of]], some))

    def separated(self, covariance: Array, some: NDArray[np.bool_] | None = None) -> Array:
        """Covariances (…, 6, 6) in which what is not measured is independent of the rest."""
        measured = self.measured[slice(None) if some is None else some]
        both = measured[:, :, None] & measured[:, None, :]
        return np.where(both, covariance, np.eye(MEASURED))

    def noise(self, tracks: Tracks) -> Array:
        """Covariance of the shifts, the floor included, shape (P, 6, 6)."""
        return self.covariance(tracks) + self.rest_covariance + np.diag(self.floor)

    def _seen(self, tracks: Tracks) -> Array:
        """(x, y, log size) of the pairs' layers, shape (P, 6)."""
        seen = self._align(tracks.position[:, self.pairs])
        seen[..., 2] += tracks.log_size[:, self.pairs]
        return np.swapaxes(seen, 0, 1).reshape(-1, MEASURED)
