"""Light of an uneven skin pixel by pixel, also under the markers, from the frames at rest.

The light between the markers gives a smooth ground. Seams, clouds, threads and grain of a skin lie
under markers, too, and show through their dyes: there the light is what the picture shows, over the
share that passes the markers. A sum of smoothed images, from coarse to fine, fills in what is not
known: skin that the camera shows as white, and pairs that no disc explains.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..detection import RestFrame
from .kernels.passing_kernels import passing
from .pair_fit import PairFit, level_variance
from .pair_state import PairFits
from .settings import SkinSettings

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

#: Share of the light above which a pixel shows the skin alone.
_CLEAR = 0.98
#: Lower bounds of light, and of the share that passes the markers.
_DARK, _LITTLE = 1e-4, 0.02


@dataclass(frozen=True, kw_only=True)
class Skin:
    """Errors of M pairs that move over uneven skin, which the frames at rest do not show exactly.

    Attributes
    ----------
    unevenness: standard deviation of the logarithm of the light around each pair, shape (M,)
    width: standard deviation of an edge [px]
    radius: radius of each layer's markers [px], shape (2,)
    settings: tuned parameters
    """

    unevenness: Array
    width: float
    radius: Array
    settings: SkinSettings

    def variances(self, moved: Array) -> Array:
        """Variances of (x, y, log size) of both layers, (M, 6), by motion since rest [px], (M,)."""
        far = self.settings.far * self.width
        place = self.settings.error * self.unevenness * moved / np.hypot(1.0, moved / far)
        both = [[place, place, place / radius] for radius in self.radius]
        return np.stack(both[0] + both[1], axis=-1) ** 2


def is_uneven(fit: PairFit, found: PairFits, rest: RestFrame, settings: SkinSettings) -> bool:
    """Whether the skin between the markers is not as even as its smooth ground.

    Artefacts of colour at edges, of a codec or of the pixels' filters, move with the markers.
    """
    if not found.typical > settings.worse:
        return False
    share, _ = _passing(fit, found, rest, found.state.present)
    between = (share.min(axis=2) > _CLEAR) & (fit.optics.ground[..., 0] > 0.0)
    light = _light(fit, found, rest)
    ratio = np.log(light / np.maximum(fit.optics.ground, _DARK)).mean(axis=2)
    ratio = _mean(ratio[..., None], between, settings.scale)[..., 0][between]
    return bool(np.quantile(abs(ratio - np.median(ratio)), 0.9) > settings.uneven)


def skin_of(fit: PairFit, fits: Array, settings: SkinSettings) -> Skin:
    """Measure the unevenness of the light around the pairs, at parameters (M, 2, 5)."""
    ground, radius = np.minimum(fit.optics.ground, 1.0), float(fit.radius[0])
    skin = ground[..., 0] > 0.0
    log = np.log(np.maximum(ground, _DARK)) * skin[..., None]
    fine = (log - _mean(log, skin, radius / 2.0)) * skin[..., None]
    variance = _mean((fine**2).mean(axis=2)[..., None], skin, radius)[..., 0]
    height, breadth = variance.shape
    x, y = np.rint(fits[:, 0, :2]).astype(int).T
    unevenness = np.sqrt(variance[np.clip(y, 0, height - 1), np.clip(x, 0, breadth - 1)])
    return Skin(
        unevenness=unevenness,
        width=fit.optics.width,
        radius=fit.radius,
        settings=settings,
    )


def skin_light(
    fit: PairFit, found: PairFits, rest: RestFrame, frames: int, edge: float, settings: SkinSettings
) -> Array32:
    """Linear light of the skin without its markers, shape (H, W, 3); 0 off the skin.

    Parameters
    ----------
    fit: fit with the smooth ground
    found: fit to the rest frame
    rest: rest frame, a mean of `frames` frames
    edge: standard deviation of the places of edges [px]
    settings: tuned parameters
    """
    smooth, light = fit.optics.ground, _light(fit, found, rest)
    share, slope = _passing(fit, found, rest, found.state.present)
    unexplained = ~(found.misfit < settings.lost * max(1.0, found.typical))
    lost, _ = _passing(fit, found, rest, found.state.present & unexplained[:, None])
    clear = share.min(axis=2) > _CLEAR
    known = (smooth[..., 0] > 0.0) & (lost.min(axis=2) > _CLEAR)
    share = np.maximum(share, _LITTLE)
    weight = _of_levels(fit.optics_of(found.state).weight, rest)
    ratio = np.log(light / (np.maximum(smooth, _DARK) * share))
    noise = level_variance(fit.noise) / frames + settings.rounding
    variance = noise / (weight * level_variance(fit.noise) * light**2) + (edge * slope / share) ** 2
    white = rest.image >= settings.white
    seen = known[..., None] & ~white
    more = _filled(ratio, seen, variance + settings.least, settings)
    # White skin is at least that bright.
    more = np.where(white & clear[..., None], np.maximum(more, ratio), more)
    return np.where(smooth > 0.0, smooth * np.exp(more), 0.0).astype(np.float32)


def _light(fit: PairFit, found: PairFits, rest: RestFrame) -> Array:
    """Linear light of the rest frame, shape (H, W, 3)."""
    return np.maximum(_of_levels(fit.optics_of(found.state).linear, rest), _DARK)


def _of_levels(table: Array32, rest: RestFrame) -> Array:
    """Values of a table of levels, (3, 256), at the pixels of the rest frame, (H, W, 3)."""
    levels = np.arange(256.0)
    return np.stack([np.interp(rest.image[..., c], levels, table[c]) for c in range(3)], axis=-1)


def _passing(
    fit: PairFit, found: PairFits, rest: RestFrame, present: Mask
) -> tuple[Array32, Array32]:
    """Share of light that passes the present markers, and its change at edges; see `passing`."""
    optics, image = fit.optics_of(found.state), np.rint(rest.image).astype(np.uint8)
    share, slope = np.ones_like(optics.ground), np.zeros_like(optics.ground)
    passing(image, optics, present, found.state.fits, share, slope, fit.buffer)
    return share, slope


def _filled(ratio: Array, seen: Mask, variance: Array, settings: SkinSettings) -> Array:
    """Estimate a logarithm of light (H, W, 3) everywhere from the pixels where it is seen.

    Brightness that all channels share comes first, as weak dyes show it best; then each channel.
    """
    own = settings.own
    weight = seen / (variance + sum(size**2 for size in own[1:]))
    total = weight.sum(axis=2)
    shared = (weight * ratio).sum(axis=2) / np.maximum(total, _DARK)
    brightness = np.zeros_like(total)
    for scale, size in zip(settings.scales, settings.shared, strict=True):
        brightness += _known(shared - brightness, total, scale, size)
    found = np.repeat(brightness[..., None], 3, axis=2)
    for scale, size in zip(settings.scales, own, strict=True):
        found += _known(ratio - found, seen / variance, scale, size)
    return found


def _known(values: Array, weight: Array, scale: float, size: float) -> Array:
    """Weighted mean of values of prior deviation `size` around each pixel, at a scale [px]."""
    return _blurred(weight * values, scale) / (_blurred(weight, scale) + 1.0 / size**2)


def _mean(values: Array, where: Mask, scale: float) -> Array:
    """Mean of values (H, W, …) over the pixels of a mask around each pixel, at a scale [px]."""
    weight = np.maximum(_blurred(where.astype(float), scale), 1e-3)
    return _blurred(values * where[..., None], scale).reshape(values.shape) / weight[..., None]


def _blurred(values: Array, scale: float) -> Array:
    """Gaussian blur of that standard deviation [px]."""
    return np.asarray(cv2.GaussianBlur(values.astype(np.float32), (0, 0), scale))
