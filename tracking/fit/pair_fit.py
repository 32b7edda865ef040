"""The fit of every marker pair of one sensor to an image; optics and light tuned where they drift.

What is fitted is the known shape under the local light: each pair has a gain of its own for each
channel, whose slope across the pair is read off its neighbours. Where the pairs stop being
explained, the colours and the blur are fitted too, to all pairs together.
"""

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...render.drawing.coverage import edge_width
from ..detection import RestFrame, neighbours
from ..palette import Palette
from .colours import fit_colours, level_tables
from .light_kernels import light_sums
from .neighbour_kernels import crowded, median
from .pair_kernels import fit_step, mean_hues
from .pixel_kernels import BUFFER, TERMS, Optics

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Pixels this many standard deviations outside an edge still tell of sizes; of places, these.
_REACH, _CLOSE = 3.0, 2.0
#: A fit whose last step was larger than this was not on its way to the end [px].
_NEARLY = 0.3
#: A misfit this many times the typical one may be for uneven light, which takes more steps.
_UNEVEN, _UNEVEN_STEPS = 1.6, 6
#: Steps of pairs whose motion changed, where a single one is enough for most.
_GLANCES = 3
#: A slope of the light that changed by more than this is worth another step [1/px].
_SLOPED = 2e-4
#: Blur that is tried first, standard deviation [px]; by how much an edge is tried wider or
#: narrower; and the widest.
_FIRST_BLUR = 0.8
_WIDER, _WIDEST = 1.15, 4.0
#: Colours and places are fitted in turns, so often.
_ROUNDS = 2
#: Levels of black that are tried, and the one of a picture as it should be. Levels next to 0 would
#: explain what is a dye's.
_BLACKS = (-32.0, -16.0, 0.0, *np.arange(16.0, 121.0, 8.0).tolist())
_NO_LIFT = (0.0, 0.0, 0.0)
#: Below this share of its contrast at rest a dye is not seen.
_FADED = 0.15
_NEIGHBOURS = 6
#: Pairs next to each pair at rest that may come to lie on it.
_OVERLAPPING = 12
#: Markers of a layer within this many radii of each other are not told apart with certainty, within
#: this many are fitted in so many more, and so much smaller steps, and within this many lie so near
#: that their edges' light goes together.
_CROWDED, _TOUCHING, _BESIDE = 1.2, 2.1, 2.7
_TOUCHING_STEPS, _SMALLER = 30, 0.1
#: How light goes between pairs that touch is not believed where it explains them so much less.
_WORSE = 1.1


@dataclass(frozen=True)
class PairState:
    """What is known of M pairs, and what is assumed of the light.

    Attributes
    ----------
    fits: (x, y, e, p, q) of both layers, see `pair_kernels`, shape (M, 2, 5)
    present: layers that are there, shape (M, 2)
    gains: light of each channel over that at rest, shape (M, 3)
    slopes: how it changes across each pair, see `pixel_kernels`, shape (M, 5)
    absorbed: what the dyes absorb, and what both together leave over, shape (3, 3)
    width: standard deviation of an edge [px]
    black: level of each channel that stands for no light
    """

    fits: Array
    present: NDArray[np.bool_]
    gains: Array
    slopes: Array
    absorbed: NDArray[np.float32]
    width: float
    black: tuple[float, ...]


@dataclass(frozen=True)
class PairFits:
    """A fit: the state, how it explains the image, and how certain it is.

    Attributes
    ----------
    state: after the fit
    misfit: mean squared residual over noise variance, shape (M,); infinite where none was found
    covariance: of (x, y, e) of both layers and of the gains' logarithms, shape (M, 9, 9)
    """

    state: PairState
    misfit: Array
    covariance: Array

    @cached_property
    def typical(self) -> float:
        """Median misfit."""
        return float(median(self.misfit))


