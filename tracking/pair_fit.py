"""The fit of every marker pair of one sensor to an image; optics and light tuned where they drift.

What is fitted is the known shape under the local light: each pair has a gain of its own for each
channel, whose slope across the pair is read off its neighbours. Where the pairs stop being
explained, the colours and the blur are fitted too, to all pairs together.
"""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ..render.colour import decoding_table
from ..render.coverage import edge_width
from .detection import RestFrame
from .pair_kernels import BUFFER, TERMS, Optics, fit_step, light_sums, mean_hues
from .palette import Palette

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: A fit whose last step was larger than this was not on its way to the end [px].
_NEARLY = 0.3
#: A misfit this many times the typical one may be for uneven light, which takes more steps.
_UNEVEN, _UNEVEN_STEPS = 1.6, 6
#: A slope of the light that changed by more than this is worth another step [1/px].
_SLOPED = 2e-4
#: Blur that is tried first, standard deviation [px]; by how much an edge is tried wider or
#: narrower; and the widest.
_FIRST_BLUR = 0.8
_WIDER, _WIDEST = 1.15, 4.0
#: How well the colours are known beforehand: standard deviation of what a dye absorbs.
_COLOURS_KNOWN = 0.03
#: Colours and places are fitted in turns, so often.
_ROUNDS = 2
#: Dark tones are tried lifted by such shares of the ground's.
_LIFTS = np.linspace(-0.3, 0.9, 61)
#: What an image says of the colours counts so much less than noise alone would have it: the model's
#: own errors are common to all pixels.
_OWN_ERRORS = 1.0 / 300.0
#: Below this share of its contrast at rest a dye is not seen.
_FADED = 0.15
_NEIGHBOURS = 6


@dataclass(frozen=True)
class PairState:
    """What is known of M pairs, and what is assumed of the light.

    Attributes
    ----------
    fits: (x, y, e, p, q) of both layers, see `pair_kernels`, shape (M, 2, 5)
    present: layers that are there, shape (M, 2)
    gains: light of each channel over that at rest, shape (M, 3)
    slopes: how it changes across each pair, see `pair_kernels`, shape (M, 5)
    absorbed: what the dyes absorb, and what both together leave over, shape (3, 3)
    width: standard deviation of an edge [px]
    """

    fits: Array
    present: NDArray[np.bool_]
    gains: Array
    slopes: Array
    absorbed: NDArray[np.float32]
    width: float


