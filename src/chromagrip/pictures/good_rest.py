"""Rest frames that are unlike the others: black, torn, blurred, half covered or moved ones.

Blocks of each frame are compared with those of the median of the frames, in a band of scales that
shows the edges of markers, and neither slow shades nor single pixels.
"""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..stored_pictures import Image

Single = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class RestSettings:
    """How unlike the others a rest frame may be.

    Attributes
    ----------
    side: longer side to which pictures are reduced, by a whole factor [px]
    blocks: number of blocks along it; none is smaller than `least_block` [px]
    most: largest number of frames that the median is made of
    above_noise: energy of a block over that of its noise, from which it is compared
    residual: energy of a block's difference over that of the median, above which it differs
    shift: of a block, above which it differs; a linear fit reads a true one of 1.8 as 1.4 [px]
    power: energy of most blocks over that of the median, below which a frame is blurred
    light: over that of the median, below which a frame is darker, or brighter if it is more than
        the inverse
    details: over those of noise, below which a frame may be empty, and over those of the best
        frame in the same measure
    share, least: share of the blocks that differ in a frame that is left out, and their number
    black: mean level below which an empty frame is black
    """

    side: int = 640
    blocks: int = 16
    least_block: int = 12
    most: int = 31
    above_noise: float = 40.0
    residual: float = 0.5
    shift: float = 1.4
    power: float = 0.7
    light: float = 0.5
    details: tuple[float, float] = (3.0, 0.5)
    share: float = 0.05
    least: int = 2
    black: float = 16.0


