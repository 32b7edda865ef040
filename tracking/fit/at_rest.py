"""The unloaded sensor as the tracker fits it."""

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
from .settings import FitSettings
from .tuning import tune

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Image = NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True)
class AtRest:
    """The unloaded sensor as the tracker fitted it. It stays as it is until the next reset.

    Attributes
    ----------
    settings: effort of a frame, and tuned numbers
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
    flat: pixels that show the noise next to the markers, see `flat_blocks`
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
        return np.maximum(misfit_limit(fits, self.settings), UNEVEN * self.misfit)


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
    fit, first = _first_fit(rest, mean, frames[0].image, palette, noise, settings)
    stray = _stray(first, settings)
    if stray.any() and not stray.all():
        # Their light would be carried over to the pairs beside them.
        rest = replace(rest, position=rest.position[:, ~stray])
        fit, first = _first_fit(rest, mean, frames[0].image, palette, noise, settings)
    # Parts of these markers that discs do not explain are noise, too.
    own, rounding = settings.rest, 0.29
    while first.typical > own.unexplained and noise < own.noisiest:
        larger = float(np.hypot(noise, rounding) * np.sqrt(first.typical))
        noise = min(own.noisiest, larger)
        fit, first = _first_fit(rest, mean, frames[0].image, palette, noise, settings)
    good = np.asarray(visible_markers(first, settings).any(axis=1))
    if good.sum() < own.least_share * len(good):
        raise UserError(
            f"only {good.sum()} of {len(good)} markers of the rest frame look like markers"
        )
    fit, start = fit.with_shapes_of(first.state)
    fit = fit.with_effort(5, settings.rows, own.arrived)
    # Frames of one state differ by their noise alone: each pair needs one template for all.
    pool, calm = fit.empty_templates(), np.ones(len(start.fits), dtype=np.bool_)
    limit, steps = settings.limit, settings.steps
    fits = [
        fit.follow(np.ascontiguousarray(frame.image), start, calm, limit, pool, steps)
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
    flat = flat_blocks(frames, settings.compression)
    return _at_rest(rest, palette, settings, fit, found, flat), found


def _stray(fits: PairFits, settings: FitSettings) -> Mask:
    """Pairs (M,) that are specks or glare: without light of their own, or of another size."""
    gains, size = fits.state.gains, fits.state.fits[:, :, 2]
    dark = (gains < settings.rest.no_light * np.median(gains, axis=0)).any(axis=1)
    odd = (abs(size) > settings.rest.odd_size) & fits.state.present
    return np.asarray(~np.isfinite(fits.misfit) & (dark | odd.any(axis=1)))


def _first_fit(
    rest: RestFrame,
    mean: Image,
    frame: Image,
    palette: Palette,
    noise: float,
    settings: FitSettings,
) -> tuple[PairFit, PairFits]:
    """Fit of shapes, colours and light to the mean of the rest frames, one of which is `frame`."""
    fit, start = prepare_fit(rest, palette, noise, settings.pairs)
    first = fit.fit(mean, start, settings.rest.steps)
    # A later frame in which the light is fitted must not differ from rest by that alone.
    worse, steps = settings.rest.worse, settings.steps
    if first.typical > worse or fit.fit(frame, first.state, steps).typical > worse:
        first = tune(fit, mean, first, first.state.fits, steps, settings.tuning)
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
        relocator=Relocator(rest, palette, settings.relocation),
        state=found.state,
        misfit=np.where(np.isfinite(found.misfit), found.misfit, 0.0),
        typical=max(1.0, found.typical),
        odd=np.isfinite(found.misfit) & ~visible_markers(found, settings).any(axis=1),
        pitch=rest.pitch,
        shape=rest.image.shape,
        layers=len(palette.names),
        share=None if sensor is None else sensor.follow[-1] / sensor.follow[0],
        flat=flat,
    )


def misfit_limit(fits: PairFits, settings: FitSettings) -> float:
    """Largest misfit of a pair that is there."""
    return settings.lost * min(max(1.0, fits.typical), settings.worst)


def visible_markers(fits: PairFits, settings: FitSettings) -> Mask:
    """Layers whose fit explains their pixels, shape (M, 2)."""
    explained = fits.misfit < misfit_limit(fits, settings)
    return np.asarray(explained[:, None] & fits.state.present)
