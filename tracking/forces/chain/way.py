"""A contact of the chain, followed from the first touch on by an ensemble of copies.

Unknown are constants of the contact (`CONSTANTS`), and in every frame the positions of rigid part
and object. Copy 0 has the constants that are believed, the others differ by a little, by a design
in which each constant is raised in half of the copies. Every copy keeps its own history and follows
the markers. What the copies leave of them gives, by regression, the sum of squares for any
constants nearby; where its minimum is far off, the way is followed again with other constants. The
springs of a chain snap from node to node, and slopes over a finite distance smooth that.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ....errors import UserError
from ....model import (
    ContactObject,
    Copies,
    Ensemble,
    Fingertip,
    copies_of,
    place_many,
    rest_ensemble,
)
from ....render import Membrane, MembraneMap, SensorDesign, areas, centroids, outlines
from ..dome.key_shifts import Shifts
from .settings import WaySettings

Array = NDArray[np.float64]

#: Logarithm of µ, curvature [1/m], logarithms of the object's stiffness and of σ0 [N/m], exponent of
#: the friction law, and logarithm of the factor of the membrane's stiffness.
CONSTANTS = ("ln mu", "curvature", "ln stiffness", "ln bristle", "exponent", "ln membrane")
#: Whether each constant is raised in each of the other copies (Plackett and Burman 1946), for up to
#: 3 constants and for up to 7.
_FEW = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float)
_MANY = np.array(
    [np.roll([1, 1, 1, -1, 1, -1, -1], k) for k in range(7)] + [[-1] * 7], dtype=float
)
#: Motion over which poses are differentiated [m], and unit of a pose [m].
_NUDGE, _UNIT = 4e-6, 1e-6
#: Size of a common change of all log sizes of a layer, by focus and blur.
_FOCUS = 5e-3


@dataclass(kw_only=True)
class WayFrame:
    """A frame of a way.

    Attributes
    ----------
    dt: time since the frame before [s]
    shifts: shifts of the markers
    weight: weight of its sum of squares; frames in which little moves repeat each other
    motion: root mean square of the motion of places since the picture before [px]
    sums: ΣFn and ΣFf [N] by another method, shape (2,); None: unknown
    """

    dt: float
    shifts: Shifts
    weight: float
    motion: float = 0.0
    sums: Array | None = None


@dataclass(kw_only=True)
class Followed:
    """The copies on their way.

    Attributes
    ----------
    constants: of each copy, shape (B, C)
    copies, ensemble: parameters and states of the copies
    pose, speed: position of copy 0 [m], and its change [m/s], shape (2,)
    offsets: positions of the copies relative to copy 0 [m], shape (B, 2)
    alive: copies that have found every position, shape (B,)
    grams: of each frame, products of the copies' residuals, each (B, B)
    misfits: of each frame, mean squared residual of copy 0
    """

    constants: Array
    copies: Copies
    ensemble: Ensemble
    pose: Array
    speed: Array
    offsets: Array
    alive: NDArray[np.bool_]
    grams: list[Array] = field(default_factory=list)
    misfits: list[float] = field(default_factory=list)

    @property
    def done(self) -> int:
        """Number of frames."""
        return len(self.grams)

    def gram(self, weights: Array) -> Array:
        """Sum of products of residuals with weights of the frames, shape (B, B)."""
        return np.tensordot(weights[: self.done], np.array(self.grams), 1)


@dataclass(frozen=True, kw_only=True)
class Quadratic:
    """Sum of squares near the constants of copy 0, by regression over the copies.

    Attributes
    ----------
    step: from copy 0 to the minimum [spreads], shape (F,)
    gain: decrease of the sum on the way there
    covariance: of the free constants [spreads²], shape (F, F)
    weights: of the copies in the regression on 1 and the free constants, shape (B, 1 + F)
    """

    step: Array
    gain: float
    covariance: Array
    weights: Array


class WayFit:
    """Follows a contact and finds its constants.

    Parameters
    ----------
    fingertip, sensor: as calibrated
    places: places of the marker pairs at rest, shape (2, P, 2)
    stiffness_deviation: standard deviation of both stiffnesses, as shares
    settings: tuned parameters
    azimuth: azimuth of the load's plane [rad]
    """

    def __init__(
        self,
        fingertip: Fingertip,
        sensor: SensorDesign,
        places: Array,
        stiffness_deviation: float,
        settings: WaySettings,
        azimuth: float = 0.0,
    ) -> None:
        self.settings, self.azimuth, self._view = settings, azimuth, sensor.view
        cos, sin = math.cos(azimuth), math.sin(azimuth)
        self._turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        places = places - [0.0, azimuth]
        self._tip = Fingertip.graded(
            settings.nodes,
            radius=fingertip.radius,
            tissue_stiffness=fingertip.tissue_stiffness,
            membrane_stiffness=fingertip.membrane_stiffness,
        )
        self._map = MembraneMap(sensor, self._tip.angles(), places)
        self._rest = np.zeros((places.shape[1], 6))
        self._rest = self._image(np.zeros((self._tip.nodes, 2)))
        self.deviation = np.array(settings.deviation)
        self.deviation[5] = max(math.sqrt(2.0) * stiffness_deviation, settings.deviation[5])
        self._free = list(settings.free)
        self._mean, self._spread = np.array(settings.mean), np.array(settings.spread)
        focus = np.zeros((2, places.shape[1], 6))
        focus[0, :, 2] = focus[1, :, 5] = _FOCUS
        # While the sensor moves, dampers hold the whole skin back; shifts of 1 px root mean square.
        lag = np.zeros((2, self._tip.nodes, 2))
        lag[0, :, 0] = lag[1, :, 1] = 1e-5
        held_back = np.stack([self._image(one) for one in lag])
        held_back /= np.sqrt((held_back[:, :, [0, 1, 3, 4]] ** 2).mean(axis=(1, 2)))[:, None, None]
        self._focus, self._lag = focus, held_back
        self._prior = np.append((_UNIT / np.array(settings.move)) ** 2, np.ones(4))

    def believe(self, friction: float) -> None:
        """Take another method's µ as what is known of it before."""
        self._mean[0] = math.log(min(max(friction, 0.05), 2.0))

    def begin(self, constants: Array, spread: float = 1.0) -> Followed:
        """Make untouched copies around some constants (C,); one alone without a spread."""
        free, low, high = self._free, self.settings.low, self.settings.high
        design = (_FEW if len(free) <= 3 else _MANY)[: None if spread > 0.0 else 0, : len(free)]
        every = np.repeat(constants[None], 1 + len(design), axis=0)
        every[1:, free] += spread * self._spread[free] * design
        every = np.clip(every, low, high)
        count = len(every)
        return Followed(
            constants=every,
            copies=copies_of(self._tip, [_object(one) for one in every], np.exp(every[:, 5])),
            ensemble=rest_ensemble(self._tip, count),
            pose=np.zeros(2),
            speed=np.zeros(2),
            offsets=np.zeros((count, 2)),
            alive=np.ones(count, np.bool_),
        )

    def advance(self, way: Followed, frame: WayFrame) -> None:
        """Follow the markers of the next frame.

        Raises
        ------
        UserError
            When no position of copy 0 explains them.
        """
        pose, columns, inverse, whole = self._fit_pose(way, frame)
        before = way.pose
        for _ in range(2):
            ensemble, solved = place_many(way.copies, way.ensemble, pose + way.offsets, frame.dt)
            left = self._left(frame, way.copies, ensemble) * whole
            shown = left @ columns
            moves = (_UNIT * (shown - shown[0]) @ inverse)[:, :2]
            far = abs(moves).max() > self.settings.apart
            longest = self.settings.longest_move
            way.offsets[1:] += np.clip(moves[1:], -longest, longest)
            if not far:
                break
        left = left - (shown @ inverse) @ columns.T
        way.alive &= solved
        way.grams.append(left @ left.T)
        left = left[0, :-2]
        way.misfits.append(float(left @ left) / frame.shifts.count)
        way.ensemble, way.pose = ensemble, pose
        way.speed = (pose - before) / frame.dt if way.done > 1 else np.zeros(2)

    def _left(self, frame: WayFrame, copies: Copies, ensemble: Ensemble) -> Array:
        """What copies leave of the whitened shifts, and last of the sums, shape (B, V·W + 2)."""
        left = frame.shifts.residual(self._images(ensemble))
        left = np.where(np.isfinite(left), left, 10.0)
        if frame.sums is None:
            return np.pad(left, [(0, 0), (0, 2)])
        return np.concatenate([left, self._off(copies.sums(ensemble), frame.sums)], axis=1)

    def _off(self, sums: Array, known: Array) -> Array:
        """Differences of sums (B, 2) from those of another method [its errors], shape (B, 2).

        Those that its errors explain are 0.
        """
        settings = self.settings
        bend, (normal, friction) = settings.sums_bend, known
        off = np.empty_like(sums)
        off[:, 0] = np.log((normal + bend) / (sums[:, 0] + bend)) / settings.sums_share
        error = settings.sums_bend * settings.sums_share + settings.sums_share * friction
        off[:, 1] = (friction - abs(sums[:, 1])) / error
        off = np.sign(off) * np.maximum(abs(off) - settings.sums_free, 0.0)
        limit = settings.sums_limit
        return math.sqrt(settings.sums_weight) * limit * np.arctan(off / limit)

    def _fit_pose(self, way: Followed, frame: WayFrame) -> tuple[Array, Array, Array, Array]:
        """Find the position of copy 0; also return weighted columns, their inverse, and weights."""
        settings, shifts = self.settings, frame.shifts
        first = way.done == 0
        ahead = np.clip(0.7 * way.speed * frame.dt, -settings.ahead, settings.ahead)
        guess = self._first_pose(way, frame) if first else way.pose + ahead
        pose, best, back = guess.copy(), None, 1.0
        full = None
        for _ in range(settings.first_rounds if first else settings.rounds):
            fresh = full is None
            nudges = _NUDGE * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
            poses = pose + (nudges if fresh else nudges[:1])
            rows = [0] * len(poses)
            placed, solved = place_many(
                way.copies.take(rows), _taken(way.ensemble, rows), poses, frame.dt
            )
            left = self._left(frame, way.copies.take(rows), placed)
            if not solved.all():
                if best is None and back < 0.01:
                    raise UserError("the chain does not follow the markers")
                loss = math.inf
            else:
                loss = shifts.loss(left[0, :-2]) + float(left[0, -2:] @ left[0, -2:])
                if fresh:
                    slopes = (left[0] - left[1:]).T * (_UNIT / _NUDGE)
                    lag = settings.lag * frame.motion * self._lag
                    others = np.concatenate([self._focus, lag])[:, shifts.used]
                    others = np.pad(shifts.apply(others).T, [(0, 2), (0, 0)])
                    full = np.concatenate([slopes, others], axis=1)
            if best is None and loss == math.inf:
                back *= 0.3
                pose = way.pose + back * (guess - way.pose)
                continue
            if best is None or loss < best[0]:
                assert full is not None
                whole = np.append(np.sqrt(shifts.weights(left[0, :-2])), [1.0, 1.0])
                columns = full * whole[:, None]
                inverse = np.linalg.inv(columns.T @ columns + np.diag(self._prior))
                gradient = columns.T @ (left[0] * whole)
                gradient[:2] += self._prior[:2] * (guess - pose) / _UNIT
                best = loss, pose, columns, inverse, whole, full
                longest = settings.longest_move
                move = np.clip(_UNIT * (inverse @ gradient)[:2], -longest, longest)
                back = 1.0
                if abs(move).max() < settings.settled:
                    break
                if abs(move).max() > settings.chord:
                    full = None
            else:
                back *= 0.35
                full = None if not fresh else best[5]
                if abs(back * move).max() < settings.settled:
                    break
            pose = best[1] + back * move
        if best is None:
            raise UserError("the chain does not follow the markers")
        _, pose, columns, inverse, whole, _ = best
        return pose, columns, inverse, whole

    def _first_pose(self, way: Followed, frame: WayFrame) -> Array:
        """Best of some positions in the first frame of a contact, shape (2,)."""
        deep, aside = np.meshgrid(self.settings.depths, self.settings.sides, indexing="ij")
        poses = np.stack([deep.ravel(), aside.ravel() * deep.ravel()], axis=1)
        rows = [0] * len(poses)
        placed, solved = place_many(
            way.copies.take(rows), _taken(way.ensemble, rows), poses, frame.dt
        )
        left = self._left(frame, way.copies.take(rows), placed)
        loss = [frame.shifts.loss(one[:-2]) + float(one[-2:] @ one[-2:]) for one in left]
        return np.asarray(poses[np.argmin(np.where(solved, loss, math.inf))])

    def quadratic(self, way: Followed, gram: Array, damping: float = 0.0) -> Quadratic:
        """Find the minimum of the sum of squares of what the copies leave.

        Parameters
        ----------
        gram: of the way, with weights
        damping: share by which the diagonal of the information is increased
        """
        free, spread = self._free, self._spread[self._free]
        offsets = (way.constants[:, free] - way.constants[0, free]) / spread
        known = np.concatenate([np.ones((len(offsets), 1)), offsets], axis=1)
        size = np.diag(gram)
        good = way.alive & (size < 4.0 * np.median(size))
        trusted = np.where(good, 1.0, 1e-3)[:, None] * known
        weights = trusted @ np.linalg.inv(known.T @ trusted)
        sums = weights.T @ gram @ weights / self.settings.inflation
        prior = (spread / self.deviation[free]) ** 2
        off = (way.constants[0, free] - self._mean[free]) / spread
        information, gradient = sums[1:, 1:] + np.diag(prior), sums[1:, 0] + prior * off
        damped = information + damping * np.diag(np.diag(information))
        step = -np.linalg.solve(damped, gradient)
        longest = np.array(self.settings.longest)[free] / spread
        step *= min(1.0, float((longest / np.maximum(abs(step), 1e-12)).min()))
        return Quadratic(
            step=step,
            gain=-float(gradient @ step),
            covariance=np.linalg.inv(information),
            weights=weights,
        )

    def moved(self, constants: Array, step: Array) -> Array:
        """Constants (C,) after a step (F,) of the free ones [spreads], within their limits."""
        free = self._free
        new = constants.copy()
        new[free] += step * self._spread[free]
        return np.clip(new, self.settings.low, self.settings.high)

    def costs(self, way: Followed, gram: Array) -> Array:
        """Sum of squares of each copy, with that of its constants before any frame, shape (B,)."""
        off = (way.constants - self._mean)[:, self._free] / self.deviation[self._free]
        each = np.diag(gram) / self.settings.inflation + (off**2).sum(axis=1)
        return np.where(way.alive, each, math.inf)

    def values(self, way: Followed) -> Array:
        """ΣFn, ΣFf [N], µ and Γ of each copy, shape (B, 4); ΣFf is that along copy 0's."""
        normal, friction = way.copies.sums(way.ensemble).T
        friction = friction * (np.sign(friction[0]) or 1.0)
        mu = np.exp(way.constants[:, 0])
        margin = 1.0 - friction / np.maximum(mu * normal, 1e-9)
        return np.stack([normal, friction, mu, margin], axis=1)

    def _images(self, ensemble: Ensemble) -> Array:
        """Shifts of all pairs in each copy, shape (B, P, 6)."""
        seen = ensemble.nodes.copy()
        seen[:, :, 1] -= ensemble.pose[:, :1]
        return np.stack([self._image(one) for one in seen])

    def _image(self, seen: Array) -> Array:
        """Shifts of all pairs for displacements (N, 2) of the nodes [m], shape (P, 6)."""
        membrane = self._map(seen)
        if self.azimuth != 0.0:
            centres, axes = membrane.centres @ self._turn.T, self._turn @ membrane.axes
            membrane = Membrane(centres=centres, axes=axes)
        image = outlines(membrane, self._view)
        with np.errstate(divide="ignore"):
            size = 0.5 * np.log(areas(image, square=False))
        each = np.concatenate([centroids(image, square=False), size[..., None]], axis=-1)
        return each.swapaxes(0, 1).reshape(-1, 6) - self._rest


