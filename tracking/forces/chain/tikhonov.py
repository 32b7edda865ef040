"""Force field from tracks by one matrix product: the chain and the image linearised at rest.

Smooth forces of unknown size explain the shifts, f = argmin |y − J·C·f|² + fᵀP⁻¹f/λ. In the
eigenvectors of what the markers tell of the prior's unknowns every λ is a scalar filter, so that
the evidence picks λ anew in every frame. Fast, and far off where the skin has turned much.
"""

import numpy as np
from numpy.typing import NDArray

from ....model import ForceField, chain_compliance
from ...tracks import Tracks
from ..calibration import SensorCalibration
from ..shifts import MarkerShifts
from .contact_reading import ForcePrior, force_basis, read_contact
from .sensitivity import MarkerResponse

Array = NDArray[np.float64]

#: Fewer visible pairs than this say too little.
MIN_MARKERS = 20
#: Markers further than this outside the prior's reach do not feel the contact [rad].
_MARGIN = np.deg2rad(20.0)
#: Coarser than the prior of the Gaussian process: what is wrong by linearising is not sharp.
_PRIOR = ForcePrior(knots=21, length=1.2e-3)
#: Prior variances of a node's force that the evidence chooses from, at 251 nodes [N²].
_VARIANCES = np.geomspace(1e-4, 0.3, 24)[:, None] ** 2
#: Slope of the skin below which the jump in its stiffness is smoothed.
_BLUNT = 0.05


class Tikhonov:
    """Reconstructs contact forces with an operator that is made once for the pairs in view.

    Parameters
    ----------
    calibration: of the sensor
    rest: tracks of the unloaded sensor
    """

    def __init__(self, calibration: SensorCalibration, rest: Tracks) -> None:
        self._fingertip = tip = calibration.fingertip
        reach = np.deg2rad(_PRIOR.reach_deg) + _MARGIN
        self._shifts = MarkerShifts(calibration, rest, reach)
        basis, correlation = force_basis(tip, _PRIOR)
        loaded = np.flatnonzero(basis.any(axis=(1, 2)))
        self._zone = slice(int(loaded[0]), int(loaded[-1]) + 1)
        unloaded = np.zeros((tip.nodes, 2))
        self._basis = basis @ np.linalg.cholesky(correlation)
        self._moves = chain_compliance(tip, unloaded, self._basis, _BLUNT)
        response = MarkerResponse(self._shifts.sensor, self._shifts.places, tip.angles())
        self._jacobian = response(unloaded, self._moves)[1]
        self.reset()

    def reset(self) -> None:
        """Forget which pairs were in view, and their noise."""
        self._visible = np.zeros(len(self._shifts.pairs), dtype=bool)

    def update(self, tracks: Tracks) -> ForceField:
        """Force field of a frame.

        Raises
        ------
        NoEstimateError
            When fewer than MIN_MARKERS pairs are visible.
        """
        shifts, visible = self._shifts(tracks, MIN_MARKERS)
        if not np.array_equal(visible, self._visible):
            self._see(visible, self._shifts.noise(tracks))
        found = self._operator @ shifts[visible].ravel()
        scale = 1.0 + _VARIANCES * self._told
        evidence = (_VARIANCES * found**2 / scale - np.log(scale)).sum(axis=1)
        best = int(np.argmax(evidence))
        filtered = _VARIANCES[best] / scale[best]
        mean, deviation = filtered * found, np.sqrt(filtered)
        seen, forces = self._eigen_moves @ mean, np.zeros((self._fingertip.nodes, 2))
        forces[self._zone] = self._eigen_forces @ mean
        return read_contact(
            self._fingertip,
            seen,
            forces,
            self._eigen_forces * deviation,
            self._eigen_moves[self._zone] * deviation,
            self._zone.start,
        )

    def _see(self, visible: NDArray[np.bool_], noise: Array) -> None:
        """Make the operator for the pairs in view."""
        weighted = np.linalg.solve(noise[visible], self._jacobian[visible])
        weighted = weighted.reshape(-1, weighted.shape[2])
        jacobian = self._jacobian[visible].reshape(weighted.shape)
        #: What the markers tell of each eigenvector, in units of the prior.
        self._told, vectors = np.linalg.eigh(jacobian.T @ weighted)
        self._told = np.maximum(self._told, 0.0)
        self._operator = (weighted @ vectors).T
        self._eigen_forces = self._basis[self._zone] @ vectors
        self._eigen_moves = self._moves @ vectors
        self._visible = visible
