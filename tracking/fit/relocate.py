"""Detection of all markers without the previous frame; numbers are assigned from the rim inwards.

The rim of a fingertip is fixed, or moves slowly, and the skin inside it moves smoothly. So markers
get their numbers from the outermost inwards: each is searched at the position that its numbered
neighbours predict. This works for motions of more than half a pitch.
"""

import itertools
from dataclasses import dataclass

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from ...render import decoding_table
from ..detection import RestFrame, neighbours
from ..palette import Palette
from ..unmixing import unmixing_matrix
from .settings import RelocationSettings

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Relocated:
    """Markers of a frame, by number.

    Attributes
    ----------
    position: positions [px], shape (L, M, 2); predicted for those not found
    found: whether each marker was found, shape (L, M)
    ambiguous: whether it was found, but another blob or number fits nearly as well, shape (L, M)
    gains: light of each channel over that at rest, at each marker, shape (M, 3)
    blobs: centres of each layer's blobs [px], L arrays (n, 2)
    """

    position: Array
    found: NDArray[np.bool_]
    ambiguous: NDArray[np.bool_]
    gains: Array
    blobs: list[Array]


class Relocator:
    """Finds the markers of a rest frame in any other frame.

    Parameters
    ----------
    rest: rest frame
    palette: colours of the markers
    settings: tuned parameters
    """

    def __init__(
        self, rest: RestFrame, palette: Palette, settings: RelocationSettings = RelocationSettings()
    ) -> None:
        self._rest, self._settings = rest, settings
        self._matrix = unmixing_matrix(palette.transmittance).astype(np.float32)
        self._bright = palette.bright
        self._skin = rest.ground[..., 0] > 0.0
        safe = np.where(self._skin[..., None], rest.ground, 1.0)
        self._log_ground = np.log(np.maximum(safe, 1e-4)).astype(np.float32)
        levels = np.log(np.maximum(decoding_table(), 1e-4)).astype(np.float32)
        self._log_levels = np.repeat(levels[:, None], 3, axis=1).reshape(1, 256, 3)
        ends = np.stack([rest.radii.min(axis=1), rest.radii.max(axis=1)], axis=-1)
        self._areas = np.pi * ends**2  # of the smallest and the largest markers of each layer
        # From the rim inwards: by the distance from the middle of all markers.
        middle = np.nanmean(rest.position, axis=0)
        away = np.linalg.norm(middle - middle.mean(axis=0), axis=1)
        self._order = np.argsort(-away)
        self._near = neighbours(middle, 3 * settings.around - 1)
        self._middle = middle

    def __call__(self, image: Image, moved: Array | None = None) -> Relocated:
        """Find the markers in an image of the rest frame's size.

        Parameters
        ----------
        image: image
        moved: displacement from which the numbering starts, that of the outermost markers as far as
            known, as the whole field may have moved [px], shape (L, M, 2); None for none
        """
        blobs, gains = self.blobs(image)
        rest = self._rest.position
        start = np.zeros_like(rest) if moved is None else moved
        position, found, ambiguous = self._numbered(start, blobs)
        few = 0.5 * np.isfinite(rest[..., 0]).sum()
        if found.sum() < few <= sum(map(len, blobs)):
            # The field may lie between the places of its markers.
            for x, y in itertools.product((-0.5, 0.0, 0.5), repeat=2):
                other = self._numbered(start + self._rest.pitch * np.array([x, y]), blobs)
                if other[1].sum() > found.sum():
                    position, found, ambiguous = other
        x, y = (
            np.clip(np.rint(self._middle[:, k]).astype(int), 0, size - 1)
            for k, size in enumerate((image.shape[1], image.shape[0]))
        )
        return Relocated(position, found, ambiguous, np.exp(gains[y, x].astype(float)), blobs)

    def _numbered(
        self, start: Array, blobs: list[Array]
    ) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
        """Positions of all markers (L, M, 2), whether found, whether ambiguous."""
        rest = self._rest.position
        parts = [self._number(*each) for each in zip(rest, start, blobs, strict=True)]
        position, found, ambiguous = (np.stack(part) for part in zip(*parts, strict=True))
        return position, found, ambiguous

    def blobs(self, image: Image) -> tuple[list[Array], NDArray[np.float32]]:
        """Centres (n, 2) of each layer's blobs, and log of light over that at rest, (H, W, 3)."""
        settings = self._settings
        ratio = np.asarray(cv2.LUT(image, self._log_levels)) - self._log_ground
        ratio[~self._skin] = 0.0
        gains = self._light(ratio)
        density = cv2.transform(gains - ratio, self._matrix)
        density = np.asarray(density).reshape(*self._skin.shape, -1)
        blobs = []
        for layer, (small, large) in enumerate(self._areas):
            mask = ((density[..., layer] > 0.5) & self._skin).astype(np.uint8)
            _, _, stats, centres = cv2.connectedComponentsWithStats(mask, connectivity=4)
            areas = stats[1:, cv2.CC_STAT_AREA]
            fit = (areas > settings.smallest * small) & (areas < settings.largest * large)
            blobs.append(np.asarray(centres[1:][fit], dtype=float))
        return blobs, gains

    def _light(self, ratio: NDArray[np.float32]) -> NDArray[np.float32]:
        """Estimate the logarithm of the ground's light over that at rest, shape (H, W, 3)."""
        settings = self._settings
        height, width = self._skin.shape
        size = max(8, round(settings.block * self._rest.pitch))
        rows, cols = -(-height // size), -(-width // size)
        blocks = np.full((rows, cols, 3), np.nan, dtype=np.float32)
        share = settings.ground_share if self._bright else 1.0 - settings.ground_share
        for row in range(rows):
            for col in range(cols):
                part = np.s_[row * size : (row + 1) * size : 2, col * size : (col + 1) * size : 2]
                lit = ratio[part][self._skin[part]]
                if len(lit) > size:
                    at = int(share * (len(lit) - 1))
                    blocks[row, col] = np.partition(lit, at, axis=0)[at]
        weight = np.isfinite(blocks[..., :1]).astype(np.float32)
        filled = np.concatenate([np.nan_to_num(blocks) * weight, weight], axis=2)
        filled = cv2.GaussianBlur(filled, (0, 0), 0.7, borderType=cv2.BORDER_REPLICATE)
        smooth = filled[..., :3] / np.maximum(filled[..., 3:], 1e-6)
        # Middles of blocks lie half a block inside.
        x = (np.arange(width, dtype=np.float32) + 0.5) / size - 0.5
        y = (np.arange(height, dtype=np.float32) + 0.5) / size - 0.5
        at_x, at_y = np.meshgrid(x, y)
        return np.asarray(
            cv2.remap(smooth, at_x, at_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        )

    def _number(
        self, rest: Array, start: Array, blobs: Array
    ) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
        """Assign blobs to one layer's markers: positions, whether found, whether ambiguous."""
        settings = self._settings
        count = len(rest)
        present = np.isfinite(rest[:, 0])
        moved = np.full((count, 2), np.nan)
        ambiguous = np.zeros(count, dtype=np.bool_)
        reach = settings.reach * self._rest.pitch
        tree = scipy.spatial.KDTree(blobs) if len(blobs) else None
        owner = np.full(len(blobs), -1)
        # A second time for markers that had too few numbered neighbours the first time.
        for _ in range(2):
            for m in self._order.tolist():
                if tree is None or not present[m] or np.isfinite(moved[m, 0]):
                    continue
                predicted = rest[m] + self._expected(m, moved, start)
                distance, blob = tree.query(predicted, k=min(2, len(blobs)))
                distance, blob = np.atleast_1d(distance), np.atleast_1d(blob)
                if distance[0] > reach or owner[blob[0]] >= 0:
                    continue
                moved[m] = blobs[blob[0]] - rest[m]
                owner[blob[0]] = m
                ambiguous[m] = (
                    len(distance) > 1
                    and distance[0] > settings.certain * self._rest.pitch
                    and distance[1] < settings.nearly * distance[0]
                )
        found = np.isfinite(moved[:, 0])
        for m in np.flatnonzero(~found):
            moved[m] = self._expected(int(m), moved, start)
        return rest + moved, found, ambiguous

    def _expected(self, m: int, moved: Array, start: Array) -> Array:
        """Predict the displacement of a marker [px] from its numbered neighbours."""
        settings = self._settings
        near = self._near[m]
        known = near[np.isfinite(moved[near, 0])][: settings.around]
        if len(known) == 0:
            return np.asarray(start[m])
        offsets = self._middle[known] - self._middle[m]
        weight = 1.0 / (1.0 + (offsets**2).sum(axis=1) / self._rest.pitch**2)
        mean = weight @ moved[known] / weight.sum()
        if len(known) < 3:
            return np.asarray(mean)
        # A plane through them; the prior determines it across neighbours that lie on a line.
        centre = weight @ offsets / weight.sum()
        apart = (offsets - centre) * weight[:, None]
        square = apart.T @ (offsets - centre) + settings.stiff**2 * np.eye(2)
        slope = np.linalg.solve(square, apart.T @ (moved[known] - mean))
        return np.asarray(mean - centre @ slope)