@dataclass(frozen=True)
class PairFits:
    """A fit: the state, how it explains the image, and how certain it is.

    Attributes
    ----------
    state: after the fit
    misfit: mean squared residual over noise variance, shape (M,); infinite where none was found
    covariance: of (x, y, e) of both layers, shape (M, 6, 6)
    """

    state: PairState
    misfit: Array
    covariance: Array


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
        linear = decoding_table()
        layers, count, _ = rest.position.shape
        absorbed = np.zeros((3, 3))
        absorbed[:layers] = 1.0 - palette.transmittance
        absorbed[2] = absorbed[0] * absorbed[1]
        self._nominal = absorbed
        position = np.full((2, count, 2), np.nan)
        position[:layers] = rest.position
        radius = np.append(rest.radius, rest.radius[-1:])[:2]
        middle = np.nanmean(position, axis=0)
        offsets, self._near = _neighbours(middle)
        # Slope of a plane through the logarithms of a pair's own gain and its neighbours'.
        centred = offsets - offsets.sum(axis=1, keepdims=True) / (offsets.shape[1] + 1)
        own = -offsets.sum(axis=1) / (offsets.shape[1] + 1)
        square = np.einsum("mki,mkj->mij", centred, centred) + own[:, :, None] * own[:, None]
        self._to_slope = np.linalg.solve(square, np.swapaxes(centred, 1, 2))
        self._optics = Optics(
            linear=linear.astype(np.float32),
            weight=(1.0 / (np.gradient(linear) ** 2 * (noise**2 + 1.0 / 12.0))).astype(np.float32),
            ground=rest.ground.astype(np.float32),
            absorbed=absorbed.astype(np.float32),
            shapes=np.tile(radius[:, None, None, None] * np.eye(2), (1, count, 1, 1)),
            neighbours=self._near,
            width=edge_width(_FIRST_BLUR),
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
        return other

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
        covariance, misfit = np.full((count, 6, 6), np.nan), np.full(count, np.inf)
        self._step(image, state, np.ones(count, dtype=np.bool_), steps, covariance, misfit)
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
        shaded = misfit > _UNEVEN * max(1.0, float(np.median(misfit)))
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

        def tuned(width: float) -> PairFits:
            state = replace(found.state, fits=fits, width=width)
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
        optics = self._optics._replace(absorbed=state.absorbed, width=state.width)
        moved, asked = np.zeros(len(active)), active
        uneven = np.zeros(len(active), dtype=np.bool_)

        def step() -> None:
            fit_step(
                image, optics, active, state.present, uneven, self._free, self._stride, state.fits,
                state.gains, state.slopes, moved, covariance, misfit, self._buffer,
            )  # fmt: skip

        for _ in range(steps):
            step()
            slopes, now = self._slopes(state.gains), state.slopes[:, :2]
            turned = abs(slopes - now).max(axis=1) > _SLOPED
            now[:] = np.where(turned[:, None], slopes, 0.5 * (slopes + now))
            active = active & np.isfinite(misfit) & ((moved > self._arrived) | turned)
            if not active.any():
                break
        # What is explained badly may lie at the edge of a shadow.
        typical = max(1.0, float(np.median(misfit)))
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

    def _slopes(self, gains: Array) -> Array:
        """Relative slope of the gains at each pair [1/px], shape (M, 2)."""
        light = np.log(gains).mean(axis=1)
        return np.asarray(
            np.einsum("mik,mk->mi", self._to_slope, light[self._near] - light[:, None])
        )

    def _colours(self, image: Image, state: PairState) -> PairState:
        """Colours that explain the image best on the markers, and gains that go with them."""
        optics = self._optics._replace(absorbed=state.absorbed, width=state.width)
        sums = np.zeros((len(state.fits), 3, 5, 5))
        light_sums(
            image, optics, state.present, self._stride, state.fits, state.gains, state.slopes,
            sums, self._buffer,
        )  # fmt: skip
        absorbed, gains = np.empty((3, 3)), state.gains.copy()
        seen = np.flatnonzero(sums[:, 0, 0, 0] > 0.0)
        for c in range(3):
            absorbed[:, c], gain = _fit_colour(sums[seen, c], self._nominal[:, c])
            gains[seen, c] *= gain
        return replace(state, absorbed=absorbed.astype(np.float32), gains=gains)


def _fit_colour(sums: Array, nominal: Array) -> tuple[Array, Array]:
    """What is absorbed in one channel, shape (3,), and the gain of each pair, shape (n,).

    Parameters
    ----------
    sums: of `light_sums`, of n pairs, shape (n, 5, 5)
    nominal: what is absorbed by both dyes, and left over by both, shape (3,)
    """
    signs = np.array([-1.0, -1.0, 1.0])
    # Layers that lie on each other say little of each alone; the contrast of both does. So first
    # the one contrast that explains most, each pair having a gain of its own.
    tones = np.concatenate([np.ones((len(_LIFTS), 1)), signs * _tones(nominal)], axis=1)
    model = np.einsum("ta,nab,tb->tn", tones, sums[:, :4, :4], tones)
    product = np.einsum("ta,na->tn", tones, sums[:, :4, 4])
    best = int(np.argmax((product**2 / model).sum(axis=1)))
    gain = product[best] / model[best]
    # Then what is left, as far as it goes beyond what the model may itself be wrong by.
    mean = sums[:, 0, 1:4] / sums[:, 0, :1]
    inner = sums[:, 1:4, 1:4] - sums[:, :1, 1:4] * mean[:, :, None]
    pull = sums[:, 1:4, 4] / gain[:, None] - mean * (sums[:, 0, 4] / gain)[:, None]
    matrix = _OWN_ERRORS * np.einsum("n,nij->ij", gain**2, inner)
    right = _OWN_ERRORS * np.einsum("n,ni->i", gain**2, pull)
    prior = np.eye(3) / _COLOURS_KNOWN**2
    found = np.linalg.solve(matrix + prior, right + prior @ tones[best, 1:])
    return signs * found, gain


def _tones(absorbed: Array) -> Array:
    """What is absorbed, and left over by both, shape (T, 3), under lower and higher contrasts.

    Contrast of a camera, fog and faded dyes all lift or lower the tones of gamma-encoded light.
    """
    a, b, both = absorbed
    left = np.array([1.0 - a, 1.0 - b, 1.0 - a - b + both]) ** (1 / 2.4)
    lift = _LIFTS[:, None]
    x, y, z = (np.maximum((1.0 - lift) * left + lift, 1e-3) ** 2.4).T
    return np.stack([1.0 - x, 1.0 - y, 1.0 - x - y + z], axis=1)


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
    return float(np.median(np.minimum(found.misfit, 1e9)))


def _neighbours(position: Array) -> tuple[Array, NDArray[np.int64]]:
    """Offsets (M, K, 2) [px] and numbers (M, K) of the nearest pairs."""
    count = min(_NEIGHBOURS, len(position) - 1)
    near = np.asarray(KDTree(position).query(position, k=count + 1)[1]).reshape(-1, count + 1)
    near = near[:, 1:].astype(np.int64)
    return position[near] - position[:, None], near
