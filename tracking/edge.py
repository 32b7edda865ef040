"""The edge of the field, which cuts markers."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .detection import RestFrame
from .palette import Palette

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Edge:
    """Edge of the field, which cuts the markers that move over it.

    A tracker sees a part of such a disc, and places it too far inside.

    Attributes
    ----------
    inside: distance of the middle of a marker from where the edge cuts it, positive if whole, shape
        (H, W); of a known sensor, whose rim is modelled, from the edge itself [px]
    rest: places at rest [px], shape (..., 2)
    room: motion along x or y by which a marker certainly stays whole [px], shape (...); infinite
        for those that are cut at rest, and may stay so
    """

    inside: Array
    rest: Array
    room: Array

    @classmethod
    def of_rest(cls, rest: RestFrame, palette: Palette, position: Array) -> "Edge":
        """Edge of the field in a rest frame, in which the markers have positions (..., 2) [px]."""
        field = (rest.ground[..., 0] > 0.0).astype(np.uint8)
        blur = 2.0  # of an ordinary lens [px]
        # The edge of the picture ends a field as well.
        away: Any = cv2.distanceTransform(np.pad(field, 1), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        least = float(rest.radii.max()) + blur if palette.sensor is None else 0.0
        return cls(inside=away[1:-1, 1:-1] - least, rest=position, room=position).at_rest(position)

    @property
    def cut(self) -> NDArray[np.bool_]:
        """Mask (...) of the markers that are cut at rest."""
        return np.isinf(self.room)

    def at_rest(self, position: Array) -> "Edge":
        """The same edge with other positions (..., 2) of the markers at rest [px]."""
        inside = _at_places(self.inside, position)
        room = np.where(inside > 0.0, (inside - 1.5) / np.sqrt(2.0), np.inf)  # pixels are rounded
        return Edge(inside=self.inside, rest=position, room=room)

    def outside(self, points: Array) -> NDArray[np.bool_]:
        """Mask of points (..., 2) [px] at which the edge cuts a marker, or hides it."""
        return _at_places(self.inside, points) <= 0.0

    def hidden(self, position: Array) -> NDArray[np.bool_]:
        """Mask (...) of the markers that it cuts, though it did not at rest."""
        moved = abs(position - self.rest)
        far = np.maximum(moved[..., 0], moved[..., 1]) > self.room
        return far & (_at_places(self.inside, position) <= 0.0) if far.any() else far


def _at_places(values: Array, position: Array) -> Array:
    """Values (H, W) at the nearest pixels of positions (..., 2), −1 where one is unknown."""
    height, width = values.shape
    known = np.asarray(np.isfinite(position).all(axis=-1))
    x, y = np.moveaxis(np.rint(np.where(known[..., None], position, -1.0)).astype(int), -1, 0)
    inside = known & (x >= 0) & (x < width) & (y >= 0) & (y < height)
    found = values[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
    return np.asarray(np.where(inside, found, -1.0), dtype=float)
