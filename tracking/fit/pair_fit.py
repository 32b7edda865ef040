"""Fit of every marker pair of one sensor to an image.

Known shapes are fitted under the local light. Each pair has its own gain in each channel; the slope
of the gain across the pair follows from its neighbours. Colours and blur are given here; `tuning`
fits them.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from ...render import decode_srgb
from ...render.drawing import edge_width
from ..detection import RestFrame, neighbours
from ..palette import Palette
from .kernels.neighbour_kernels import lying, median
from .kernels.pair_kernels import converge, fit_step, mean_hues
from .kernels.pixel_kernels import BUFFER, TERMS, Optics, extents_of
from .kernels.template_kernels import SLOPED, UNEVEN, Around, Pool, follow, settle, stale
from .pair_state import PairFits, PairState, chosen
from .settings import PairSettings
from .templates import NO_TEMPLATES, empty_templates

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

#: Black level of each channel, without fog or stray light.
_NO_LIFT = (0.0, 0.0, 0.0)


def level_variance(noise: float) -> float:
    """Variance of a level by rounding and by noise of a standard deviation [grey levels]."""
    return noise**2 + 1.0 / 12.0


@lru_cache(maxsize=64)
def level_tables(black: tuple[float, ...], noise: float) -> tuple[Array32, Array32]:
    """Linear light of each sRGB level, and its inverse variance, by channel, both (3, 256).

    Low camera contrast, fog or faded dyes raise the dark levels. Subtracting the black level
    restores the light up to a gain, which is fitted anyway.

    Parameters
    ----------
    black: black level of each channel, which means no light
    noise: standard deviation of the camera noise [grey levels]; rounding is added to it
    """
    lowest = np.array(black)[:, None]
    levels = (np.arange(256.0) - lowest) * (255.0 / (255.0 - lowest))
    # Below black the curve continues as a line.
    linear = np.where(levels > 0.0, decode_srgb(np.maximum(levels, 0.0)), levels / 255.0 / 12.92)
    weight = 1.0 / (np.gradient(linear, axis=1) ** 2 * level_variance(noise))
    return linear.astype(np.float32), weight.astype(np.float32)


def prepare_fit(
    rest: RestFrame, palette: Palette, noise: float, settings: PairSettings
) -> tuple["PairFit", PairState]:
    """Make the fit of a sensor's pairs with nominal shapes and colours, and its start state.

    Parameters
    ----------
    rest: rest frame with one layer or two
    palette: colours of the markers
    noise: standard deviation of the camera noise [grey levels]; rounding is added to it
    """
    linear, weight = level_tables(_NO_LIFT, noise)
    layers, count, _ = rest.position.shape
    nominal = np.zeros((3, 3))
    nominal[:layers] = 1.0 - palette.transmittance
    nominal[2] = nominal[0] * nominal[1]
    position = np.full((2, count, 2), np.nan)
    position[:layers] = rest.position
    radius = np.append(rest.radius, rest.radius[-1:])[:2]
    radii = np.append(rest.radii, rest.radii[-1:], axis=0)[:2]
    middle = np.nanmean(position, axis=0)
    near = neighbours(middle, settings.near)
    optics = Optics(
        linear=linear,
        weight=weight,
        black=np.array(_NO_LIFT, dtype=np.float32),
        variance=np.float32(level_variance(noise)),
        ground=rest.ground.astype(np.float32),
        absorbed=nominal.astype(np.float32),
        shapes=radii[:, :, None, None] * np.eye(2),
        neighbours=neighbours(middle, settings.overlapping),
        width=edge_width(settings.first_blur),
        reach=settings.reach,
    )
    fit = PairFit(
        optics=optics,
        nominal=nominal,
        noise=noise,
        radius=radius,
        largest=float(radii.max()),
        near=near,
        to_slope=_slope_matrices(middle, near),
        buffer=np.zeros(BUFFER, dtype=np.float32),
        settings=settings,
    )
    fits = np.zeros((count, 2, 5))
    # A layer without a marker here still needs a position.
    fits[:, :, :2] = np.where(np.isnan(position), middle, position).swapaxes(0, 1)
    return fit, PairState(
        fits=fits,
        present=np.isfinite(position[:, :, 0]).T,
        gains=np.ones((count, 3)),
        slopes=np.zeros((count, TERMS)),
        absorbed=optics.absorbed,
        width=optics.width,
        black=_NO_LIFT,
    )


def _slope_matrices(middle: Array, near: NDArray[np.int64]) -> Array:
    """Matrices from differences of log gain, K neighbours minus own, to the gain's slope [1/px].

    It is the slope of a plane fitted to them by least squares, shape (M, 2, K).
    """
    offsets = middle[near] - middle[:, None]
    centred = offsets - offsets.sum(axis=1, keepdims=True) / (offsets.shape[1] + 1)
    own = -offsets.sum(axis=1) / (offsets.shape[1] + 1)
    square = np.einsum("mki,mkj->mij", centred, centred) + own[:, :, None] * own[:, None]
    return np.linalg.solve(square, np.swapaxes(centred, 1, 2))


@dataclass(frozen=True, kw_only=True)
class PairFit:
    """Fits the M pairs of a rest frame to other frames; made by `prepare_fit`.

    Attributes
    ----------
    optics: constants of the pixel model, with nominal colours and blur
    nominal: nominal a₀, a₁ and b (rows) of each channel, see `fit`, shape (3, 3)
    noise: standard deviation of the camera noise [grey levels]
    radius: radius of each layer's markers at rest [px], shape (2,)
    largest: largest radius of markers [px]
    near: indices of the K pairs next to each pair, shape (M, K)
    to_slope: matrices of `_slope_matrices`, shape (M, 2, K)
    buffer: working memory of the kernels, shape (BUFFER,)
    free: number of fitted parameters per marker: all 5, or 2 for the position alone
    rows: every `rows`-th row of the image is read
    arrived: largest motion of an edge in the step of a converged pair [px]
    settings: tuned parameters
    """

    optics: Optics
    nominal: Array
    noise: float
    radius: Array
    largest: float
    near: NDArray[np.int64]
    to_slope: Array
    buffer: Array32
    settings: PairSettings
    free: int = 5
    rows: int = 1
    arrived: float = 0.0

    def with_effort(self, free: int, rows: int, arrived: float) -> "PairFit":
        """Copy with another effort; see the attributes of these names."""
        optics = self.optics._replace(reach=self.settings.close) if free == 2 else self.optics
        return replace(self, optics=optics, free=free, rows=rows, arrived=arrived)

    def with_shapes_of(self, state: PairState) -> tuple["PairFit", PairState]:
        """Copy with a state's shapes as nominal ones; also return the state relative to them."""
        size = np.exp(state.fits[..., 2])[..., None, None]
        p, q = state.fits[..., 3], state.fits[..., 4]
        strain = np.stack([np.stack([1 + p, q], -1), np.stack([q, 1 - p], -1)], axis=-2)
        shapes = np.swapaxes(size * strain, 0, 1) @ self.optics.shapes
        unstrained = state.fits.copy()
        unstrained[..., 2:] = 0.0
        optics = self.optics._replace(shapes=shapes)
        return replace(self, optics=optics), replace(state, fits=unstrained)

    def empty_templates(self) -> Pool:
        """Allocate templates for all pairs."""
        radius = self.largest + self.optics.reach * self.optics.width
        pairs, neighbours = self.optics.neighbours.shape
        return empty_templates(pairs, neighbours, radius, self.rows)

    def fit(self, image: Image, start: PairState, steps: int) -> PairFits:
        """Fit all pairs to an image, from a start state, in at most `steps` steps."""
        work = self._work(image, _unknown(start.copied()))
        work.state.slopes[:, 2:] = 0.0
        self._step(work, np.ones(len(start.fits), dtype=np.bool_), steps)
        return work.fits()

    def follow(
        self, image: Image, start: PairState, calm: Mask, limit: float, pool: Pool, steps: int
    ) -> PairFits:
        """Fit all pairs to an image, by their templates where these are good enough.

        Parameters
        ----------
        image: image to fit
        start: expected state of the pairs
        calm: pairs whose bad templates are replaced, shape (M,); a template does not pay for a pair
            that keeps moving
        limit: largest motion of an edge since its template was made [px]
        pool: templates, changed in place
        steps: largest number of steps of a fit without template
        """
        seen, near = _unknown(start.copied()), self.optics.neighbours
        work, state = self._work(image, seen, pool, calm), seen.state
        active = np.empty(len(calm), dtype=np.bool_)
        follow(
            image, work.optics, self.around, self.radius[0], limit, pool, state.present, state.fits,
            state.gains, state.slopes, seen.misfit, seen.covariance, active,
        )  # fmt: skip
        waiting = active
        while waiting.any():
            state.slopes[waiting, 2:] = 0.0
            seen.misfit[waiting] = np.inf
            self._step(work, waiting, steps)
            before = active.copy()
            stale(near, self.around, limit, pool, state.fits, state.gains, active)
            waiting = active & ~before
        if active.any():
            settle(
                work.optics, self.around, state.present, pool, state.fits, state.gains,
                state.slopes, seen.misfit, work.extents, active,
            )  # fmt: skip
        return seen

    def fit_apart(
        self,
        image: Image,
        fits: PairFits,
        start: PairState,
        tried: Mask,
        limit: Array,
        steps: int,
    ) -> PairFits:
        """Fit pairs with too large a misfit again, with each layer alone, then with both.

        A layer that turns out to be missing does not shade its neighbours, which are fitted again.

        Parameters
        ----------
        tried: pairs that are fitted again, shape (M,); others with too large a misfit count as lost
        limit: largest misfit of each pair, shape (M,)
        """
        bad = fits.misfit > limit
        state = fits.state.copied()
        state.present[bad] = False
        covariance, misfit = fits.covariance.copy(), np.where(bad, np.inf, fits.misfit)
        for layers in ([True, False], [False, True], [True, True]):
            active = tried & (misfit > limit) & (start.present >= layers).all(axis=1)
            if not active.any():
                continue
            work = self._work(image, PairFits(state.copied(), misfit.copy(), covariance))
            work.state.present[active] = layers
            for ours, theirs in ((work.state.fits, start.fits), (work.state.gains, start.gains),
                                 (work.state.slopes, start.slopes)):  # fmt: skip
                ours[active] = theirs[active]
            self._step(work, active, steps)
            explained = active & (work.misfit < limit)
            state = chosen(explained, work.state, state)
            misfit = np.where(explained, work.misfit, misfit)
        work = self._work(image, PairFits(state, misfit, covariance))
        shaded = misfit > UNEVEN * max(1.0, median(misfit))
        self._step(work, shaded & np.isfinite(misfit), steps)
        return work.fits()

    @cached_property
    def around(self) -> Around:
        """Neighbours of each pair, as the kernels take them."""
        return Around(self.near, self.to_slope)

    @cached_property
    def crowded_radii(self) -> Array:
        """Distances at which markers may be confused, and touch (rows), by layer [px], (2, 2)."""
        return np.outer([self.settings.crowded, self.settings.touching], self.radius)

    @cached_property
    def touching_radii(self) -> Array:
        """Distances at which markers share light, and touch (rows), by layer [px], (2, 2)."""
        return np.outer([self.settings.beside, self.settings.touching], self.radius)

    def hues(self, image: Image, fits: Array) -> Array:
        """Mean hue inside each marker of the first layer [°], shape (M,)."""
        return np.asarray(mean_hues(image, self.optics.shapes, fits))

    def optics_of(self, state: PairState) -> Optics:
        """Optics with the colours, the blur and the black level of a state."""
        linear, weight = level_tables(state.black, self.noise)
        return self.optics._replace(
            linear=linear,
            weight=weight,
            black=np.array(state.black, dtype=np.float32),
            absorbed=state.absorbed,
            width=state.width,
        )

    def _work(
        self, image: Image, known: PairFits, pool: Pool = NO_TEMPLATES, kept: Mask | None = None
    ) -> "_Work":
        """Make the arrays of a fit; those of `known` are changed in place."""
        if kept is None:
            kept = np.zeros(len(known.misfit), dtype=np.bool_)
        return _Work(
            fit=self,
            image=image,
            optics=self.optics_of(known.state),
            state=known.state,
            moved=np.zeros(len(known.misfit)),
            covariance=known.covariance,
            misfit=known.misfit,
            kept=kept,
            pool=pool,
        )

    def _step(self, work: "_Work", wanted: Mask, steps: int) -> None:
        """Step the wanted pairs, shape (M,), until they have converged."""
        state = work.state
        # Pairs that touch may still be far from their final position.
        near, touching = self._lying(state)
        beside = near & ~touching
        converge(
            work.image, work.optics, self.around, wanted, state.present, beside, work.kept,
            self.free, self.rows, steps, self.arrived, SLOPED, state.fits, state.gains,
            state.slopes, work.moved, work.covariance, work.misfit, work.pool, self.buffer,
        )  # fmt: skip
        near, touching = self._lying(state)
        touching |= near & ~beside
        beside = self._refine(work, wanted & touching & np.isfinite(work.misfit), beside)
        # Pairs with a large misfit may lie at the edge of a shadow.
        typical = max(1.0, median(work.misfit))
        uneven = wanted & np.isfinite(work.misfit) & (work.misfit > UNEVEN * typical)
        active = uneven
        for turn in range(self.settings.uneven_steps):
            if not active.any():
                break
            work.step(active, uneven, beside)
            # The misfit after a step is known at the next one.
            active = active & np.isfinite(work.misfit) & ((work.moved > self.arrived) | (turn == 0))
        work.misfit[wanted & (work.moved > max(self.arrived, self.settings.nearly))] = np.inf

    def _refine(self, work: "_Work", refined: Mask, beside: Mask) -> Mask:
        """Make more steps for pairs that touch; return the pairs that share light at their edges.

        Each is fitted with the others at their last positions, so that they converge slowly.
        """
        settings = self.settings
        if not refined.any():
            return beside
        state = work.state
        even = np.zeros(len(refined), dtype=np.bool_)
        results = (state.fits, state.gains, state.slopes, work.misfit, work.covariance, work.moved)
        before = [values[refined] for values in results]
        beside = beside | refined
        active = refined
        for _ in range(settings.touching_steps):
            if not active.any():
                break
            work.step(active, even, beside)
            on = work.moved > settings.smaller * self.arrived
            active = active & np.isfinite(work.misfit) & on
        worse = ~(work.misfit[refined] < settings.worse * before[3])
        back = np.flatnonzero(refined)[worse]
        for values, kept in zip(results, before, strict=True):
            values[back] = kept[worse]
        if work.pool is not NO_TEMPLATES:
            work.pool.counts[back, 0] = 0
        beside[back] = False
        return beside

    def _lying(self, state: PairState) -> tuple[Mask, Mask]:
        """Masks (M,) of pairs whose markers share light with others of a layer, or touch them."""
        near, touching = lying(
            state.fits, state.present, self.optics.neighbours, self.touching_radii
        )
        return near, touching


