"""The unloaded sensor as the tracker fits it, and the settings that it fits with."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...render import Frame
from ..detection import RestFrame, read_rest
from ..palette import Palette
from .compression import flat_blocks
from .kernels.template_kernels import UNEVEN
from .pair_fit import PairFit, prepare_fit
from .pair_state import PairFits, PairState
from .relocate import Relocator
from .tuning import tune

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Image = NDArray[np.uint8]

#: Steps of a fit to a frame, at most.
STEPS = 6
#: Steps of the first fit to the rest frames, at most.
_REST_STEPS = 24
#: A pair whose step moves no edge by more than this has converged [px].
_ARRIVED = 0.05
#: A median misfit above this has the colours and the blur fitted as well.
WORSE = 1.1
#: The same at rest: so far below that no noise lifts a later frame from one to the other.
_WORSE_AT_REST = 1.04
#: A typical misfit above this at rest says that the shapes are no discs, or the noise is larger.
_UNEXPLAINED = 4.0
#: Noise that is believed then, at most [grey levels].
_NOISIEST = 16.0
#: Standard deviation of rounding [grey levels].
_ROUNDING = 0.29
#: A pair that no fit is found for is no marker where its light is below this share of the typical,
_NO_LIGHT = 0.2
#: … or where the logarithm of its size over the typical is larger than this.
_ODD_SIZE = 0.4
#: Share of the rest frame's pairs that must look like markers.
_AT_REST = 0.7
#: A pair whose misfit is this many times the typical one is not a marker.
_LOST = 6.0
#: The typical misfit counts as no more than this.
_WORST = 20.0


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """Effort that the tracker spends on a frame.

    Attributes
    ----------
    rows: every `rows`-th row of the image is read
    limit: motion of an edge after which the template of its pair is made anew [px]
    """

    rows: int = 1
    limit: float = 0.07


@dataclass(frozen=True, kw_only=True)
class AtRest:
    """The unloaded sensor as the tracker fitted it. It stays as it is until the next reset.

    Attributes
    ----------
    settings: effort of a frame
    fit: of its pairs
    relocator: finds the markers without knowing where they were
    state: of the pairs
    misfit: of the pairs, 0 where none was found, shape (M,)
    typical: median misfit, at least 1
    odd: pairs that no disc explains; they shade others, and are not looked for, shape (M,)
    pitch: typical distance to the nearest other marker [px]
    shape: of an image
    layers: L, 1 or 2
    share: displacement of the inner layer over that of the outer one; None if it is not known
    flat: pixels that show the noise beside the markers, see `flat_blocks`
    """

    settings: FitSettings
    fit: PairFit
    relocator: Relocator
    state: PairState
    misfit: Array
    typical: float
    odd: Mask
    pitch: float
    shape: tuple[int, ...]
    layers: int
    share: float | None
    flat: NDArray[np.intp]

    def lost(self, visible: Mask) -> int:
        """Number of markers that were there at rest and are not visible."""
        return int((~visible & self.state.present & ~self.odd[:, None]).sum())

    def limits(self, fits: PairFits) -> Array:
        """Largest misfit of each pair that is there, shape (M,).

        What a crooked marker has at rest, near the limit of all, it has later too.
        """
        return np.maximum(misfit_limit(fits), UNEVEN * self.misfit)


def fit_rest(
    frames: list[Frame], palette: Palette, noise: float, settings: FitSettings
) -> tuple[AtRest, PairFits]:
    """Fit the unloaded sensor: shapes to the mean of the frames, then the mean of all fits.

    Raises
    ------
    UserError
        When there is no frame, or it does not show the sensor's markers.
    """
    rest = read_rest(frames, palette)
    mean = np.rint(rest.image).astype(np.uint8)
    fit, first = _first_fit(rest, mean, frames[0].image, palette, noise)
    stray = _stray(first)
    if stray.any() and not stray.all():
        # Their light would be carried over to the pairs beside them.
        rest = replace(rest, position=rest.position[:, ~stray])
        fit, first = _first_fit(rest, mean, frames[0].image, palette, noise)
    # What discs do not explain of these markers is noise too.
    while first.typical > _UNEXPLAINED and noise < _NOISIEST:
        noise = min(_NOISIEST, float(np.hypot(noise, _ROUNDING) * np.sqrt(first.typical)))
        fit, first = _first_fit(rest, mean, frames[0].image, palette, noise)
    good = np.asarray(visible_markers(first).any(axis=1))
    if good.sum() < _AT_REST * len(good):
        raise UserError(
            f"only {good.sum()} of {len(good)} markers of the rest frame look like markers"
        )
    fit, start = fit.with_shapes_of(first.state)
    fit = fit.with_effort(5, settings.rows, _ARRIVED)
    # Frames of one state differ by their noise alone: each pair needs one template for all.
    pool, calm = fit.empty_templates(), np.ones(len(start.fits), dtype=np.bool_)
    fits = [
        fit.follow(np.ascontiguousarray(frame.image), start, calm, settings.limit, pool, STEPS)
        for frame in frames
    ]
    state = replace(
        start,
        fits=np.mean([each.state.fits for each in fits], axis=0),
        gains=np.mean([each.state.gains for each in fits], axis=0),
    )
    misfit = np.mean([each.misfit for each in fits], axis=0)
    covariance = np.mean([each.covariance for each in fits], axis=0) / len(frames)
    found = PairFits(state, misfit, covariance)
    return _at_rest(rest, palette, settings, fit, found, flat_blocks(frames)), found


def _stray(fits: PairFits) -> Mask:
    """Pairs (M,) that are specks or glare: without light of their own, or of another size."""
    gains, size = fits.state.gains, fits.state.fits[:, :, 2]
    dark = (gains < _NO_LIGHT * np.median(gains, axis=0)).any(axis=1)
    odd = (abs(size) > _ODD_SIZE) & fits.state.present
    return np.asarray(~np.isfinite(fits.misfit) & (dark | odd.any(axis=1)))


def _first_fit(
    rest: RestFrame, mean: Image, frame: Image, palette: Palette, noise: float
) -> tuple[PairFit, PairFits]:
    """Fit of shapes, colours and light to the mean of the rest frames, one of which is `frame`."""
    fit, start = prepare_fit(rest, palette, noise)
    first = fit.fit(mean, start, _REST_STEPS)
    # A later frame in which the light is fitted must not differ from rest by that alone.
    if (
        first.typical > _WORSE_AT_REST
        or fit.fit(frame, first.state, STEPS).typical > _WORSE_AT_REST
    ):
        first = tune(fit, mean, first, first.state.fits, STEPS)
    return fit, first


def _at_rest(
    rest: RestFrame,
    palette: Palette,
    settings: FitSettings,
    fit: PairFit,
    found: PairFits,
    flat: NDArray[np.intp],
) -> AtRest:
    sensor = palette.sensor
    return AtRest(
        settings=settings,
        fit=fit,
        relocator=Relocator(rest, palette),
        state=found.state,
        misfit=np.where(np.isfinite(found.misfit), found.misfit, 0.0),
        typical=max(1.0, found.typical),
        odd=np.isfinite(found.misfit) & ~visible_markers(found).any(axis=1),
        pitch=rest.pitch,
        shape=rest.image.shape,
        layers=len(palette.names),
        share=None if sensor is None else sensor.follow[-1] / sensor.follow[0],
        flat=flat,
    )


def misfit_limit(fits: PairFits) -> float:
    """Largest misfit of a pair that is there."""
    return _LOST * min(max(1.0, fits.typical), _WORST)


def visible_markers(fits: PairFits) -> Mask:
    """Layers whose fit explains their pixels, shape (M, 2)."""
    explained = fits.misfit < misfit_limit(fits)
    return np.asarray(explained[:, None] & fits.state.present)
