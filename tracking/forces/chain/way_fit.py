"""Copies of a chain that follow the markers of a contact from its first touch on.

Unknown are constants of the contact (`CONSTANTS`), and in every frame the positions of rigid part
and object. Copy 0 has the constants that are believed, the others differ by a little, by a design
in which each constant is raised in half of the copies. Every copy keeps its own history. What the
copies leave of the markers gives, by regression, the sum of squares for any constants nearby. The
springs of a chain snap from node to node, and slopes over a finite distance smooth that.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

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

#: Constants: ln µ, curvature [1/m], logarithms of the object's stiffness and of σ0 [N/m], exponent
#: of the friction law, and logarithm of the factor of the membrane's stiffness.
CONSTANTS = ("ln mu", "curvature", "ln stiffness", "ln bristle", "exponent", "ln membrane")
#: Whether each constant is raised in each of the other copies (Plackett and Burman 1946), for up to
#: 3 constants and for up to 7.
_FEW = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float)
_MANY = np.array([np.roll([1, 1, 1, -1, 1, -1, -1], k) for k in range(7)] + [[-1] * 7], dtype=float)
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

    def forget_before_last(self) -> None:
        """Count the last frame in place of the one before it."""
        del self.grams[-2], self.misfits[-2]


class _Pose(NamedTuple):
    """A position of copy 0 in a frame [m], with what follows from it.

    `slopes` are derivatives of the whitened shifts, and last of the sums, by the position [1/µm],
    by the focus of both layers, and by lags, shape (V·W + 2, 6); `columns` are the same with the
    weights `whole`, and `inverse` the covariance of the 6 unknowns.
    """

    place: Array
    loss: float
    slopes: Array
    whole: Array
    columns: Array
    inverse: Array
    gradient: Array


@dataclass(frozen=True, kw_only=True)
class Quadratic:
    """Sum of squares near the constants of copy 0, by regression over the copies.

    Attributes
    ----------
    step: from copy 0 to the minimum [spreads], shape (F,)
    gain: decrease of the sum on the way there
    weights: of the copies in the regression on 1 and the free constants, shape (B, 1 + F)
    """

    step: Array
    gain: float
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
        found = self._fit_pose(way, frame)
        settings, before = self.settings, way.pose
        for _ in range(2):
            poses = found.place + way.offsets
            ensemble, solved = place_many(way.copies, way.ensemble, poses, frame.dt)
            left = self._left(frame, way.copies, ensemble) * found.whole
            shown = left @ found.columns
            moves = (_UNIT * (shown - shown[0]) @ found.inverse)[:, :2]
            way.offsets[1:] += np.clip(moves[1:], -settings.longest_move, settings.longest_move)
            if abs(moves).max() < settings.apart:
                break
        left = left - (shown @ found.inverse) @ found.columns.T
        way.alive &= solved
        way.grams.append(left @ left.T)
        way.misfits.append(float(left[0, :-2] @ left[0, :-2]) / frame.shifts.count)
        way.speed = (found.place - before) / frame.dt if way.done > 1 else np.zeros(2)
        way.ensemble, way.pose = ensemble, found.place

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

    def _fit_pose(self, way: Followed, frame: WayFrame) -> "_Pose":
        """Find the position of copy 0 by Gauss-Newton, with derivatives kept while steps are short.

        Raises
        ------
        UserError
            When no position explains the markers.
        """
        settings, first = self.settings, way.done == 0
        ahead = np.clip(0.7 * way.speed * frame.dt, -settings.ahead, settings.ahead)
        guess = self._first_pose(way, frame) if first else way.pose + ahead
        place, best, back, slopes = guess, None, 1.0, None
        move = np.zeros(2)
        for _ in range(settings.first_rounds if first else settings.rounds):
            fresh = slopes is None
            left, found = self._residuals(way, frame, place, fresh)
            loss = math.inf if left is None else _loss(frame, left[0])
            if left is not None and found is not None:
                slopes = found
            if best is None and left is None:
                back *= 0.3  # nearer to where the copy was
                place = way.pose + back * (guess - way.pose)
                continue
            if left is not None and (best is None or loss < best.loss):
                assert slopes is not None
                best = self._linear(frame, place, left[0], slopes, loss)
                move, back = self._move(best, guess - place), 1.0
                if abs(move).max() < settings.settled:
                    break
                if abs(move).max() > settings.chord:
                    slopes = None
            else:
                assert best is not None
                back *= 0.35
                slopes = None if not fresh else best.slopes
                if abs(back * move).max() < settings.settled:
                    break
            assert best is not None
            place = best.place + back * move
        if best is None:
            raise UserError("the chain does not follow the markers")
        return best

    def _residuals(
        self, way: Followed, frame: WayFrame, place: Array, slopes: bool
    ) -> tuple[Array | None, Array | None]:
        """Residual of copy 0 at a position, (1, V·W + 2), and if asked for its slopes (V·W + 2, 6).

        None for the first: the chain has no solution there.
        """
        nudges = _NUDGE * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        poses = place + (nudges if slopes else nudges[:1])
        left, solved = self._tried(way, frame, poses)
        if not solved.all():
            return None, None
        if not slopes:
            return left, None
        by_pose = (left[0] - left[1:]).T * (_UNIT / _NUDGE)
        shifts = frame.shifts
        lag = self.settings.lag * frame.motion * self._lag
        others = shifts.apply(np.concatenate([self._focus, lag])[:, shifts.used]).T
        return left[:1], np.concatenate([by_pose, np.pad(others, [(0, 2), (0, 0)])], axis=1)

    def _tried(
        self, way: Followed, frame: WayFrame, poses: Array
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Residuals of copy 0 at K positions, (K, V·W + 2), and which of them have a solution."""
        rows = [0] * len(poses)
        copies = way.copies.take(rows)
        placed, solved = place_many(copies, way.ensemble.take(rows), poses, frame.dt)
        return self._left(frame, copies, placed), solved

    def _linear(
        self, frame: WayFrame, place: Array, left: Array, slopes: Array, loss: float
    ) -> "_Pose":
        """Weighted equations of a position."""
        whole = np.append(np.sqrt(frame.shifts.weights(left[:-2])), [1.0, 1.0])
        columns = slopes * whole[:, None]
        inverse = np.linalg.inv(columns.T @ columns + np.diag(self._prior))
        return _Pose(place, loss, slopes, whole, columns, inverse, columns.T @ (left * whole))

    def _move(self, at: "_Pose", off: Array) -> Array:
        """Step of a position [m]; `off` leads to where it was expected."""
        gradient = at.gradient.copy()
        gradient[:2] += self._prior[:2] * off / _UNIT
        longest = self.settings.longest_move
        return np.clip(_UNIT * (at.inverse @ gradient)[:2], -longest, longest)

    def _first_pose(self, way: Followed, frame: WayFrame) -> Array:
        """Best of some positions in the first frame of a contact, shape (2,)."""
        deep, aside = np.meshgrid(self.settings.depths, self.settings.sides, indexing="ij")
        poses = np.stack([deep.ravel(), aside.ravel() * deep.ravel()], axis=1)
        left, solved = self._tried(way, frame, poses)
        loss = [_loss(frame, one) for one in left]
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


def _loss(frame: WayFrame, left: Array) -> float:
    """Loss of a residual (V·W + 2,)."""
    return frame.shifts.loss(left[:-2]) + float(left[-2:] @ left[-2:])


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
