"""How the marker pairs of one specimen have moved since rest: what every reconstructor reads."""

import numpy as np
from numpy.typing import NDArray

from ..tracks import Tracks
from .calibration import SensorCalibration
from .pose import CameraPose, alignment, blocks, carried
from .reconstructors import NoEstimateError
from .rest_fit import rest_pose

Array = NDArray[np.float64]

#: Measurements of a pair, in order: (x, y, log size) of magenta, then of yellow.
MEASURED = 6


class MarkerShifts:
    """Shifts of the pairs of which both markers were visible at rest, up to an angle from the apex.

    All pixels are those of the design's own camera: what the specimen's camera shows is carried
    over by the pose that the rest frame tells.

    Parameters
    ----------
    calibration: of the sensor
    rest: tracks of the unloaded sensor
    reach: pairs further from the apex are left out [rad]
    pose: of the specimen's camera, where it is known; by default the rest frame tells it

    Attributes
    ----------
    sensor: calibration of the image, with the design's camera
    pose: of the specimen's camera
    pairs: numbers of the pairs read, P of them, shape (P,)
    places: where they are at rest, see `render.skin`, shape (2, P, 2)
    rest_covariance: of the measurements at rest, shape (P, 6, 6)
    floor: variances that stand for the calibration's own errors, shape (6,)

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
    ) -> None:
        self.sensor = sensor = calibration.sensor
        self.pose = rest_pose(sensor, rest) if pose is None else pose
        self._align = alignment(self.pose, sensor.view.camera, rest.position)
        pairs = np.flatnonzero((rest.visible & ~rest.ambiguous).all(axis=0))
        at_rest = self._align(rest.position[:, pairs])[..., :2]
        places = np.stack([sensor.places_at(p, k) for k, p in enumerate(at_rest)])
        near = places[0, :, 0] < reach
        self.pairs = pairs[near]
        self.places = places[:, near]
        # Markers move little, and the camera's pose changes little on the way.
        self._blocks = blocks(self._align, rest.position[:, self.pairs])
        self.rest_covariance = self.covariance(rest)
        position, size = calibration.position_floor, calibration.size_floor
        self.floor = np.tile([position, position, size], 2) ** 2
        self._at_rest = self._measured(rest)

    def __call__(self, tracks: Tracks, least: int) -> tuple[Array, NDArray[np.bool_]]:
        """Shifts of (x, y, log size) of both layers, (P, 6), and which pairs are certain, (P,).

        Raises
        ------
        NoEstimateError
            When fewer than `least` pairs are certain.
        """
        certain = tracks.visible & ~tracks.ambiguous
        visible = np.all(certain[:, self.pairs], axis=0)
        if visible.sum() < least:
            raise NoEstimateError(
                f"{visible.sum()} marker pairs visible near the contact, at least {least} "
                "are needed"
            )
        return self._measured(tracks) - self._at_rest, visible

    def covariance(self, tracks: Tracks) -> Array:
        """Covariance of the pairs' (x, y, log size) in one frame, shape (P, 6, 6)."""
        return carried(self._blocks, tracks.covariance[self.pairs])

    def noise(self, tracks: Tracks) -> Array:
        """Covariance of the shifts, the floor included, shape (P, 6, 6)."""
        return self.covariance(tracks) + self.rest_covariance + np.diag(self.floor)

    def _measured(self, tracks: Tracks) -> Array:
        """(x, y, log size) of the pairs' layers, shape (P, 6)."""
        seen = self._align(tracks.position[:, self.pairs])
        seen[..., 2] += tracks.log_size[:, self.pairs]
        return np.swapaxes(seen, 0, 1).reshape(-1, MEASURED)
