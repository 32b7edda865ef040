"""Force field from tracks, as a fitted smooth displacement times the chain's stiffness.

This is the baseline for other methods. It differentiates the displacement, which amplifies noise.
"""

import numpy as np
from numpy.typing import NDArray

from ....model import ForceField, chain_forces
from ...tracks import Tracks
from ..calibration import SensorCalibration
from ..reconstructors import NoEstimateError
from ..shifts import MarkerShifts
from .contact_reading import ForcePrior, read_contact
from .sensitivity import MarkerResponse
from .settings import StiffnessSettings

Array = NDArray[np.float64]


class StiffnessReading:
    """Estimates forces as K(u)·u of the smooth displacement u that fits the markers.

    Parameters
    ----------
    calibration: calibration of the sensor
    rest: tracks of the unloaded sensor
    settings: tuned parameters
    """

    def __init__(
        self,
        calibration: SensorCalibration,
        rest: Tracks,
        settings: StiffnessSettings = StiffnessSettings(),
    ) -> None:
        self._fingertip, self._settings = calibration.fingertip, settings
        tip, knots = calibration.fingertip, settings.knots
        self._shifts = MarkerShifts(calibration, rest, np.pi / 2)
        self._response = MarkerResponse(self._shifts.sensor, self._shifts.places, tip.angles())
        angles, middles = tip.angles(), np.linspace(-np.pi / 2, np.pi / 2, knots)
        bumps = np.exp(-0.5 * ((angles[:, None] - middles) * tip.radius / settings.width) ** 2)
        bumps[[0, -1]] = 0.0  # fixed to the rigid part
        self._basis = np.zeros((tip.nodes, 2, 2 * knots))
        self._basis[:, 0, :knots] = self._basis[:, 1, knots:] = bumps
        self._at_rest, self._jacobian = self._response(np.zeros((tip.nodes, 2)), self._basis)
        self._near = np.abs(angles) < np.deg2rad(ForcePrior.reach_deg)

    def reset(self) -> None:
        """Do nothing: every frame is independent."""

    def update(self, tracks: Tracks) -> ForceField:
        """Estimate the force field of a frame.

        Raises
        ------
        NoEstimateError
            When too few pairs are visible.
        NoEstimateError
            When the passes diverge.
        """
        settings = self._settings
        shifts, visible = self._shifts(tracks, settings.least_markers)
        jacobian = self._jacobian[visible]
        weighted = np.linalg.solve(self._shifts.noise(tracks)[visible], jacobian)
        weighted = weighted.reshape(-1, jacobian.shape[2])
        jacobian = jacobian.reshape(weighted.shape)
        information = weighted.T @ jacobian + np.eye(len(jacobian.T)) / settings.amplitude**2
        root = np.linalg.inv(np.linalg.cholesky(information)).T
        mean = np.zeros(len(root))
        none = np.empty((self._fingertip.nodes, 2, 0))
        try:
            with np.errstate(invalid="raise"):
                for _ in range(settings.passes):
                    predicted, _ = self._response(self._basis @ mean, none)
                    left = (shifts - predicted + self._at_rest)[visible].ravel() + jacobian @ mean
                    mean = root @ (root.T @ (weighted.T @ left))
        except FloatingPointError:
            raise NoEstimateError(
                "no smooth displacement of the skin explains the markers"
            ) from None
        displacement, factor = self._basis @ mean, self._basis @ root
        forces = self._forces(displacement)
        columns = np.moveaxis(factor, 2, 0)
        steps = [self._forces(displacement + settings.step * column) for column in columns]
        spread = (np.stack(steps, axis=2) - forces[:, :, None]) / settings.step
        return read_contact(self._fingertip, displacement, forces, spread, factor, settings.contact)

    def _forces(self, displacement: Array) -> Array:
        return np.where(self._near[:, None], chain_forces(self._fingertip, displacement), 0.0)