@dataclass(frozen=True, kw_only=True)
class _Work:
    """Arrays that one fit changes in place.

    Attributes
    ----------
    fit, image, optics: method, image and constants of the pixel model
    state, covariance, misfit: as in `PairFits`
    moved: last step of each pair [px], shape (M,)
    kept: pairs whose templates are replaced, shape (M,)
    pool: templates
    """

    fit: PairFit
    image: Image
    optics: Optics
    state: PairState
    moved: Array
    covariance: Array
    misfit: Array
    kept: Mask
    pool: Pool

    @cached_property
    def extents(self) -> Array:
        """Approximate largest distance of each marker's edge from its centre [px], (M, 2)."""
        return np.asarray(extents_of(self.optics, self.state.fits))

    def step(self, active: Mask, uneven: Mask, beside: Mask) -> None:
        """Make one step of the active pairs; see `fit_step`."""
        fit, state = self.fit, self.state
        fit_step(
            self.image, self.optics, self.extents, active, state.present, uneven, beside,
            self.kept, fit.free, fit.rows, state.fits, state.gains, state.slopes, self.moved,
            self.covariance, self.misfit, self.pool, fit.buffer,
        )  # fmt: skip

    def fits(self) -> PairFits:
        """Result of the fit so far."""
        return PairFits(self.state, self.misfit, self.covariance)


def _unknown(state: PairState) -> PairFits:
    """Result without a fit yet: infinite misfit and NaN covariance."""
    count = len(state.fits)
    return PairFits(state, np.full(count, np.inf), np.full((count, 9, 9), np.nan))
