"""The published ChromaTouch pipeline (Lin & Wiertlewski 2019, Lin et al. 2020)."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...render import encode_srgb
from ..detection import RestFrame
from ..palette import Palette
from .follower import Follower, FollowerSettings, Image, Measured, nearest

Array = NDArray[np.float64]

#: Smallest saturation of a marker's pixels. Lin 2019 has 50 %, which the real dome's magenta on
#: white does not quite reach.
_SATURATED = 0.35


class ChromaTouch(Follower):
    """Top-hat, HSV mask of saturated pixels, connected components, centroid and mean hue.

    Its weaknesses are kept, because other trackers are compared with it. Colours are not unmixed: a
    pixel belongs to the colour with the nearest hue, so that the edge of a mask shifts where the
    other layer lies under it. The centroid is that of a binary mask. Markers that touch form one
    component. Two markers may take the same component; both are then ambiguous.

    A palette of one grey dye has no hue: its markers are masked at half the contrast of their
    middles at rest, and there is no mean hue.

    Raises
    ------
    UserError
        When two dyes cannot be distinguished by their hues.
    """

    def __init__(
        self, palette: Palette, noise: float, settings: FollowerSettings = FollowerSettings()
    ) -> None:
        super().__init__(palette, noise, settings)
        count = len(palette.transmittance)
        # Colours on white: each dye alone, and both together.
        members = np.vstack([np.eye(count), np.ones((count - 1, count))])
        light = np.minimum(np.exp(members @ np.log(palette.transmittance)), 1.0)
        hsv = _hsv((encode_srgb(light) / 255.0)[None].astype(np.float32))[0]
        self._hues, self._members = hsv[:, 0], members.astype(bool)
        self._coloured = not palette.bright and bool((hsv[:, 1] > _SATURATED).all())
        if count > 1 and not self._coloured:
            raise UserError(
                f"the chromatouch tracker tells layers by their hue, the palette's "
                f"{' and '.join(palette.names)} must be darker than the ground and saturated by "
                f"more than {_SATURATED:.0%}"
            )

    def _prepare(self, rest: RestFrame, image: Image) -> None:
        self._area = np.pi * rest.radii.min(axis=1) ** 2
        # Odd, and wider than a pair whose layers lie apart.
        side = 2 * int(3.0 * rest.radii.max()) + 1
        self._around = np.ones((side, side), np.uint8)
        middles = np.rint(rest.position[0, np.isfinite(rest.position[0, :, 0])]).astype(int)
        hat = self._hat(image).max(axis=2)
        self._depth = 0.5 * float(np.median(hat[middles[:, 1], middles[:, 0]]))

    def _find(self, image: Image, expected: Array) -> Measured:
        masks, hue = self._masks(self._hat(image))
        layers, count, _ = expected.shape
        position, hues = np.full((layers, count, 2), np.nan), np.full(count, np.nan)
        for k, mask in enumerate(masks):
            _, labels, stats, centroids = cv2.connectedComponentsWithStats(
                mask.astype(np.uint8), connectivity=4
            )
            plausible = stats[:, cv2.CC_STAT_AREA] > 0.2 * self._area[k]  # the others are noise
            plausible[0] = False  # the background
            number = nearest(centroids[plausible], expected[k], self._reach, mutual=False)
            found = number >= 0
            position[k, found] = centroids[plausible][number[found]]
            if k == 0 and self._coloured:
                # Hues are cyclic: average their differences from the dye's hue.
                pixels = np.maximum(stats[:, cv2.CC_STAT_AREA], 1)
                turned = _turn(hue - self._hues[0]).ravel()
                mean = np.bincount(labels.ravel(), turned, len(stats)) / pixels
                hues[found] = _turn(mean + self._hues[0])[plausible][number[found]]
        return Measured(position, hue=hues)

    def _hat(self, image: Image) -> Image:
        """Levels by which each pixel is darker (or brighter) than the ground around it."""
        hat = cv2.MORPH_TOPHAT if self._palette.bright else cv2.MORPH_BLACKHAT
        return np.asarray(cv2.morphologyEx(image, hat, self._around), dtype=np.uint8)

    def _masks(self, hat: Image) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
        """Masks of the L layers, (L, H, W), and hue of each pixel [°], −180…180, (H, W)."""
        if not self._coloured:
            dark = hat.max(axis=2) > self._depth
            return np.broadcast_to(dark, (len(self._area), *dark.shape)), np.zeros(
                dark.shape, np.float32
            )
        # Subtract the top-hat from white.
        hsv = _hsv((255 - hat).astype(np.float32) / np.float32(255.0))
        hue, saturated = hsv[..., 0], hsv[..., 1] > _SATURATED
        colour = abs(_turn(hue - self._hues[:, None, None])).argmin(axis=0)
        return np.stack([saturated & member[colour] for member in self._members.T]), hue


def _hsv(colour: NDArray[np.float32]) -> NDArray[np.float32]:
    """Convert an RGB image 0…1 to hue [°], −180…180, saturation and value, shape (H, W, 3)."""
    hsv = np.asarray(cv2.cvtColor(colour, cv2.COLOR_RGB2HSV), dtype=np.float32)
    hsv[..., 0] = _turn(hsv[..., 0])
    return hsv


def _turn(hue: NDArray[Any]) -> NDArray[Any]:
    """Wrap a hue to −180…180°."""
    return (hue + 180.0) % 360.0 - 180.0