class PairFit:
    """Fits the pairs of a rest frame to other frames.

    Parameters
    ----------
    rest: see RestFrame; of one layer or two
    palette: of the markers
    noise: standard deviation of the camera noise [grey levels]; rounding is added to it
    """

    def __init__(self, rest: RestFrame, palette: Palette, noise: float) -> None:
        self._free, self._stride, self._arrived = 5, 1, 0.0
        self._noise = noise
        linear, weight = level_tables(_NO_LIFT, noise)
        layers, count, _ = rest.position.shape
        absorbed = np.zeros((3, 3))
        absorbed[:layers] = 1.0 - palette.transmittance
        absorbed[2] = absorbed[0] * absorbed[1]
        self._nominal = absorbed
        position = np.full((2, count, 2), np.nan)
        position[:layers] = rest.position
        radius = np.append(rest.radius, rest.radius[-1:])[:2]
        self._radius = radius
        middle = np.nanmean(position, axis=0)
        self._near = neighbours(middle, _NEIGHBOURS)
        offsets = middle[self._near] - middle[:, None]
        # Slope of a plane through the logarithms of a pair's own gain and its neighbours'.
        centred = offsets - offsets.sum(axis=1, keepdims=True) / (offsets.shape[1] + 1)
        own = -offsets.sum(axis=1) / (offsets.shape[1] + 1)
        square = np.einsum("mki,mkj->mij", centred, centred) + own[:, :, None] * own[:, None]
        self._to_slope = np.linalg.solve(square, np.swapaxes(centred, 1, 2))
        self._optics = Optics(
            linear=linear,
            weight=weight,
            ground=rest.ground.astype(np.float32),
            absorbed=absorbed.astype(np.float32),
            shapes=np.tile(radius[:, None, None, None] * np.eye(2), (1, count, 1, 1)),
            neighbours=neighbours(middle, _OVERLAPPING),
            width=edge_width(_FIRST_BLUR),
            reach=_REACH,
        )
        fits = np.zeros((count, 2, 5))
        # A layer that is not there has some place, too.
        fits[:, :, :2] = np.where(np.isnan(position), middle, position).swapaxes(0, 1)
        self.start = PairState(
            fits=fits,
            present=np.isfinite(position[:, :, 0]).T,
            gains=np.ones((count, 3)),
            slopes=np.zeros((count, TERMS)),
            absorbed=self._optics.absorbed,
            width=self._optics.width,
            black=_NO_LIFT,
        )
        self._buffer = np.zeros(BUFFER, dtype=np.float32)

    def with_effort(self, free: int, stride: int, arrived: float) -> "PairFit":
        """The same with less effort.

        Parameters
        ----------
        free: numbers of each layer that are fitted, 5 or only the first 2, its place
        stride: every so manieth row of the image is read
        arrived: a step that moves no edge by more than this is the last [px]
        """
        other = copy(self)
        other._free, other._stride, other._arrived = free, stride, arrived
        if free == 2:
            other._optics = self._optics._replace(reach=_CLOSE)
        return other

    @property
    def radius(self) -> Array:
        """Of the markers of each layer at rest [px], shape (2,)."""
        return self._radius

    @property
    def near(self) -> NDArray[np.int64]:
        """Pairs next to each pair, shape (M, K)."""
        return self._near

    def take_shapes(self, state: PairState) -> PairState:
        """Make the shapes of a state the nominal ones; the same state relative to them."""
        fits = state.fits
        size = np.exp(fits[..., 2])[..., None, None]
        p, q = fits[..., 3], fits[..., 4]
        strain = np.stack([np.stack([1 + p, q], -1), np.stack([q, 1 - p], -1)], axis=-2)
        shapes = np.swapaxes(size * strain, 0, 1) @ self._optics.shapes
        self._optics = self._optics._replace(shapes=shapes)
        unstrained = fits.copy()
        unstrained[..., 2:] = 0.0
        return replace(state, fits=unstrained)

    def fit(self, image: Image, start: PairState, steps: int) -> PairFits:
        """Fit all pairs of an image, from a state, in at most so many steps."""
        state = _copy(start)
        state.slopes[:, 2:] = 0.0
        count = len(state.fits)
        covariance, misfit = np.full((count, 9, 9), np.nan), np.full(count, np.inf)
        self._step(image, state, np.ones(count, dtype=np.bool_), steps, covariance, misfit)
        return PairFits(state, misfit, covariance)

    def refit(
        self,
        image: Image,
        start: PairState,
        active: NDArray[np.bool_],
        covariance: Array,
        misfit: Array,
        steps: int,
    ) -> PairFits:
        """Fit some pairs, shape (M,), of an image; the others stay as they are in a state.

        What is known of those is given: covariance (M, 9, 9) and misfit (M,).
        """
        state = _copy(start)
        state.slopes[active, 2:] = 0.0
        covariance, misfit = covariance.copy(), np.where(active, np.inf, misfit)
        self._step(image, state, active, steps, covariance, misfit)
        return PairFits(state, misfit, covariance)

    def glance(self, image: Image, start: PairState) -> PairFits:
        """Single steps from a state, a few more for pairs that have not arrived."""
        state = _copy(start)
        count = len(state.fits)
        covariance, misfit = np.full((count, 9, 9), np.nan), np.full(count, np.inf)
        optics = self._optics_of(state)
        moved, no = np.zeros(count), np.zeros(count, dtype=np.bool_)
        active = state.present.any(axis=1)
        for _ in range(_GLANCES):
            fit_step(
                image, optics, active, state.present, no, no, self._free, self._stride, state.fits,
                state.gains, state.slopes, moved, covariance, misfit, self._buffer,
            )  # fmt: skip
            active = moved > self._arrived
            if not active.any():
                break
        misfit[active] = np.inf
        state.slopes[:, :2] += 0.5 * (self._slopes(state.gains) - state.slopes[:, :2])
        return PairFits(state, misfit, covariance)

    def fit_apart(
        self, image: Image, found: PairFits, start: PairState, limit: float, steps: int
    ) -> PairFits:
        """Fit pairs whose misfit is above a limit again, as if one layer, or none, were not there.

        What is not there casts no shade on its neighbours; they are fitted again as well.
        """
        bad = found.misfit > limit
        state = _copy(found.state)
        state.present[bad] = False
        covariance, misfit = found.covariance.copy(), np.where(bad, np.inf, found.misfit)
        for layers in ([True, False], [False, True], [True, True]):
            active = (misfit > limit) & (start.present >= layers).all(axis=1)
            if not active.any():
                continue
            tried, tried_misfit = _copy(state), misfit.copy()
            tried.present[active] = layers
            for ours, theirs in ((tried.fits, start.fits), (tried.gains, start.gains),
                                 (tried.slopes, start.slopes)):  # fmt: skip
                ours[active] = theirs[active]
            self._step(image, tried, active, steps, covariance, tried_misfit)
            explained = active & (tried_misfit < limit)
            state = _chosen(explained, tried, state)
            misfit = np.where(explained, tried_misfit, misfit)
        shaded = misfit > _UNEVEN * max(1.0, median(misfit))
        self._step(image, state, shaded & np.isfinite(misfit), steps, covariance, misfit)
        return PairFits(state, misfit, covariance)

    def tune(self, image: Image, found: PairFits, shapes: Array, steps: int) -> PairFits:
        """Fit colours and blur as well; the result is the best of those tried, or `found`.

        Parameters
        ----------
        image, found: a fit to the image that may not explain it
        shapes: fits (M, 2, 5) whose sizes and strains are taken until the colours are known, which
            they would make up for
        steps: at most so many in a fit
        """
        places = self.with_effort(2, self._stride, self._arrived)
        fits = np.concatenate([found.state.fits[..., :2], shapes[..., 2:]], axis=-1)
        start = replace(found.state, fits=fits)
        start = replace(start, black=self._black(image, start))

        def tuned(width: float) -> PairFits:
            state = replace(start, width=width)
            for _ in range(_ROUNDS):
                state = places.fit(image, self._colours(image, state), steps).state
            return self.fit(image, self._colours(image, state), steps)

        best = min(found, tuned(found.state.width), key=_score)
        for factor in (_WIDER, 1.0 / _WIDER):
            while 1.0 < _WIDEST * self._optics.width / best.state.width < _WIDEST**2:
                tried = tuned(factor * best.state.width)
                if not _score(tried) < _score(best):
                    break
                best = tried
        return best

    def faded(self, state: PairState) -> bool:
        """Whether a dye has lost so much contrast that what is fitted may be anything."""
        now = np.linalg.norm(state.absorbed[:2], axis=1)
        return bool((now < _FADED * np.linalg.norm(self._nominal[:2], axis=1)).any())

    def crowded(self, fits: Array, visible: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Visible markers that lie on another one of their layer, shape (M, 2)."""
        return np.asarray(crowded(fits, visible, self._optics.neighbours, _CROWDED * self._radius))

    def touching(self, fits: Array, visible: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Pairs with a marker that touches another one of its layer, shape (M,)."""
        return self._within(_TOUCHING, fits, visible)

    def hues(self, image: Image, fits: Array) -> Array:
        """Mean hue inside each first-layer marker [°], shape (M,)."""
        return np.asarray(mean_hues(image, self._optics.shapes, fits))

    def _step(
        self,
        image: Image,
        state: PairState,
        active: NDArray[np.bool_],
        steps: int,
        covariance: Array,
        misfit: Array,
    ) -> None:
        """Steps on the active pairs, in place, until they have arrived."""
        optics = self._optics_of(state)
        moved, asked = np.zeros(len(active)), active
        uneven = np.zeros(len(active), dtype=np.bool_)
        # Those that touch may be far from where they will be found.
        lying = (state.fits, state.present)
        beside = self._within(_BESIDE, *lying) & ~self._within(_TOUCHING, *lying)

        def step() -> None:
            fit_step(
                image, optics, active, state.present, uneven, beside, self._free, self._stride,
                state.fits, state.gains, state.slopes, moved, covariance, misfit, self._buffer,
            )  # fmt: skip

        for _ in range(steps):
            step()
            slopes, now = self._slopes(state.gains), state.slopes[:, :2]
            turned = abs(slopes - now).max(axis=1) > _SLOPED
            now[:] = np.where(turned[:, None], slopes, 0.5 * (slopes + now))
            active = active & np.isfinite(misfit) & ((moved > self._arrived) | turned)
            if not active.any():
                break
        # Each of those that touch is fitted to where the others were: they creep.
        touching = self._within(_TOUCHING, *lying) | (self._within(_BESIDE, *lying) & ~beside)
        refined = active = asked & touching & np.isfinite(misfit)
        results = (state.fits, state.gains, state.slopes, misfit, covariance, moved)
        before = [values[refined] for values in results]
        beside = beside | refined
        for _ in range(_TOUCHING_STEPS):
            if not active.any():
                break
            step()
            active = active & np.isfinite(misfit) & (moved > _SMALLER * self._arrived)
        worse = ~(misfit[refined] < _WORSE * before[3])
        back = np.flatnonzero(refined)[worse]
        for values, kept in zip(results, before, strict=True):
            values[back] = kept[worse]
        beside[back] = False
        # What is explained badly may lie at the edge of a shadow.
        typical = max(1.0, median(misfit))
        uneven = asked & np.isfinite(misfit) & (misfit > _UNEVEN * typical)
        active = uneven
        for turn in range(_UNEVEN_STEPS):
            if not active.any():
                break
            step()
            # How well a step explains the image is known at the next one.
            active = active & np.isfinite(misfit) & ((moved > self._arrived) | (turn == 0))
        # Not arrived is not found.
        misfit[asked & (moved > max(self._arrived, _NEARLY))] = np.inf

    def _within(self, radii: float, fits: Array, there: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Pairs with a marker that lies within so many radii of another one, shape (M,)."""
        near = self._optics.neighbours
        found = np.asarray(crowded(fits, there, near, radii * self._radius))
        return np.logical_or(found[:, 0], found[:, 1])

    def _slopes(self, gains: Array) -> Array:
        """Relative slope of the gains at each pair [1/px], shape (M, 2)."""
        light = np.log(gains).mean(axis=1)
        return np.asarray(
            np.einsum("mik,mk->mi", self._to_slope, light[self._near] - light[:, None])
        )

    def _optics_of(self, state: PairState) -> Optics:
        linear, weight = level_tables(state.black, self._noise)
        return self._optics._replace(
            linear=linear, weight=weight, absorbed=state.absorbed, width=state.width
        )

    def _colours(self, image: Image, state: PairState) -> PairState:
        """Colours that explain the image best on the markers, and gains that go with them."""
        seen, sums = self._light_sums(image, state)
        absorbed, gain, _ = fit_colours(sums, self._nominal)
        gains = state.gains.copy()
        gains[seen] *= gain
        # Rows one after another, as before: else every kernel would be compiled once more.
        rows = absorbed.astype(np.float32, order="C")
        return replace(state, absorbed=rows, gains=gains)

    def _black(self, image: Image, state: PairState) -> tuple[float, ...]:
        """Level of black in each channel that leaves the least doubt about the colours."""
        doubts = []
        for level in _BLACKS:
            _, sums = self._light_sums(image, replace(state, black=(level,) * 3))
            doubts.append(fit_colours(sums, self._nominal)[2])
        return tuple(_BLACKS[best] for best in np.argmin(doubts, axis=0))

    def _light_sums(self, image: Image, state: PairState) -> tuple[NDArray[np.intp], Array]:
        """Numbers of the pairs that tell of colours, and what they tell; see `light_sums`."""
        sums = np.zeros((len(state.fits), 3, 5, 5))
        light_sums(
            image, self._optics_of(state), state.present, self._stride, state.fits, state.gains,
            state.slopes, sums, self._buffer,
        )  # fmt: skip
        seen = np.flatnonzero((sums[:, :, 0, 0] > 0.0).all(axis=1))
        return seen, sums[seen]


def _copy(state: PairState) -> PairState:
    return replace(
        state,
        fits=state.fits.copy(),
        present=state.present.copy(),
        gains=state.gains.copy(),
        slopes=state.slopes.copy(),
    )


def _chosen(which: NDArray[np.bool_], first: PairState, second: PairState) -> PairState:
    """Some pairs, shape (M,), of one state, the others of another."""
    row = which[:, None]
    return replace(
        second,
        fits=np.where(row[..., None], first.fits, second.fits),
        present=np.where(row, first.present, second.present),
        gains=np.where(row, first.gains, second.gains),
        slopes=np.where(row, first.slopes, second.slopes),
    )


def _score(found: PairFits) -> float:
    """Median misfit, those that were not found counted."""
    return float(median(np.minimum(found.misfit, 1e9)))
