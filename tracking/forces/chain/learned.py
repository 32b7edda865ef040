"""The reconstructors that read forces with a trained read-out: of a frame alone, and over time."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ....errors import UserError
from ....model import ForceField, FrictionReading
from ....render import SensorDesign
from ...tracks import Tracks
from ..calibration import SensorCalibration
from ..friction import OBSERVABLE_MARGIN
from ..shifts import MarkerShifts, NoEstimateError
from .readout import BEND, forward, limited, load_readout, slope
from .sensitivity import MEASURED, MarkerResponse

Array = NDArray[np.float64]

#: Fewer visible pairs than this do not determine the codes.
MIN_PAIRS = 60
#: A pair this far from what the others say is not where its track is (χ² of 6). It draws the others
#: with it: those that are off by less than this share of the worst are judged without it.
_STRAY, _NEAR_WORST = 50.0, 0.25
#: A pair that lies on another one may be either; it is read this near to what the others say. On
#: folded skin the right one is up to 170 off, the wrong one 50 000.
_LIKELY = 1000.0
#: Standard deviation of a change of all log sizes of a layer, as focus and blur make it.
_FOCUS = 0.01
#: Where pairs fit no trained press better than this, they are not read (χ² per measurement).
_UNLIKE = 9.0
#: Directions of codes that are noisier than most by more than this widen the interval (variance).
_NOISIER = 2.0
#: ΣFn is not known where its deviation is more than this share of it, and this much more [N].
_VAGUE_SHARE, _VAGUE = 0.4, 0.1
#: Weights follow the noise when it has changed by more than this share; those of single pairs when
#: the variance of a size has grown so many times.
_NOISE_CHANGE, _VAGUER = 0.25, 4.0
_SIZES = [2, 5]
#: µ is seen where its deviation is less than this share of what it is before any image.
_OBSERVABLE = 0.4
#: No ΣFn is read above 30 N, nor µ below this.
_LARGEST, _SMALLEST_FRICTION = 5.0, 0.05
#: Snapshots whose markers are found at a time.
_AT_ONCE = 20
#: Less than this is no contact [N].
_NOTHING = 0.01


class Weights(NamedTuple):
    """How P pairs tell of C codes and sizes' changes, in units of their noise.

    Attributes
    ----------
    whiten: of each pair's shifts, shape (P, 6, 6)
    rows: what each shift then shows of the codes, shape (6P, C)
    information: of all pairs and of what is known before any image, shape (C, C)
    """

    whiten: Array
    rows: Array
    information: Array


class Learned:
    """Reads ΣFn, ΣFf and µ of each frame by itself.

    Parameters
    ----------
    calibration: of the sensor, with a read-out
    rest: tracks of the unloaded sensor
    """

    def __init__(self, calibration: SensorCalibration, rest: Tracks) -> None:
        if calibration.readout is None:
            raise UserError(
                "this sensor has no trained read-out: train one with `chromagrip train`, or choose "
                "a reconstructor that needs none"
            )
        tip = self._fingertip = calibration.fingertip
        read = self._readout = load_readout(calibration.readout)
        nodes = read.modes.shape[1]
        if tip.law != "split" or tip.nodes != nodes:
            raise UserError(
                f"{calibration.readout.name} was trained on a split chain of {nodes} nodes, the "
                f"calibration has a {tip.law} one of {tip.nodes}"
            )
        #: Forces are those of the fingertip trained on, stiffer or softer in all its springs.
        self._stiffer = tip.tissue_stiffness / read.tissue_stiffness
        self._shifts = MarkerShifts(calibration, rest, np.pi)
        self._means, self._loadings, self._unexplained = self._of_this_specimen()
        count = len(read.codes)
        codes = np.column_stack([read.codes, np.ones(count)])
        self._moves = np.linalg.lstsq(codes, read.snapshots, rcond=None)[0]
        #: Of the weights, which are made with the first frame.
        self._noise = np.nan
        self.reset()

    def reset(self) -> None:
        """Nothing is kept from frame to frame but weights, which follow the noise."""

    def update(self, tracks: Tracks) -> ForceField:
        """Force field of a frame.

        Raises
        ------
        NoEstimateError
            When fewer than MIN_PAIRS pairs are visible.
        NoEstimateError
            When no press that was trained explains them, or many do.
        """
        codes, covariance = self._encode(tracks)
        return self._read(codes, self._variance, covariance)

    def _of_this_specimen(self) -> tuple[Array, Array, Array]:
        """Mean (6P,) and loadings (6P, K) of the shifts, and variances they leave (P, 6).

        Those of the design's pairs, and what the snapshots say of the difference.
        """
        read, skin = self._readout, self._readout.design.shape
        nearest = KDTree(skin.points(read.design.places, 0.0)).query(
            skin.points(self._shifts.places[0], 0.0)
        )[1]
        design = np.stack([read.design.places[nearest]] * 2)
        chain = np.einsum("sp,pnk->snk", read.snapshots, read.modes)
        here = self._shown(self._shifts.sensor, self._shifts.places, chain)
        change = here - self._shown(read.design, design, chain)
        codes = np.column_stack([read.codes, np.ones(len(chain))])
        found = np.linalg.lstsq(codes, change, rcond=None)[0]
        missed = ((change - codes @ found) ** 2).sum(axis=0) / (len(codes) - codes.shape[1])

        def own(values: Array) -> Array:
            return values.reshape(*values.shape[:-1], -1, MEASURED)[..., nearest, :]

        unit = own(read.noise)
        mean = (unit * own(read.mean)).ravel() + found[-1]
        rows = (unit * own(read.rows)).reshape(len(read.rows), -1) + found[:-1]
        left = unit**2 * own(read.left) + missed.reshape(-1, MEASURED)
        return mean, np.ascontiguousarray(rows.T), left

    def _shown(self, sensor: SensorDesign, places: Array, chain: Array) -> Array:
        """Shifts of pairs at places (2, P, 2) for each of some chains (S, N, 2), shape (S, 6P)."""
        response = MarkerResponse(sensor, places, self._fingertip.angles())
        resting = response.measured(np.zeros_like(chain[0]))
        # A few at a time: many would take as much memory as all the rest.
        parts = [
            response.measured(chain[k : k + _AT_ONCE]) - resting
            for k in range(0, len(chain), _AT_ONCE)
        ]
        return limited(np.concatenate(parts).reshape(len(chain), -1))

    def _weigh(self, tracks: Tracks) -> None:
        """Weights of the pairs, from the noise of this frame; kept while that stays as it is."""
        seen = tracks.visible[:, self._shifts.pairs].all(axis=0)
        noise = float(np.median(tracks.covariance[self._shifts.pairs[seen], 0, 0]))
        if abs(noise - self._noise) < _NOISE_CHANGE * self._noise:
            return
        self._noise = noise
        frame = tracks.covariance[self._shifts.pairs]
        # Who is not seen now may be seen later.
        frame[~seen] = np.median(frame[seen], axis=0)
        # What is the same in every frame: errors of the rest frame and of the calibration.
        still = self._shifts.rest_covariance + np.diag(self._shifts.floor)
        still = still + self._unexplained[:, :, None] * np.eye(MEASURED)
        self._covariance, self._still_covariance = frame, still
        whiten = np.linalg.inv(np.linalg.cholesky(frame + still))
        pairs, codes = len(whiten), self._loadings.shape[1]
        loadings = self._loadings.reshape(pairs, MEASURED, codes)
        # A change of all sizes is the camera's, not a press.
        focus = np.broadcast_to(np.eye(MEASURED)[:, 2::3], (pairs, MEASURED, 2))
        self._shows = np.concatenate([loadings, focus], axis=2)
        rows = (whiten @ self._shows).reshape(pairs * MEASURED, -1)
        # With what is known of the codes before any image: who sees nothing of a code lets it be.
        strength = np.append(np.square(self._readout.scale) - 1.0, [_FOCUS**2] * 2)
        self._weights = Weights(whiten, rows, rows.T @ rows + np.diag(1.0 / strength))
        #: Pairs that tell less of sizes than these weights have it, their variances, and weights.
        self._vague = np.zeros(pairs, dtype=bool), np.empty((0, MEASURED)), self._weights
        #: Weights and pairs seen, and the covariance of the codes that goes with them.
        self._solved: tuple[Weights, NDArray[np.bool_], Array] = (
            self._weights, np.zeros(pairs, dtype=bool), np.empty((0, 0)),
        )  # fmt: skip
        drawn = np.asarray(np.linalg.inv(self._weights.information))
        # The read-out was trained on codes with noise, not on codes drawn towards their mean.
        self._undrawn = 1.0 / (1.0 - np.diag(drawn) / strength)
        self._undrawn[codes:] = 1.0
        self._drawn_covariance = drawn
        self._variance = (self._undrawn * np.diag(drawn))[:codes]
        self._operator = self._undrawn[:, None] * (drawn @ rows.T)
        # Where markers were missing at rest, some directions are noisier than all were in training.
        typical = float(np.median(self._variance))
        raised = (self._undrawn[:, None] * drawn * self._undrawn)[:codes, :codes]
        sizes, directions = np.linalg.eigh(raised)
        excess = np.where(sizes > _NOISIER * typical, sizes - typical, 0.0)
        self._excess = (directions * excess) @ directions.T
        shaken = whiten @ still @ np.swapaxes(whiten, 1, 2)
        operator = self._operator[:codes].reshape(codes, pairs, MEASURED)
        self._still = np.einsum("kpi,pij,kpj->k", operator, shaken, operator, optimize=True)

    def _encode(self, tracks: Tracks) -> tuple[Array, Array]:
        """Codes (K,), and what their covariance is more than in training (K, K)."""
        shifts, seen = self._shifts(tracks, MIN_PAIRS)
        self._weigh(tracks)
        there = np.asarray(tracks.visible[:, self._shifts.pairs].all(axis=0))
        centred = (limited(shifts.ravel()) - self._means).reshape(-1, MEASURED)
        centred[~there] = 0.0
        weights = self._weights_of(tracks, there)
        white = np.einsum("pij,pj->pi", weights.whiten, centred)
        asked = there & ~seen
        seen, codes, drawn = self._at_one(weights, white, seen)
        if asked.any():
            seen = self._likely(weights, white, (codes, drawn), seen, asked, _LIKELY)
            seen, codes, drawn = self._at_one(weights, white, seen)
        count = len(self._readout.scale)
        freedom = MEASURED * seen.sum() - count
        misfit = float(_badness(weights, white, codes)[seen].sum() / freedom)
        if misfit > _UNLIKE:
            raise NoEstimateError(
                f"the markers move as no trained press moves them: χ² is {misfit:.0f} a "
                f"measurement, {_UNLIKE:g} at most is allowed"
            )
        more = self._undrawn[:, None] * (drawn - self._drawn_covariance) * self._undrawn
        return codes[:count], more[:count, :count] + self._excess

    def _weights_of(self, tracks: Tracks, there: NDArray[np.bool_]) -> Weights:
        """Those of a frame: sizes of pairs that touch others now tell less than they did."""
        covariance = tracks.covariance[self._shifts.pairs]
        size, before = (c[:, _SIZES, _SIZES] for c in (covariance, self._covariance))
        vaguer = there & (size > _VAGUER * before).any(axis=1)
        if not vaguer.any():
            return self._weights
        known, noise, weights = self._vague
        diagonal = covariance[vaguer].diagonal(axis1=1, axis2=2)
        if (vaguer == known).all() and (abs(diagonal - noise) < _NOISE_CHANGE * noise).all():
            return weights
        whiten, rows, information = self._weights
        whiten, rows = whiten.copy(), rows.reshape(len(there), MEASURED, -1).copy()
        sure = rows[vaguer].reshape(-1, rows.shape[-1])
        total = covariance[vaguer] + self._still_covariance[vaguer]
        whiten[vaguer] = np.linalg.inv(np.linalg.cholesky(total))
        rows[vaguer] = whiten[vaguer] @ self._shows[vaguer]
        vague = rows[vaguer].reshape(sure.shape)
        weights = Weights(
            whiten,
            rows.reshape(self._weights.rows.shape),
            information - sure.T @ sure + vague.T @ vague,
        )
        self._vague = vaguer, diagonal, weights
        return weights

    def _at_one(
        self, weights: Weights, white: Array, seen: NDArray[np.bool_]
    ) -> tuple[NDArray[np.bool_], Array, Array]:
        """Seen pairs without those that stray from the others, and what `_solve` says of them."""
        left = seen
        while True:
            codes, drawn = self._solve(weights, white, left)
            badness = _badness(weights, white, codes)
            limit = _STRAY * max(1.0, float(np.median(badness[left])) / MEASURED)
            stray = left & (badness > max(limit, _NEAR_WORST * badness[left].max()))
            if not stray.any():
                break
            left = left & ~stray
        # Who was only drawn along comes back.
        whole = self._likely(weights, white, (codes, drawn), left, seen & ~left, limit)
        if (whole & ~left).any():
            codes, drawn = self._solve(weights, white, whole)
        return whole, codes, drawn

    def _likely(
        self,
        weights: Weights,
        white: Array,
        solved: tuple[Array, Array],
        certain: NDArray[np.bool_],
        asked: NDArray[np.bool_],
        limit: float,
    ) -> NDArray[np.bool_]:
        """Certain pairs, which were solved for, and those asked for of χ² by them below a limit."""
        codes, drawn = solved
        taken = certain.copy()
        for pair in np.flatnonzero(asked):
            moves = weights.rows[MEASURED * pair : MEASURED * (pair + 1)]
            off = white[pair] - moves @ (codes / self._undrawn)
            spread = np.eye(MEASURED) + moves @ drawn @ moves.T
            taken[pair] = off @ np.linalg.solve(spread, off) < limit
        return taken

    def _solve(
        self, weights: Weights, white: Array, seen: NDArray[np.bool_]
    ) -> tuple[Array, Array]:
        """Codes and sizes' changes from the pairs seen, and their covariance as it is drawn."""
        if weights is self._weights and seen.all():
            return self._operator @ white.ravel(), self._drawn_covariance
        kept = white * seen[:, None]
        before, those, drawn = self._solved
        if weights is not before or (seen != those).any():
            lost = weights.rows.reshape(*white.shape, -1)[~seen].reshape(-1, weights.rows.shape[1])
            drawn = np.asarray(np.linalg.inv(weights.information - lost.T @ lost))
            self._solved = weights, seen.copy(), drawn
        return self._undrawn * (drawn @ (weights.rows.T @ kept.ravel())), drawn

    def _read(self, codes: Array, variance: Array, more: Array) -> ForceField:
        """Force field of codes with noise of these variances, and more of it in some directions."""
        read = self._readout
        # Noise matters in the weak codes, which are the last.
        noise = 0.5 * np.log(variance[len(codes) // 2 :]).mean()
        x = np.append(codes / read.scale, noise)
        totals = np.append(x, 1.0) @ read.linear + forward(read.totals, x)
        deviations = np.exp(0.5 * forward(read.deviations, x))
        covariance = np.outer(deviations, deviations) * read.correlation
        steep = (read.linear[: len(codes)].T + slope(read.totals, x)[:, :-1]) / read.scale
        covariance += steep @ more @ steep.T
        # No image tells less of µ than none does.
        told = np.array([1.0, 1.0, 1.0 / np.hypot(1.0, np.sqrt(covariance[2, 2]) / read.prior)])
        covariance *= np.outer(told, told)
        normal, friction = BEND * np.sinh(np.clip(totals[0], -_LARGEST, _LARGEST)), totals[1]
        mu = max(totals[2], _SMALLEST_FRICTION)
        # To newtons, and to |ΣFf|.
        side = 1.0 if friction >= 0.0 else -1.0
        unit = np.array([self._stiffer * np.hypot(normal, BEND), self._stiffer * side, 1.0])
        covariance *= np.outer(unit, unit)
        deviation = float(np.sqrt(covariance[0, 0]))
        if deviation > _VAGUE_SHARE * abs(normal) + _VAGUE:
            raise NoEstimateError(
                f"the markers leave ΣFn open: {normal:.1f} N with a deviation of {deviation:.1f} N"
            )
        return self._field(
            codes, x, self._stiffer * normal, self._stiffer * friction, float(mu), covariance
        )

    def _field(
        self, codes: Array, x: Array, normal: float, friction: float, mu: float, covariance: Array
    ) -> ForceField:
        read, tip = self._readout, self._fingertip
        seen = np.einsum("p,pnk->nk", np.append(codes, 1.0) @ self._moves, read.modes)
        shapes = forward(read.shapes, x)
        half = len(shapes) // 2
        press = np.append(1.0, shapes[:half]) @ read.normal_shapes
        drag = np.append(1.0, shapes[half:]) @ read.friction_shapes
        press = np.maximum(press, 0.0)
        pressing = normal * press / press.sum() if normal > _NOTHING else np.zeros(tip.nodes)
        contact = pressing > tip.contact_threshold
        if contact.any():
            pressing *= contact * (normal / pressing[contact].sum())
            dragging = normal * drag * contact
            # Sums are read better than shapes are.
            dragging += (friction - dragging.sum()) * pressing / normal
        else:
            dragging = np.zeros(tip.nodes)
        deviation = float(np.sqrt(covariance[2, 2]))
        # A press alone says little of µ, and that only by the law of friction trained with.
        slips = contact.any() and 1.0 - abs(friction) / (mu * normal) < OBSERVABLE_MARGIN
        return ForceField(
            position=tip.rest_positions() + seen,
            normal=pressing,
            friction=dragging,
            contact=contact,
            totals_covariance=covariance[:2, :2],
            friction_reading=FrictionReading(
                value=mu,
                deviation=deviation,
                observable=bool(slips and deviation < _OBSERVABLE * read.prior),
                totals_covariance=(float(covariance[0, 2]), float(covariance[1, 2])),
            ),
        )


def _badness(weights: Weights, white: Array, codes: Array) -> Array:
    """χ² of each pair that codes and sizes' changes leave, shape (P,)."""
    left = white - (weights.rows @ codes).reshape(white.shape)
    return np.asarray((left**2).sum(axis=1))


#: Activities of the skin that are weighed against each other: variance of a code's change over a
#: frame, in units of its usual variance.
_ACTIVITIES = np.concatenate([[0.0], np.logspace(-9.0, 0.0, 19)])


class Sequential(Learned):
    """Reads codes that are averaged over the frames for as long as the skin holds still.

    A Kalman filter of each code: how much the codes change from frame to frame is found in the
    change itself, from the codes that noise hardly reaches; the others are averaged accordingly.
    """

    def reset(self) -> None:
        """Forget the frames before."""
        super().reset()
        self._codes: Array | None = None

    def update(self, tracks: Tracks) -> ForceField:
        """Force field at the time of a frame, from it and those before; errors as in `Learned`."""
        try:
            codes, more = self._encode(tracks)
        except NoEstimateError:
            self.reset()
            raise
        noise = self._variance - self._still
        if self._codes is None:
            self._codes, self._known = codes, noise
        else:
            change, rates = codes - self._codes, self._readout.rates
            expected = self._known + noise + np.outer(_ACTIVITIES, rates)
            likelihood = (change**2 / expected + np.log(expected)).sum(axis=1)
            before = self._known + _ACTIVITIES[likelihood.argmin()] * rates
            gain = before / (before + noise)
            self._codes = self._codes + gain * change
            self._known = before * (1.0 - gain)
        return self._read(self._codes, self._known + self._still, more)
