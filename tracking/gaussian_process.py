"""Force field from tracks: nodal forces with a smoothness prior, through the chain's own stiffness.

The unknowns are forces, not displacements: u = K(u)⁻¹·f is smooth by itself, and sums of f are well
determined where sums of a differentiated u are not. A Gaussian-process prior on f in a compact
zone, whose extent is chosen by its evidence, does the regularising. Solved in sensor axes; the
result is rotated into the contact's own normal, read off the deformed skin.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from ..model import ForceField, chain_compliance, chain_forces
from .calibration import SensorCalibration
from .sensitivity import MarkerResponse
from .shifts import MarkerShifts, NoEstimateError
from .tracks import Tracks

Array = NDArray[np.float64]

#: Fewer visible pairs than this near the contact say too little about it.
MIN_MARKERS = 20
#: Markers further than this outside the prior's reach do not feel the contact [rad].
_MARGIN = np.deg2rad(20.0)
#: No node moves by more than this share of the radius.
_FARTHEST = 0.5
#: Slope of the skin below which the jump in its stiffness is smoothed, so that Newton settles …
_BLUNT = 0.05
#: … and share of a Newton step that is taken.
_DAMPING = 0.8
#: Log evidence that a zone must win by: a tie must not make the estimate flicker.
_ZONE_GAIN = 1.0


class DivergedEstimateError(NoEstimateError):
    """No deformation of the chain explains the markers; the next frame starts from rest."""


@dataclass(frozen=True, kw_only=True)
class ForcePrior:
    """What is assumed of contact forces before the first pixel, the same for every object.

    Attributes
    ----------
    reach_deg: forces are looked for up to this angle from the apex [°]
    knots: places along that arc where forces are free, linear in between
    length: correlation length of the forces along the skin [m]
    amplitude: smallest prior standard deviation of a node's force at 251 nodes [N]
    """

    reach_deg: float = 38.0
    knots: int = 31
    length: float = 0.8e-3
    amplitude: float = 5e-3


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
        self._threshold = fingertip.contact_threshold
        reach = np.deg2rad(self._prior.reach_deg) + _MARGIN
        self._shifts = MarkerShifts(calibration, rest, reach)
        self._response = MarkerResponse(calibration.sensor, self._shifts.places, fingertip.angles())
        self._hats, self._correlation = self._force_basis()
        unloaded = np.zeros((fingertip.nodes, 2))
        at_rest, _ = self._response(unloaded, np.empty((*unloaded.shape, 0)))
        self._at_rest = at_rest + self._response.perspective(unloaded)
        self.reset()

    def reset(self) -> None:
        """Forget the last frame: the next one is linearised about rest."""
        self._seen = np.zeros((self._fingertip.nodes, 2))
        self._amplitude = 10 * self._prior.amplitude
        middle = self._prior.knots // 2
        self._zone = (middle - 4, middle + 4)

    def update(self, tracks: Tracks) -> ForceField:
        """Force field of a frame.

        Raises
        ------
        TooFewMarkersError
            When fewer than MIN_MARKERS pairs are visible.
        DivergedEstimateError
            When the solution runs away.
        """
        shifts, visible = self._shifts(tracks, MIN_MARKERS)
        observed = shifts[visible]
        whiten = np.linalg.inv(np.linalg.cholesky(self._shifts.noise(tracks)[visible]))
        # The angles follow from the last displacement; a second pass only after a large change.
        for _ in range(2):
            before = self._seen
            try:
                with np.errstate(invalid="raise"):
                    forces, covariance = self._solve(observed, whiten, visible)
            except (FloatingPointError, np.linalg.LinAlgError):
                self._seen = np.full_like(before, np.inf)
            if not abs(self._seen).max() < _FARTHEST * self._fingertip.radius:
                self.reset()
                raise DivergedEstimateError("no deformation of the fingertip explains the markers")
            if abs(self._seen - before).max() < 20e-6:
                break
        return self._field(forces, covariance)

    def _solve(
        self, observed: Array, whiten: Array, visible: NDArray[np.bool_]
    ) -> tuple[Array, Array]:
        """Nodal forces (N, 2) [N] and covariance of (ΣFx, ΣFz); moves the linearisation point."""
        held = chain_forces(self._fingertip, self._seen)
        loads = np.concatenate([held[:, :, None], self._hats], axis=2)
        moves = chain_compliance(self._fingertip, self._seen, loads, _BLUNT)
        predicted, derivative = self._response(self._seen, moves)
        predicted = predicted + self._response.perspective(self._seen)
        # Newton about the last displacement u₀ with C = ∂u/∂f: y = h(u₀) − h(0) + J·C·(f − F(u₀)).
        residual = observed - (predicted - self._at_rest - derivative[:, :, 0])[visible]
        target = (whiten @ residual[:, :, None]).ravel()
        jacobian = (whiten @ derivative[visible, :, 1:]).reshape(len(target), -1)
        information, moment = jacobian.T @ jacobian, jacobian.T @ target
        prior = self._amplitude**2 * self._correlation
        zone = self._best_zone(information, moment, prior)
        block = np.ix_(zone, zone)
        factor = cho_factor(information[block] + np.linalg.inv(prior[block]))
        mean = cho_solve(factor, moment[zone])
        hats = self._hats[:, :, zone]
        forces = hats @ mean
        change = moves[:, :, 1 + zone] @ mean - moves[:, :, 0]
        self._seen = self._seen + _DAMPING * change
        self._amplitude = max(self._prior.amplitude, float(abs(forces).max()))
        sums = hats.sum(axis=0)
        return forces, sums @ cho_solve(factor, sums.T)

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

    def _field(self, forces: Array, covariance: Array) -> ForceField:
        """Rotate sensor-axis forces into the contact's normal and tangent."""
        position = self._fingertip.rest_positions() + self._seen
        pressing = -forces[:, 1]
        slope = _surface_slope(position, np.maximum(pressing, 0.0))
        length = np.sqrt(1.0 + slope**2)
        normal = (slope * forces[:, 0] - forces[:, 1]) / length
        friction = (forces[:, 0] + slope * forces[:, 1]) / length
        contact = normal > self._threshold
        flip = np.array([1, 0])  # (x, z) of the sensor are (friction, normal) of the field
        return ForceField(
            position=position,
            normal=np.maximum(normal, 0.0),
            friction=friction,
            contact=contact,
            totals_covariance=covariance[np.ix_(flip, flip)],
        )

    def _force_basis(self) -> tuple[Array, Array]:
        """Nodal forces per unit unknown (N, 2, 2·knots) and the unknowns' prior correlation."""
        prior, tip = self._prior, self._fingertip
        reach = np.deg2rad(prior.reach_deg)
        knots = np.linspace(-reach, reach, prior.knots)
        angles = tip.angles()
        hats = np.stack([np.interp(angles, knots, row) for row in np.eye(prior.knots)], axis=1)
        hats[np.abs(angles) > reach] = 0.0
        # Unknowns are node forces at 251 nodes; finer chains share them among more nodes.
        hats *= tip.shares()[:, None]
        basis = np.zeros((tip.nodes, 2, 2 * prior.knots))
        basis[:, 0, : prior.knots] = hats
        basis[:, 1, prior.knots :] = hats
        distance = (knots[:, None] - knots) * tip.radius / prior.length
        smooth = np.exp(-0.5 * distance**2) + 1e-6 * np.eye(prior.knots)
        correlation = np.kron(np.eye(2), smooth).astype(np.float64)
        return basis, correlation


def _log_evidence(information: Array, moment: Array, prior: Array, zone: NDArray[np.intp]) -> float:
    """Log evidence of a zone up to a constant: ½ bᵀ(1 + LᵀGL)⁻¹b − ½ log det(1 + LᵀGL), b = Lᵀm."""
    block = np.ix_(zone, zone)
    root = np.linalg.cholesky(prior[block])
    factor = np.linalg.cholesky(np.eye(len(zone)) + root.T @ information[block] @ root)
    half = np.linalg.solve(factor, root.T @ moment[zone])
    return float(0.5 * half @ half - np.log(np.diag(factor)).sum())


def _surface_slope(position: Array, weight: Array) -> Array:
    """Slope dz/dx of a parabola through the loaded skin, at every node, shape (N,)."""
    if not (weight > 0).sum() >= 3:
        return np.zeros(len(position))
    x, z = position.T
    centre = np.average(x, weights=weight)
    _, slope, bend = np.polynomial.polynomial.polyfit(x - centre, z, 2, w=np.sqrt(weight))
    return np.where(weight > 0, slope + 2 * bend * (x - centre), 0.0)
