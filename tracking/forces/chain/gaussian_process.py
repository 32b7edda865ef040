"""Force field from tracks: nodal forces with a Gaussian-process prior, and the chain's stiffness.

The unknowns are forces, not displacements: u = K(u)⁻¹·f is smooth by itself, and sums of f are well
determined while sums of a differentiated u are not. The prior makes f smooth within a zone, whose
extent is chosen by its evidence. Forces are solved for in sensor axes; `contact_reading` resolves
them along the object's normal.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ....model import ForceField, chain_compliance, chain_forces
from ...tracks import Tracks
from ..calibration import SensorCalibration
from ..reconstructors import NoEstimateError
from ..shifts import MarkerShifts
from .contact_reading import ForcePrior, force_basis, read_contact
from .sensitivity import MarkerResponse
from .settings import GaussianProcessSettings

Array = NDArray[np.float64]

#: Smallest number of visible pairs near the contact.
MIN_MARKERS = 20


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """Posterior of the U unknowns of `force_basis` in the contact zone, after a pass.

    Attributes
    ----------
    information: information matrix of the unknowns, including the prior, shape (U, U)
    moment: information times their mean, shape (U,)
    basis: nodal forces per unknown [N], shape (N, 2, U)
    moves: node displacements per unknown [m], shape (N, 2, U)
    knots: angles of the unknowns from the apex, the same along x and z [rad], shape (U/2,)
    misfit: mean squared residual over the noise variance
    """

    information: Array
    moment: Array
    basis: Array
    moves: Array
    knots: Array
    misfit: float

    def solve(self) -> tuple[Array, Array, Array]:
        """Mean of the unknowns (U,); factors (N, 2, U) of the covariance of forces and moves."""
        root = np.linalg.inv(np.linalg.cholesky(self.information)).T
        return root @ (root.T @ self.moment), self.basis @ root, self.moves @ root


@dataclass(frozen=True, kw_only=True)
class Linearisation:
    """Start of a pass: a displacement, and the prior's amplitude and zone.

    Attributes
    ----------
    displacement: displacements of the nodes relative to the rigid part [m], shape (N, 2)
    amplitude: prior standard deviation of a node's force at 251 nodes [N]
    zone: first and last knot of the contact
    """

    displacement: Array
    amplitude: float
    zone: tuple[int, int]


@dataclass(frozen=True, kw_only=True)
class Observation:
    """Shifts of the V visible pairs of a frame, with the matrices that whiten them.

    Attributes
    ----------
    shifts: shifts (x, y, log size) of both layers, shape (V, 6)
    whiten: whitening matrices, shape (V, 6, 6)
    visible: mask of these among all used pairs, shape (P,)
    """

    shifts: Array
    whiten: Array
    visible: NDArray[np.bool_]


class GaussianProcess:
    """Reconstructs the chain's contact forces from the tracks of one sensor.

    Parameters
    ----------
    calibration: calibration of the sensor
    rest: tracks of the unloaded sensor
    prior: prior of the contact forces
    settings: tuned parameters
    """

    def __init__(
        self,
        calibration: SensorCalibration,
        rest: Tracks,
        prior: ForcePrior | None = None,
        settings: GaussianProcessSettings = GaussianProcessSettings(),
    ) -> None:
        self._prior, self._settings = prior or ForcePrior(), settings
        self._fingertip = fingertip = calibration.fingertip
        reach = np.deg2rad(self._prior.reach_deg) + settings.margin
        self._shifts = MarkerShifts(calibration, rest, reach)
        self._response = MarkerResponse(
            self._shifts.sensor, self._shifts.places, fingertip.angles()
        )
        self._hats, self._correlation = force_basis(fingertip, self._prior)
        self._knots = self._prior.knot_angles()
        unloaded = np.zeros((fingertip.nodes, 2))
        at_rest, _ = self._response(unloaded, np.empty((*unloaded.shape, 0)))
        self._at_rest = at_rest + self._response.perspective(unloaded)
        self._coarseness = settings.coarseness**2 * np.diag(np.tile([1.0, 1.0, 0.0], 2))
        middle = self._prior.knots // 2
        self._unloaded = Linearisation(
            displacement=unloaded,
            amplitude=10 * self._prior.amplitude,
            zone=(middle - 4, middle + 4),
        )
        #: Solution of the previous frame; None if it had none.
        self._last: Linearisation | None = None

    def reset(self) -> None:
        """Forget the last frame: the next one is linearised about rest."""
        self._last = None

    def update(self, tracks: Tracks) -> ForceField:
        """Estimate the force field of a frame.

        Raises
        ------
        NoEstimateError
            When fewer than MIN_MARKERS pairs are visible.
        NoEstimateError
            When no solution explains the markers, not even one from rest.
        """
        settings = self._settings
        shifts, visible = self._shifts(tracks, MIN_MARKERS)
        noise = self._shifts.noise(tracks)[visible] + self._coarseness
        observation = Observation(
            shifts=shifts[visible],
            whiten=np.linalg.inv(np.linalg.cholesky(noise)),
            visible=visible,
        )
        heats = settings.heats
        twice = tuple(heat for heat in heats for _ in range(2))
        tries = [
            (self._unloaded, heats, settings.share),
            (self._unloaded, twice, settings.slow_share),
        ]
        if self._last is not None:
            tries.insert(0, (self._last, settings.warm_heats, settings.warm_share))
        self._last = None
        for start, heats, share in tries:
            solution = self._settle(start, observation, heats, share)
            if solution is not None:
                self._last, posterior = solution
                return self._field(self._last.displacement, posterior)
        raise NoEstimateError("no deformation of the fingertip explains the markers")

    def _settle(
        self,
        start: Linearisation,
        observation: Observation,
        heats: tuple[float, ...],
        share: float,
    ) -> tuple[Linearisation, Posterior] | None:
        """Solve in passes with the noise increased by factors `heats`; None if none fits."""
        settings = self._settings
        here = start
        shares = [share] * len(heats) + [0.5 * share] * settings.more
        for heat, part in zip((*heats, *[1.0] * settings.more), shares, strict=True):
            try:
                with np.errstate(invalid="raise"):
                    here, posterior, step = self._pass(here, observation, heat)
            except (FloatingPointError, np.linalg.LinAlgError):
                return None
            here = replace(here, displacement=here.displacement + part * step)
            if not abs(here.displacement).max() < settings.farthest * self._fingertip.radius:
                return None
            moved = abs(part * step).max()
            if heat == 1.0 and moved < settings.settled:
                break
        good = moved < settings.unsettled and posterior.misfit < settings.misfit
        return (here, posterior) if good else None

    def _pass(
        self, here: Linearisation, observation: Observation, heat: float
    ) -> tuple[Linearisation, Posterior, Array]:
        """Choose zone and amplitude by evidence; also return posterior and step to its mean [m]."""
        visible, whiten = observation.visible, observation.whiten / heat
        carried = chain_forces(self._fingertip, here.displacement)
        loads = np.concatenate([carried[:, :, None], self._hats], axis=2)
        moves = chain_compliance(self._fingertip, here.displacement, loads, self._settings.blunt)
        predicted, derivative = self._response(here.displacement, moves)
        predicted = predicted + self._response.perspective(here.displacement)
        # Newton about the last displacement u₀ with C = ∂u/∂f: y = h(u₀) − h(0) + J·C·(f − F(u₀)).
        residual = observation.shifts - (predicted - self._at_rest - derivative[:, :, 0])[visible]
        target = (whiten @ residual[:, :, None]).ravel()
        jacobian = (whiten @ derivative[visible, :, 1:]).reshape(len(target), -1)
        likelihood, moment = jacobian.T @ jacobian, jacobian.T @ target
        prior = here.amplitude**2 * self._correlation
        ends = self._best_zone(here.zone, likelihood, moment, prior)
        zone = self._unknowns(ends)
        block = np.ix_(zone, zone)
        information = likelihood[block] + np.linalg.inv(prior[block])
        mean = np.linalg.solve(information, moment[zone])
        largest = float(abs(self._hats[:, :, zone] @ mean).max())
        posterior = Posterior(
            information=information,
            moment=moment[zone],
            basis=self._hats[:, :, zone],
            moves=moves[:, :, 1 + zone],
            knots=self._knots[zone[: len(zone) // 2]],
            misfit=float(((target - jacobian[:, zone] @ mean) ** 2).mean()),
        )
        here = replace(here, amplitude=max(self._prior.amplitude, largest), zone=ends)
        return here, posterior, posterior.moves @ mean - moves[:, :, 0]

    def _best_zone(
        self, zone: tuple[int, int], information: Array, moment: Array, prior: Array
    ) -> tuple[int, int]:
        """Find the contact zone with the highest evidence near the last one."""
        knots = self._prior.knots
        evidence: dict[tuple[int, int], float] = {}

        def score(zone: tuple[int, int]) -> float:
            low, high = zone
            if not (low >= 0 and high < knots and high - low >= 2):
                return -np.inf
            if zone not in evidence:
                evidence[zone] = _log_evidence(information, moment, prior, self._unknowns(zone))
            return evidence[zone]

        stride = 4
        while stride:
            steps = ((-1, 0), (1, 0), (0, -1), (0, 1), (-1, 1), (1, -1), (1, 1), (-1, -1))
            moved = [(zone[0] + a * stride, zone[1] + b * stride) for a, b in steps]
            best = max(moved, key=score)
            if score(best) > score(zone) + self._settings.zone_gain:
                zone = best
            else:
                stride //= 2
        return zone

    def _unknowns(self, zone: tuple[int, int]) -> NDArray[np.intp]:
        """Indices of a zone's unknowns, along x and then along z."""
        span = np.arange(zone[0], zone[1] + 1)
        return np.concatenate([span, self._prior.knots + span])

    def _field(self, displacement: Array, posterior: Posterior) -> ForceField:
        """Force field of the posterior, resolved along the object's normal."""
        mean, forces, moves = posterior.solve()
        return read_contact(
            self._fingertip, displacement, posterior.basis @ mean, forces, moves,
            self._settings.contact,
        )  # fmt: skip


def _log_evidence(information: Array, moment: Array, prior: Array, zone: NDArray[np.intp]) -> float:
    """Log evidence of a zone up to a constant: ½ bᵀ(1 + LᵀGL)⁻¹b − ½ log det(1 + LᵀGL), b = Lᵀm."""
    block = np.ix_(zone, zone)
    root = np.linalg.cholesky(prior[block])
    factor = np.linalg.cholesky(np.eye(len(zone)) + root.T @ information[block] @ root)
    half = np.linalg.solve(factor, root.T @ moment[zone])
    return float(0.5 * half @ half - np.log(np.diag(factor)).sum())