def unlike(
    images: list[Image], field: Mask | None = None, settings: RestSettings = RestSettings()
) -> dict[int, str]:
    """Say of each frame that is unlike most others what is wrong with it, by its number.

    Parameters
    ----------
    images: frames of a sensor at rest, of one size, shape (H, W, 3) each
    field: pixels that are compared, shape (H, W); by default all
    settings: see `RestSettings`
    """
    height, width = images[0].shape[:2]
    factor = math.ceil(max(height, width) / settings.side)
    size = (width // factor, height // factor)
    area = cv2.INTER_AREA
    if len(images) < 2 or min(size) < settings.least_block:
        return {}
    small = [np.asarray(cv2.resize(i, size, interpolation=area), np.uint8) for i in images]
    inside = np.ones(size[::-1], np.float32)
    if field is not None:
        inside = np.asarray(cv2.resize(field.astype(np.float32), size), np.float32)
    noise = float(np.median([_noise(image) for image in small]))
    found = _empty(small, settings)
    shown = {k: image for k, image in enumerate(small) if k not in found}
    if not shown:
        return {}  # what looks for markers refuses them
    best = list(shown)
    for _ in range(2):  # the second median is that of the most alike, of equals the earlier ones
        some = [shown[k] for k in best[:: math.ceil(len(best) / settings.most)]]
        compare = _Comparison(median(some).astype(np.float32), inside, noise, settings)
        judged = {k: compare(image.astype(np.float32)) for k, image in shown.items()}
        if not any(word for word, _ in judged.values()):
            break
        best = sorted(shown, key=lambda k: round(judged[k][1], 1))[: len(shown) // 2 + 1]
    found |= {k: word for k, (word, _) in judged.items() if word}
    return dict(sorted(found.items()))


class _Comparison:
    """Compares frames with their median, in blocks.

    Parameters
    ----------
    median: of the frames, shape (H, W, 3)
    inside: share of each pixel that is compared, shape (H, W)
    noise: of a frame [grey levels]
    settings: see `RestSettings`
    """

    def __init__(
        self, median: Single, inside: Single, noise: float, settings: RestSettings
    ) -> None:
        self._settings = settings
        self._side = max(settings.least_block, max(median.shape[:2]) // settings.blocks)
        self._band, self._light = _band(median), self._sums(median)
        x, y = self._slopes = (np.gradient(self._band, axis=1), np.gradient(self._band, axis=0))
        xx, xy, yy = self._sums(x * x), self._sums(x * y), self._sums(y * y)
        # Along a straight edge no motion is seen, and none is read.
        little = 0.05 * (xx + yy) + 1e-3
        xx, yy = xx + little, yy + little
        self._inverse = np.stack([yy, -xy, xx]) / (xx * yy - xy**2)
        self._energy = self._sums(self._band**2)
        of_noise = _BAND_GAIN * noise**2 * 3 * self._side**2
        within = self._sums(inside[..., None]) > 0.5 * self._side**2
        self._compared = within & (self._energy > settings.above_noise * of_noise)

    def __call__(self, image: Single) -> tuple[str, float]:
        """What is wrong with a frame, empty if nothing is, and how unlike the median it is."""
        wanted, limits = self._compared, self._settings
        if wanted.sum() < limits.least:
            return "", 0.0
        gain = float(np.median((self._sums(image) / (self._light + 1.0))[wanted]))
        if not limits.light < gain < 1.0 / limits.light:
            return "darker" if gain < 1.0 else "brighter", 1.0
        band = _band(image) / gain
        if np.quantile((self._sums(band**2) / self._energy)[wanted], 0.75) < limits.power:
            return "blurred", 1.0
        rest = band - self._band
        x, y = (self._sums(slope * rest) for slope in self._slopes)
        a, b, c = self._inverse
        moved = np.hypot(a * x + b * y, b * x + c * y) > limits.shift
        moved |= self._sums(rest**2) > limits.residual * self._energy
        share = float(moved[wanted].mean())
        if share <= limits.share or moved[wanted].sum() < limits.least:
            return "", share
        return f"moved, covered or torn in {share:.0%} of it", share

    def _sums(self, values: NDArray[Any]) -> Single:
        """Sums over blocks, and over channels, of an array (H, W) or (H, W, C)."""
        side = self._side
        rows, columns = values.shape[0] // side, values.shape[1] // side
        parts = values[: rows * side, : columns * side].reshape(rows, side, columns, side, -1)
        return np.asarray(parts.sum(axis=(1, 3, 4)), np.float32)


#: Variance of white noise in the band over that before.
_BAND_GAIN = 0.08


def _band(image: Single) -> Single:
    """Details of a picture between single pixels and slow shades."""
    fine, coarse, factor = 1.0, 1.5, 4  # standard deviations [px], the second in a reduced picture
    size = image.shape[1::-1]
    small = cv2.resize(image, tuple(side // factor for side in size), interpolation=cv2.INTER_AREA)
    shade = cv2.resize(cv2.GaussianBlur(small, (0, 0), coarse), size)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), fine) - shade, np.float32)


def median(images: list[Image]) -> Image:
    """Median of each pixel, by sorting neighbours in turn, which is fast for few frames."""
    rows = list(images)
    for turn in range(len(rows)):
        for k in range(turn % 2, len(rows) - 1, 2):
            rows[k : k + 2] = np.minimum(*rows[k : k + 2]), np.maximum(*rows[k : k + 2])
    middle = (len(rows) - 1) // 2, len(rows) // 2
    return np.mean([rows[k] for k in middle], axis=0).astype(np.uint8)


def _noise(image: Image) -> float:
    """Noise of a frame by its second differences, and at least that of rounding [grey levels]."""
    mask = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]]) / 6.0
    curved = cv2.filter2D(image, cv2.CV_32F, mask)[::3, ::3]  # as many as are needed
    return max(0.3, float(np.median(abs(curved))) / 0.6745)


def _empty(images: list[Image], settings: RestSettings) -> dict[int, str]:
    """Frames that show nothing beside noise, unless the others do not show much more."""
    share = 0.98  # quantile of the details that is compared
    bands = (_band(image.astype(np.float32))[::3, ::3] for image in images)
    noises = np.array([_noise(image) for image in images]) * math.sqrt(_BAND_GAIN)
    details = np.array([np.quantile(abs(band), share) for band in bands]) / noises
    least, of_best = settings.details
    empty = (details < least) & (details < of_best * details.max())
    dark = [image.mean() < settings.black for image in images]
    return {int(k): "black" if dark[k] else "empty" for k in np.flatnonzero(empty)}