def _object(constants: Array) -> ContactObject:
    """Object with these constants (C,)."""
    friction, curvature, stiffness, bristle, exponent, _ = constants.tolist()
    return ContactObject(
        friction=math.exp(friction),
        curvature=curvature if abs(curvature) > 0.5 else 0.0,
        stiffness=math.exp(stiffness),
        dahl_stiffness=math.exp(bristle),
        dahl_exponent=exponent,
    )


def _taken(ensemble: Ensemble, rows: Sequence[int]) -> Ensemble:
    """Some of the states, in this order."""
    picked = np.asarray(rows)
    return Ensemble(
        time=ensemble.time,
        nodes=ensemble.nodes[picked],
        pose=ensemble.pose[picked],
        friction=ensemble.friction[picked],
        slip_rate=ensemble.slip_rate[picked],
        rate=ensemble.rate[picked],
        step=ensemble.step,
    )


@dataclass(kw_only=True)
class Candidate:
    """Copies that have followed all frames, and their search for better constants.

    Attributes
    ----------
    now: these copies
    again: copies that follow the frames again with other constants, until they have caught up
    damping: share by which the information is increased for the next search
    wait: number of frames before the next search
    """

    now: Followed
    again: Followed | None = None
    damping: float = 0.0
    wait: int = 0


