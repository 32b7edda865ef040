"""Ensemble Kalman filter of a contact: chains that follow the markers from the first touch on.

Each member is a chain with an object of its own. In every frame it goes from its own state to the
position of rigid part and object that explains the markers best. What the members then leave of the
markers weighs them: the states and constants of all become linear combinations of each other, by a
transform in the space of the ensemble (Bishop, Etherton & Majumdar 2001; Hunt, Kostelich & Szunyogh
2007). So the history of the contact is corrected with the constants, which a search for constants
alone cannot do: an error in the way stays in the friction until everything slides.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from ....errors import UserError
from ....model import Copies, Ensemble, Fingertip, copies_of, place_many, rest_ensemble
from ....render import SensorDesign
from ..dome.key_shifts import Shifts
from .sensitivity import MarkerResponse
from .settings import FilterSettings

Array = NDArray[np.float64]

#: Constants: ln µ, curvature [1/m], logarithms of the object's stiffness and of σ0 [N/m], and
#: exponent of the friction law.
CONSTANTS = ("ln mu", "curvature", "ln stiffness", "ln bristle", "exponent")
#: Motion over which positions are differentiated [m], and unit of a position [m].
_NUDGE, _UNIT = 4e-6, 1e-6
#: Size of a common change of all log sizes of a layer, by focus and blur.
_FOCUS = 5e-3
#: Columns of a pair's shifts that are places [px].
_PLACES = [0, 1, 3, 4]
#: Member whose slopes count for all, by its loss.
_TYPICAL = 0.25
#: Number of misfits that are kept, so that a long contact costs no more in each frame.
_KEPT = 2000


@dataclass(frozen=True, kw_only=True)
class WayFrame:
    """A frame of a way.

    Attributes
    ----------
    dt: time in which the skin moved here [s]
    shifts: shifts of the markers
    weight: weight of the frame; frames in which little moves repeat each other
    motion: root mean square of the motion of places since the picture before [px]
    stirred: the same above that of noise [px]
    """

    dt: float
    shifts: Shifts
    weight: float = 1.0
    motion: float = 0.0
    stirred: float = 0.0


class _Nuisance(NamedTuple):
    """What else moves markers in a frame: focus of both layers, and how far the skin lags behind.

    `whole` are the weights of the whitened values (V·W,), `columns` (V·W, 4) have these weights,
    and `inverse` is the covariance of the four.
    """

    whole: Array
    columns: Array
    inverse: Array

    def left(self, residual: Array) -> Array:
        """Weighted residuals (B, V·W) without what these explain."""
        weighted = residual * self.whole
        return weighted - (weighted @ self.columns @ self.inverse) @ self.columns.T


class WayFilter:
    """Follows a contact from its first touch on.

    Parameters
    ----------
    fingertip, sensor: as calibrated
    places: places of the marker pairs at rest, shape (2, P, 2)
    settings: tuned parameters
    azimuth: azimuth of the load's plane [rad]

    Attributes
    ----------
    constants: constants of each member, shape (B, C)
    ensemble: their states
    misfits: mean squared residual of the members' mean, of each of the last frames
    """

    def __init__(
        self,
        fingertip: Fingertip,
        sensor: SensorDesign,
        places: Array,
        settings: FilterSettings,
        azimuth: float = 0.0,
    ) -> None:
        self.settings, self.azimuth = settings, azimuth
        self._tip = Fingertip.graded(
            settings.nodes,
            radius=fingertip.radius,
            tissue_stiffness=fingertip.tissue_stiffness,
            membrane_stiffness=fingertip.membrane_stiffness,
        )
        self._response = MarkerResponse(sensor, places, self._tip.angles(), azimuth)
        # Nothing, then the whole skin along x and along z: how it lags behind, of 1 px.
        uniform = np.zeros((3, self._tip.nodes, 2))
        uniform[1, :, 0] = uniform[2, :, 1] = 1e-5
        self._rest, *moved = self._response.measured(uniform)
        lag = np.stack(moved) - self._rest
        self._lag = lag / np.sqrt((lag[..., _PLACES] ** 2).mean(axis=(1, 2)))[:, None, None]
        self._focus = np.zeros((2, places.shape[1], 6))
        self._focus[0, :, 2] = self._focus[1, :, 5] = _FOCUS
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        count = self.settings.members
        self.constants = _spread(count, self.settings)
        self.ensemble = rest_ensemble(self._tip, count)
        self.misfits: list[float] = []
        self._speed = np.zeros(2)
        self._random = np.random.default_rng(count)

    def add(self, frame: WayFrame) -> None:
        """Follow the markers of the next frame; its misfit is infinite where no member can."""
        copies = self._copies()
        try:
            nuisance, poses, spread = self._poses(copies, frame)
        except UserError:
            self.misfits.append(math.inf)
            return
        # Members differ by what the markers leave open of their positions, the more the more moves.
        random = self._random.standard_normal(poses.shape)
        random = np.clip((random - random.mean(axis=0)) @ spread.T, *_both(self.settings.unsure))
        poses = poses + random * min(1.0, max(frame.stirred / self.settings.calm, 0.05))
        ensemble, solved = place_many(copies, self.ensemble, poses, frame.dt)
        left = nuisance.left(self._left(frame, ensemble))
        if self.misfits:
            self._speed = np.median(ensemble.pose - self.ensemble.pose, axis=0) / frame.dt
        ensemble, left = self._replace_lost(ensemble, left, solved)
        mean = left.mean(axis=0)
        self.misfits.append(float(mean @ mean) / frame.shifts.count)
        del self.misfits[:-_KEPT]
        self._assimilate(ensemble, left, frame.weight)

    def values(self) -> Array:
        """ΣFn, ΣFf [N], µ and Γ of each member, shape (B, 4)."""
        normal, friction = self._copies().sums(self.ensemble).T
        friction = friction * (np.sign(friction.mean()) or 1.0)
        mu = np.exp(self.constants[:, 0])
        margin = 1.0 - friction / np.maximum(mu * normal, 1e-9)
        return np.stack([normal, friction, mu, margin], axis=1)

    def _copies(self) -> Copies:
        friction, curvature, stiffness, bristle, exponent = self.constants.T
        return copies_of(
            self._tip,
            friction=np.exp(friction),
            curvature=curvature,
            stiffness=np.exp(stiffness),
            dahl_stiffness=np.exp(bristle),
            dahl_exponent=exponent,
        )

    def _left(self, frame: WayFrame, ensemble: Ensemble) -> Array:
        """What members leave of the whitened shifts, shape (B, V·W)."""
        seen = ensemble.nodes.copy()
        seen[:, :, 1] -= ensemble.pose[:, :1]
        with np.errstate(divide="ignore"):  # a disc seen from its edge has no area
            shifts = self._response.measured(seen) - self._rest
        left = frame.shifts.residual(shifts)
        return np.where(np.isfinite(left), left, 10.0)

    def _expected(self, copies: Copies, frame: WayFrame) -> tuple[Array, Array]:
        """Positions that are expected in a frame (B, 2), and their standard deviations (2,) [m]."""
        settings = self.settings
        if self.misfits:
            ahead = settings.inertia * self._speed * frame.dt
            deviation = np.array(settings.still_move) + 0.5 * abs(self._speed) * frame.dt
            deviation = deviation + settings.move * frame.stirred
            ahead = np.clip(ahead, *_both(settings.ahead))
            return self.ensemble.pose + ahead, np.minimum(deviation, settings.first_move)
        best = np.full(len(self.constants), math.inf)
        poses = np.zeros((len(best), 2))
        for depth in settings.depths:
            tried = np.tile([depth, 0.0], (len(best), 1))
            ensemble, solved = place_many(copies, self.ensemble, tried, frame.dt)
            left = self._left(frame, ensemble)
            loss = np.where(solved, [frame.shifts.loss(one) for one in left], math.inf)
            poses[loss < best] = [depth, 0.0]
            best = np.minimum(best, loss)
        return poses, np.array(settings.first_move)

    def _poses(self, copies: Copies, frame: WayFrame) -> tuple[_Nuisance, Array, Array]:
        """Positions of the members by Gauss-Newton, each with a search along its step.

        Returns
        -------
        nuisance: what else moves markers
        poses: [m], shape (B, 2)
        spread: root of the covariance of what the markers leave open [m], shape (2, 2)
        """
        settings = self.settings
        expected, deviation = self._expected(copies, frame)
        poses, best, kept = expected, expected.copy(), np.full(len(expected), math.inf)
        step, residuals, nuisance = np.zeros_like(best), np.empty(0), None
        spread: Array = np.eye(2)
        rounds = settings.rounds if self.misfits else settings.first_rounds
        for k in range(rounds):
            ensemble, solved = place_many(copies, self.ensemble, poses, frame.dt)
            left = self._left(frame, ensemble)
            if nuisance is None:
                raw = np.where(solved, np.einsum("bv,bv->b", left, left), math.inf)
                nuisance, residuals = self._nuisance(frame, left[_typical(raw)]), left.copy()
            shown = nuisance.left(left)
            loss = np.einsum("bv,bv->b", shown, shown)
            loss = loss + (((poses - expected) / deviation) ** 2).sum(axis=1)
            better = solved & (loss < kept)
            best[better], residuals[better] = poses[better], left[better]
            kept = np.where(better, loss, kept)
            if not np.isfinite(kept).any():
                raise UserError("no chain follows the markers")
            if k == rounds - 1:
                break
            if k % 2 == 0:
                typical = _typical(kept)
                by_pose = self._by_pose(copies, frame, best[typical], residuals[typical], typical)
                columns = np.concatenate(
                    [by_pose * nuisance.whole[:, None], nuisance.columns], axis=1
                )
                prior = np.append((_UNIT / deviation) ** 2, np.ones(4))
                inverse = _inverse(columns, prior)
                spread = _UNIT * np.asarray(np.linalg.cholesky(inverse[:2, :2]))
            gradient = (residuals * nuisance.whole) @ columns
            gradient[:, :2] += prior[:2] * (expected - best) / _UNIT
            newton = _UNIT * (gradient @ inverse)[:, :2]
            newton = np.clip(newton, *_both(settings.longest_move))
            step = np.where(better[:, None], newton, 0.4 * step)
            if np.median(abs(step).max(axis=1)) < settings.settled:
                break
            poses = best + step
        assert nuisance is not None
        return nuisance, best, spread

    def _nuisance(self, frame: WayFrame, residual: Array) -> _Nuisance:
        """What else moves markers, with the weights of a residual (V·W,)."""
        shifts = frame.shifts
        lag = self.settings.lag * frame.motion * self._lag
        whole = np.sqrt(shifts.weights(residual))
        columns = shifts.apply(np.concatenate([self._focus, lag])[:, shifts.used]).T
        columns = columns * whole[:, None]
        return _Nuisance(whole, columns, _inverse(columns, np.ones(4)))

    def _by_pose(
        self, copies: Copies, frame: WayFrame, pose: Array, residual: Array, member: int
    ) -> Array:
        """Derivatives of the whitened shifts by the position of a member [1/µm], (V·W, 2)."""
        rows = [member, member]
        poses = pose + _NUDGE * np.eye(2)
        moved, _ = place_many(copies.take(rows), self.ensemble.take(rows), poses, frame.dt)
        return (residual - self._left(frame, moved)).T * (_UNIT / _NUDGE)

    def _replace_lost(
        self, ensemble: Ensemble, left: Array, solved: NDArray[np.bool_]
    ) -> tuple[Ensemble, Array]:
        """Replace members that explain the markers far worse than most by copies of others."""
        loss = np.einsum("bv,bv->b", left, left)
        limit = self.settings.lost * max(float(np.median(loss)), left.shape[1] / 3.0)
        good = solved & (loss < limit)
        if good.all() or not good.any():
            return ensemble, left
        rows = np.arange(len(left))
        rows[~good] = self._random.choice(rows[good], int((~good).sum()))
        self.constants = self.constants[rows]
        return ensemble.take(rows.tolist()), left[rows]

    def _assimilate(self, ensemble: Ensemble, left: Array, weight: float) -> None:
        """Combine the members so that they explain what the markers show.

        No direction loses more than a share of its variance in a frame, and the mean moves by no
        more than some standard deviations: slopes hold nearby only.
        """
        settings, count = self.settings, len(left)
        mean = left.mean(axis=0)
        # Where they explain less than before, the members have become too sure of themselves.
        usual = max(settings.usual_misfit, float(np.median(self.misfits)))
        excess = max(self.misfits[-1] / usual - 1.0, 0.0)
        wider = 1.0 + min(settings.widened * excess, settings.widest)
        apart = wider * (left - mean)
        values, vectors = np.linalg.eigh(apart @ apart.T)
        values, off = np.maximum(values, 0.0), vectors.T @ (apart @ mean)
        told = max(weight, settings.least) / settings.inflation
        told = min(told, settings.steepest * (count - 1) / max(float(values.max()), 1e-12))
        while True:
            total = told * values + count - 1
            move = -told * off / total
            if (count - 1) * float(move @ move) <= settings.longest**2:
                break
            told *= 0.7
        root = (vectors * np.sqrt((count - 1) / total)) @ vectors.T
        root = (1.0 - settings.relaxed) * root + settings.relaxed * np.eye(count)
        combine = ((vectors @ move)[:, None] + root).T

        def combined(values: Array) -> Array:
            middle = values.mean(axis=0)
            rest = wider * (values - middle).reshape(count, -1)
            return middle + (combine @ rest).reshape(values.shape)

        self.ensemble = ensemble.each(combined)
        constants, least = combined(self.constants), np.array(settings.least_spread)
        lacking = np.sqrt(np.maximum(least**2 - constants.var(axis=0), 0.0))
        constants = constants + lacking * self._random.standard_normal(constants.shape)
        self.constants = np.clip(constants, settings.low, settings.high)


def _typical(loss: Array) -> int:
    """Index of a member that is better than most."""
    return int(np.argsort(loss)[int(_TYPICAL * np.isfinite(loss).sum())])


def _inverse(columns: Array, prior: Array) -> Array:
    """Covariance of the unknowns of columns (V·W, K) with a prior information (K,), (K, K)."""
    return np.asarray(np.linalg.inv(columns.T @ columns + np.diag(prior)))


def _both(limit: float | Array) -> tuple[float | Array, float | Array]:
    return -limit, limit


def _spread(count: int, settings: FilterSettings) -> Array:
    """Constants before any frame, spread evenly over what is possible, shape (B, C).

    The points are multiples of powers of a generalised golden ratio (Roberts 2018).
    """
    dimensions = len(CONSTANTS)
    ratio = 2.0
    for _ in range(30):
        ratio = (1.0 + ratio) ** (1.0 / (dimensions + 1))
    steps = ratio ** -np.arange(1.0, dimensions + 1)
    even = (0.5 + np.outer(np.arange(count), steps)) % 1.0
    flat = np.array(settings.first_low) + even * np.subtract(
        settings.first_high, settings.first_low
    )
    round_ = np.array(settings.middle) + ndtri(np.clip(even, 0.02, 0.98)) * settings.deviation
    constants = np.where(np.array(settings.deviation) > 0.0, round_, flat)
    return np.clip(constants, settings.low, settings.high)
