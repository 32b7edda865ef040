"""Force field from tracks: nodal forces with a smoothness prior, through the chain's own stiffness.

The unknowns are forces, not displacements: u = K(u)⁻¹·f is smooth by itself, and sums of f are well
determined where sums of a differentiated u are not. A Gaussian-process prior on f in a compact
zone, whose extent is chosen by its evidence, does the regularising. Solved in sensor axes; the
result is turned into the object's normal by `contact_reading`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....model import ForceField, chain_compliance, chain_forces
from ...tracks import Tracks
from ..calibration import SensorCalibration
from ..reconstructors import NoEstimateError
from ..shifts import MarkerShifts
from .contact_reading import ForcePrior, force_basis, read_contact
from .sensitivity import MarkerResponse

Array = NDArray[np.float64]

#: Fewer visible pairs than this near the contact say too little about it.
MIN_MARKERS = 20
#: Markers further than this outside the prior's reach do not feel the contact [rad].
_MARGIN = np.deg2rad(20.0)
#: No node moves by more than this share of the radius.
_FARTHEST = 0.5
#: Slope of the skin below which the jump in its stiffness is smoothed, so that Newton settles.
_BLUNT = 0.05
#: Log evidence that a zone must win by: a tie must not make the estimate flicker.
_ZONE_GAIN = 1.5
#: A step smaller than this ends the passes [m] …
_SETTLED = 20e-6
#: … and one that is still larger than this after the last of them is no solution [m].
_UNSETTLED = 60e-6
#: How the noise is overstated from pass to pass, seeking from rest: the skin may fold the wrong
#: way, and forces that come up smooth and broad before they sharpen keep it from doing so.
_COLD = (100.0, 30.0, 10.0, 5.0, 3.0, 2.0, 1.0, 1.0, 1.0)
#: Ways to a solution, and the share of a Newton step that each takes: from the last frame; from
#: rest; from rest with care.
_TRIES = (((1.0, 1.0), 0.8), (_COLD, 0.8), (tuple(np.repeat(_COLD, 2).tolist()), 0.4))
#: Passes of half the step that follow where these do not settle.
_MORE = 8
#: What forces that are smooth between knots cannot follow of a marker's motion [px]: without it,
#: places that are known to 0.01 px bend the forces of sharp contacts.
_COARSENESS = 0.15
#: Mean square of the markers' residuals over their noise above which nothing explains them.
_MISFIT = 9.0


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """Nodal forces after a pass, as unknowns of `force_basis` in the contact zone.

    Attributes
    ----------
    information: of the unknowns, prior included, shape (U, U)
    moment: information times their mean, shape (U,)
    basis: nodal forces per unknown [N], shape (N, 2, U)
    moves: node displacements per unknown [m], shape (N, 2, U)
    knots: places of the unknowns along x, and again along z, angle from the apex [rad], (U/2,)
    misfit: mean square of the residuals over their noise
    """

    information: Array
    moment: Array
    basis: Array
    moves: Array
    knots: Array
    misfit: float

    def solve(self) -> tuple[Array, Array, Array]:
        """Mean of the unknowns (U,), factors (N, 2, U) of the covariance of forces and moves."""
        root = np.linalg.inv(np.linalg.cholesky(self.information)).T
        return root @ (root.T @ self.moment), self.basis @ root, self.moves @ root


class GaussianProcess:
    """Reconstructs the chain's contact forces from the tracks of one sensor.

    Parameters
    ----------
    calibration: of the sensor
    rest: tracks of the unloaded sensor
    prior: see ForcePrior
    """

    def __init__(
        self, calibration: SensorCalibration, rest: Tracks, prior: ForcePrior | None = None
    ) -> None:
        self._prior = prior or ForcePrior()
        self._fingertip = fingertip = calibration.fingertip
        reach = np.deg2rad(self._prior.reach_deg) + _MARGIN
        self._shifts = MarkerShifts(calibration, rest, reach)
        self._response = MarkerResponse(
            self._shifts.sensor, self._shifts.places, fingertip.angles()
        )
        self._hats, self._correlation = force_basis(fingertip, self._prior)
        self._knots = self._prior.knot_angles()
        unloaded = np.zeros((fingertip.nodes, 2))
        at_rest, _ = self._response(unloaded, np.empty((*unloaded.shape, 0)))
        self._at_rest = at_rest + self._response.perspective(unloaded)
        self._coarseness = _COARSENESS**2 * np.diag(np.tile([1.0, 1.0, 0.0], 2))
        self.reset()

    def reset(self) -> None:
        """Forget the last frame: the next one is linearised about rest."""
        self._seen = np.zeros((self._fingertip.nodes, 2))
        self._amplitude = 10 * self._prior.amplitude
        middle = self._prior.knots // 2
        self._zone = (middle - 4, middle + 4)
        self._warm = False

    def update(self, tracks: Tracks) -> ForceField:
        """Force field of a frame.

        Raises
        ------
        NoEstimateError
            When fewer than MIN_MARKERS pairs are visible.
        NoEstimateError
            When no solution explains the markers, not even one sought from rest.
        """
        shifts, visible = self._shifts(tracks, MIN_MARKERS)
        observed = shifts[visible]
        noise = self._shifts.noise(tracks)[visible] + self._coarseness
        whiten = np.linalg.inv(np.linalg.cholesky(noise))
        for heats, damping in _TRIES[0 if self._warm else 1 :]:
            found = self._settle(observed, whiten, visible, heats, damping)
            if found is not None:
                self._warm = True
                return self._field(found)
            self.reset()
        raise NoEstimateError("no deformation of the fingertip explains the markers")

    def _settle(
        self,
        observed: Array,
        whiten: Array,
        visible: NDArray[np.bool_],
        heats: tuple[float, ...],
        damping: float,
    ) -> Posterior | None:
        """Posterior after passes with the noise overstated by `heats`; None where none fits."""
        shares = [damping] * len(heats) + [0.5 * damping] * _MORE
        for heat, share in zip((*heats, *[1.0] * _MORE), shares, strict=True):
            try:
                with np.errstate(invalid="raise"):
                    found, step = self._pass(observed, whiten / heat, visible)
            except (FloatingPointError, np.linalg.LinAlgError):
                return None
            self._seen = self._seen + share * step
            if not abs(self._seen).max() < _FARTHEST * self._fingertip.radius:
                return None
            moved = abs(share * step).max()
            if heat == 1.0 and moved < _SETTLED:
                break
        return found if moved < _UNSETTLED and found.misfit < _MISFIT else None

    def _pass(
        self, observed: Array, whiten: Array, visible: NDArray[np.bool_]
    ) -> tuple[Posterior, Array]:
        """Posterior linearised about the last displacement, and the step to what it says [m]."""
        held = chain_forces(self._fingertip, self._seen)
        loads = np.concatenate([held[:, :, None], self._hats], axis=2)
        moves = chain_compliance(self._fingertip, self._seen, loads, _BLUNT)
        predicted, derivative = self._response(self._seen, moves)
        predicted = predicted + self._response.perspective(self._seen)
        # Newton about the last displacement u₀ with C = ∂u/∂f: y = h(u₀) − h(0) + J·C·(f − F(u₀)).
        residual = observed - (predicted - self._at_rest - derivative[:, :, 0])[visible]
        target = (whiten @ residual[:, :, None]).ravel()
        jacobian = (whiten @ derivative[visible, :, 1:]).reshape(len(target), -1)
        likelihood, moment = jacobian.T @ jacobian, jacobian.T @ target
        prior = self._amplitude**2 * self._correlation
        zone = self._best_zone(likelihood, moment, prior)
        block = np.ix_(zone, zone)
        information = likelihood[block] + np.linalg.inv(prior[block])
        mean = np.linalg.solve(information, moment[zone])
        self._amplitude = max(
            self._prior.amplitude, float(abs(self._hats[:, :, zone] @ mean).max())
        )
        found = Posterior(
            information=information,
            moment=moment[zone],
            basis=self._hats[:, :, zone],
            moves=moves[:, :, 1 + zone],
            knots=self._knots[zone[: len(zone) // 2]],
            misfit=float(((target - jacobian[:, zone] @ mean) ** 2).mean()),
        )
        return found, found.moves @ mean - moves[:, :, 0]

    def _best_zone(self, information: Array, moment: Array, prior: Array) -> NDArray[np.intp]:
        """Unknowns of the contact zone with the highest evidence near the last one."""
        knots = self._prior.knots
        evidence: dict[tuple[int, int], float] = {}

        def score(zone: tuple[int, int]) -> float:
            low, high = zone
            if not (low >= 0 and high < knots and high - low >= 2):
                return -np.inf
            if zone not in evidence:
                evidence[zone] = _log_evidence(information, moment, prior, self._unknowns(zone))
            return evidence[zone]

        zone, stride = self._zone, 4
        while stride:
            steps = ((-1, 0), (1, 0), (0, -1), (0, 1), (-1, 1), (1, -1), (1, 1), (-1, -1))
            moved = [(zone[0] + a * stride, zone[1] + b * stride) for a, b in steps]
            best = max(moved, key=score)
            if score(best) > score(zone) + _ZONE_GAIN:
                zone = best
            else:
                stride //= 2
        self._zone = zone
        return self._unknowns(zone)

    def _unknowns(self, zone: tuple[int, int]) -> NDArray[np.intp]:
        span = np.arange(zone[0], zone[1] + 1)
        return np.concatenate([span, self._prior.knots + span])

    def _field(self, found: Posterior) -> ForceField:
        """Mean and covariance of the forces, turned into the object's normal."""
        mean, forces, moves = found.solve()
        return read_contact(self._fingertip, self._seen, found.basis @ mean, forces, moves)


def _log_evidence(information: Array, moment: Array, prior: Array, zone: NDArray[np.intp]) -> float:
    """Log evidence of a zone up to a constant: ½ bᵀ(1 + LᵀGL)⁻¹b − ½ log det(1 + LᵀGL), b = Lᵀm."""
    block = np.ix_(zone, zone)
    root = np.linalg.cholesky(prior[block])
    factor = np.linalg.cholesky(np.eye(len(zone)) + root.T @ information[block] @ root)
    half = np.linalg.solve(factor, root.T @ moment[zone])
    return float(0.5 * half @ half - np.log(np.diag(factor)).sum())