@dataclass(kw_only=True)
class Way:
    """Frames from the first touch on, and candidates for the object that explains them.

    Attributes
    ----------
    fit: what follows
    frames: frames so far
    candidates: the best first; none until there are enough frames for a start
    turn: number of searches so far
    """

    fit: WayFit
    frames: list[WayFrame] = field(default_factory=list)
    candidates: list[Candidate] = field(default_factory=list)
    turn: int = 0

    @property
    def now(self) -> Followed | None:
        """Copies of the best candidate."""
        return self.candidates[0].now if self.candidates else None

    @property
    def weights(self) -> Array:
        """Weights of the frames: a light touch tells less of what happens under larger forces."""
        forces = np.array([0.0 if one.sums is None else one.sums[0] for one in self.frames])
        share = forces / (forces + self.fit.settings.light * max(forces.max(), 1e-6))
        return np.array([one.weight for one in self.frames]) * share**2

    def add(self, frame: WayFrame, friction: float = math.nan) -> None:
        """Follow a frame, and go on with the search.

        Parameters
        ----------
        friction: µ by another method, from which a search starts; NaN: unknown
        """
        settings = self.fit.settings
        self.frames.append(frame)
        if friction > 0.0:
            self.fit.believe(friction)
        if not self.candidates:
            pressed = frame.sums is not None and frame.sums[0] > settings.first_force
            if len(self.frames) >= settings.first_frames and pressed:
                self._start(friction)
            return
        kept = []
        for one in self.candidates:
            try:
                self.fit.advance(one.now, frame)
                kept.append(one)
            except UserError:
                continue
        self.candidates = kept
        self._sort()
        self.search()

    def _sort(self) -> None:
        """Put the best candidate first, and drop those that the markers rule out."""
        settings, weights = self.fit.settings, self.weights
        costs = [self.fit.costs(one.now, one.now.gram(weights))[0] for one in self.candidates]
        order = np.argsort(costs)
        limit = settings.ruled_out * min(costs, default=0.0) + settings.ruled_out_by
        many = len(self.frames) > settings.tried
        self.candidates = [
            self.candidates[k] for k in order if not (many and costs[k] > limit)
        ]

    def search(self) -> None:
        """Go on with the search for better constants, of the best candidate in every other turn."""
        if not self.candidates:
            return
        self.turn += 1
        others = self.turn // 2 % len(self.candidates)
        one = self.candidates[0 if self.turn % 2 else others]
        budget = self.fit.settings.catch_up
        while budget > 0:
            budget = self._search(one, budget)
        self._sort()

    def quadratic(self) -> Quadratic:
        """Minimum of the sum of squares near the best constants."""
        assert self.now is not None
        return self.fit.quadratic(self.now, self.now.gram(self.weights))

    def misfit(self) -> tuple[float, float]:
        """Weighted mean over the frames of the mean squared residual, and that of the last one."""
        assert self.now is not None
        each = np.array(self.now.misfits)
        return float(np.average(each, weights=self.weights + 1e-9)), float(each[-1])

    def _start(self, friction: float) -> None:
        """Follow the first frames with a candidate of each curvature."""
        settings = self.fit.settings
        for curvature in settings.curvatures:
            best, constants = math.inf, None
            for stiffness in settings.stiffnesses:
                tried = np.array(settings.mean)
                tried[1:3] = curvature, math.log(stiffness)
                if friction > 0.0:
                    tried[0] = math.log(min(max(friction, 0.1), 1.5))
                way = self._followed(tried, 0.0)
                if way is None:
                    continue
                cost = float(self.fit.costs(way, way.gram(self.weights))[0])
                if cost < best:
                    best, constants = cost, tried
            way = None if constants is None else self._followed(constants, 1.0)
            if way is not None:
                self.candidates.append(Candidate(now=way))
        self._sort()

    def _followed(self, constants: Array, spread: float) -> Followed | None:
        """Copies around some constants that have followed all frames; None if they cannot."""
        way = self.fit.begin(constants, spread)
        try:
            for frame in self.frames:
                self.fit.advance(way, frame)
        except UserError:
            return None
        return way

    def _search(self, one: Candidate, budget: int) -> int:
        """Do a part of a search, of at most so many frames; return what is left of the budget."""
        fit, now, settings, weights = self.fit, one.now, self.fit.settings, self.weights
        gram = now.gram(weights)
        costs = fit.costs(now, gram)
        if one.again is None:
            if len(self.frames) < one.wait or len(self.frames) > settings.most_frames:
                return 0
            found = fit.quadratic(now, gram, one.damping)
            if not found.gain > settings.gain + settings.gain_share * costs[0]:
                if one.damping > 0.0:
                    one.damping, one.wait = 0.0, len(self.frames) + settings.patience
                return 0
            near = abs(found.step).max() < 1.5
            constants = fit.moved(now.constants[0], found.step)
            if one.damping > 0.0 and costs.min() < costs[0] - settings.gain:
                # A copy that is known to be better; a longer step was not.
                constants = now.constants[int(costs.argmin())]
            one.again = fit.begin(constants, settings.near if near else 1.0)
        again, failed = one.again, False
        before = np.cumsum(weights * [gram[0, 0] for gram in now.grams])
        try:
            while again.done < now.done and budget > 0 and not failed:
                fit.advance(again, self.frames[again.done])
                budget -= 1
                so_far = float(weights[: again.done] @ [gram[0, 0] for gram in again.grams])
                allowed = settings.worse * before[again.done - 1] + settings.slack * before[-1]
                failed = not again.alive[0] or so_far > allowed
        except UserError:
            failed = True
        if not failed and again.done < now.done:
            return 0
        if not failed and fit.costs(again, again.gram(weights))[0] < costs[0]:
            one.now, one.damping = again, one.damping / 4.0 if one.damping > 1.0 else 0.0
        else:
            one.damping = 4.0 * one.damping + 1.0
            if one.damping > settings.most_damping:
                one.damping, one.wait = 0.0, len(self.frames) + settings.patience
        one.again = None
        return budget
