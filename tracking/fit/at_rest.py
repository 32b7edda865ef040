"""Fit of the unloaded sensor, from which the tracker starts."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...render import Frame
from ..detection import RestFrame, check_each_layer, read_rest
from ..edge import Edge
from ..palette import Palette
from .compression import flat_blocks
from .kernels.template_kernels import UNEVEN
from .pair_fit import PairFit, prepare_fit
from .pair_state import PairFits, PairState
from .relocate import Relocator
from .settings import FitSettings
from .skin_light import Skin, is_uneven, skin_light, skin_of
from .tuning import sharpened, tune

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Image = NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True)
class AtRest:
    """Fit of the unloaded sensor with M marker pairs; constant until the next reset.

    Attributes
    ----------
    settings: effort per frame, and tuned parameters
    fit: method that fits the pairs
    relocator: method that finds the markers without their last positions
    state: fitted state of the pairs
    misfit: misfit of each pair, see `PairFits`; 0 for a pair without a fit, shape (M,)
    typical: median misfit, at least 1
    odd: pairs that no disc explains; they shade others, but are not tracked, shape (M,)
    pitch: typical distance to the nearest other marker [px]
    shape: shape of an image
    layers: number of layers L, 1 or 2
    share: displacement of the inner layer over that of the outer one; None if unknown
    flat: pixels that show the noise next to the markers, see `flat_blocks`
    edge: edge of the field, for the markers (M, 2)
    skin: unevenness of the skin around each pair; None for an even skin
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
    edge: Edge
    skin: Skin | None

    def lost(self, visible: Mask) -> int:
        """Number of markers that were present at rest and are not visible."""
        return int((~visible & self.state.present & ~self.odd[:, None]).sum())

    def limits(self, fits: PairFits) -> Array:
        """Misfit of each pair above which it counts as lost, shape (M,).

        An imperfect marker, with a large misfit at rest, has a higher limit.
        """
        return np.maximum(misfit_limit(fits, self.settings), UNEVEN * self.misfit)


def fit_rest(
    frames: list[Frame], palette: Palette, noise: float, settings: FitSettings
) -> tuple[AtRest, PairFits]:
    """Fit the unloaded sensor: shapes to the mean of the frames; then average the fits to each.

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
        # Their light would bias that of neighbouring pairs.
        rest = replace(rest, position=rest.position[:, ~stray], shapes=rest.shapes[:, ~stray])
        fit, first = _first_fit(rest, mean, frames[0].image, palette, noise, settings)
    uneven = is_uneven(fit, first, rest, settings.skin)
    if uneven:
        fit, first = _with_skin(fit, first, rest, len(frames), settings)
    # Deviations of these markers from discs count as noise, too.
    own, rounding = settings.rest, 0.29
    while first.typical > own.unexplained and noise < own.noisiest:
        larger = float(np.hypot(noise, rounding) * np.sqrt(first.typical))
        noise = min(own.noisiest, larger)
        fit, first = _first_fit(rest, mean, frames[0].image, palette, noise, settings)
        if uneven:
            fit, first = _with_skin(fit, first, rest, len(frames), settings)
    good = np.asarray(visible_markers(first, settings).any(axis=1))
    if good.sum() < own.least_share * len(good):
        raise UserError(
            f"only {good.sum()} of {len(good)} markers of the rest frame look like markers"
        )
    fit, start = fit.with_shapes_of(first.state)
    fit = fit.with_effort(5, settings.rows, own.arrived)
    # Frames at rest differ by noise only: each pair needs a single template.
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
    skin = skin_of(fit, state.fits, settings.skin) if uneven else None
    return _at_rest(rest, palette, settings, fit, found, flat, skin), found


def _stray(fits: PairFits, settings: FitSettings) -> Mask:
    """Mask (M,) of pairs that are specks or glare: with too little light, or of another size."""
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
    """Fit shapes, colours and light to the mean of the rest frames; `frame` is one of them."""
    fit, start = prepare_fit(rest, palette, noise, settings.pairs)
    first = fit.fit(mean, start, settings.rest.steps)
    # Fit colours now if needed, so that a later fit of colours does not change positions.
    worse, steps = settings.rest.worse, settings.steps
    if first.typical > worse or fit.fit(frame, first.state, steps).typical > worse:
        first = tune(fit, mean, first, first.state.fits, steps, settings.tuning)
    return fit, first


def _with_skin(
    fit: PairFit, first: PairFits, rest: RestFrame, frames: int, settings: FitSettings
) -> tuple[PairFit, PairFits]:
    """Fit shapes, colours and blur in turns with the light of an uneven skin."""
    mean, smooth = np.rint(rest.image).astype(np.uint8), fit
    for turn, edge in enumerate(settings.skin.edges):
        ground = skin_light(smooth, first, rest, frames, edge, settings.skin)
        fit = replace(fit, optics=fit.optics._replace(ground=ground))
        start = replace(first.state, gains=np.ones_like(first.state.gains)).unsloped()
        first = fit.fit(mean, start, settings.rest.steps)
        if turn == 0:
            first = tune(fit, mean, first, first.state.fits, settings.steps, settings.tuning)
        first = sharpened(fit, mean, first, settings.steps, settings.tuning)
    return fit, first


def _at_rest(
    rest: RestFrame,
    palette: Palette,
    settings: FitSettings,
    fit: PairFit,
    found: PairFits,
    flat: NDArray[np.intp],
    skin: Skin | None,
) -> AtRest:
    """Collect the results of the fit at rest."""
    visible = visible_markers(found, settings)
    check_each_layer(visible.T[: len(palette.names)], palette)
    sensor = palette.sensor
    return AtRest(
        settings=settings,
        fit=fit,
        relocator=Relocator(rest, palette, settings.relocation),
        state=found.state,
        misfit=np.where(np.isfinite(found.misfit), found.misfit, 0.0),
        typical=max(1.0, found.typical),
        odd=np.isfinite(found.misfit) & ~visible.any(axis=1),
        pitch=rest.pitch,
        shape=rest.image.shape,
        layers=len(palette.names),
        share=sensor.follow[1] / sensor.follow[0] if sensor and sensor.yellow else None,
        flat=flat,
        edge=Edge.of_rest(rest, palette, found.state.fits[..., :2]),
        skin=skin,
    )


def misfit_limit(fits: PairFits, settings: FitSettings) -> float:
    """Misfit above which a pair counts as lost."""
    return settings.lost * min(max(1.0, fits.typical), settings.worst)


def visible_markers(fits: PairFits, settings: FitSettings) -> Mask:
    """Mask (M, 2) of the markers whose fit explains their pixels."""
    explained = fits.misfit < misfit_limit(fits, settings)
    return np.asarray(explained[:, None] & fits.state.present)
