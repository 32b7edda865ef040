"""How the marker pairs of one specimen have moved since rest: what every reconstructor reads."""

import numpy as np
from numpy.typing import NDArray

from ..tracks import Tracks
from .calibration import SensorCalibration
from .reconstructors import NoEstimateError
from .rest_fit import fitted_to_rest

Array = NDArray[np.float64]

#: Measurements of a pair, in order: (x, y, log size) of magenta, then of yellow.
MEASURED = 6


class MarkerShifts:
    """Shifts of the pairs of which both markers were visible at rest, up to an angle from the apex.

    Parameters
    ----------
    calibration: of the sensor
    rest: tracks of the unloaded sensor
    reach: pairs further from the apex are left out [rad]

    Attributes
    ----------
    sensor: calibration of the image, its camera fitted to the rest frame
    pairs: numbers of the pairs read, P of them, shape (P,)
    places: where they are at rest, see `render.skin`, shape (2, P, 2)
    rest_covariance: of the measurements at rest, shape (P, 6, 6)
    floor: variances that stand for the calibration's own errors, shape (6,)
    """

    def __init__(self, calibration: SensorCalibration, rest: Tracks, reach: float) -> None:
        pairs = np.flatnonzero((rest.visible & ~rest.ambiguous).all(axis=0))
        self.sensor = sensor = fitted_to_rest(calibration.sensor, rest)
        places = np.stack([sensor.places_at(p, k) for k, p in enumerate(rest.position[:, pairs])])
        near = places[0, :, 0] < reach
        self.pairs = pairs[near]
        self.places = places[:, near]
        self.rest_covariance = rest.covariance[self.pairs]
        position, size = calibration.position_floor, calibration.size_floor
        self.floor = np.tile([position, position, size], 2) ** 2
        self._at_rest = _measured(rest)[self.pairs]

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
        return _measured(tracks)[self.pairs] - self._at_rest, visible

    def noise(self, tracks: Tracks) -> Array:
        """Covariance of the shifts, the floor included, shape (P, 6, 6)."""
        return tracks.covariance[self.pairs] + self.rest_covariance + np.diag(self.floor)


def _measured(tracks: Tracks) -> Array:
    """(x, y, log size) of both layers, shape (M, 6)."""
    both = np.concatenate([tracks.position, tracks.log_size[..., None]], axis=-1)
    return np.swapaxes(both, 0, 1).reshape(-1, MEASURED)
