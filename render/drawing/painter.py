"""The fast renderer: analytic anti-aliased markers; transmittances multiply in linear light."""

import numpy as np
from numpy.typing import NDArray

from ..colour import encoding_table
from ..design.sensor import SensorDesign
from ..ground import ground_image
from ..membrane import Membrane
from ..outlines import outlines
from .coverage import edge_width
from .marker_kernels import LANES, NUMBERS, TILE, prepare, prepare_changed
from .paint_kernels import encode, paint_tiles, union, update_pairs

Array = NDArray[np.float64]

#: Step to which outlines are rounded [px]. So a marker that stands still is not drawn again, and an
#: image does not depend on the one before it.
GRID = 1.0 / 1024.0


class Painter:
    """Draws each marker as its projected shape; redraws only where a marker has moved.

    Parameters
    ----------
    sensor: design of the sensor
    redraw: whether to draw every frame in full, which measures the time that redrawing saves
    """

    def __init__(self, sensor: SensorDesign, *, redraw: bool = False) -> None:
        self._view = sensor.view
        self._absorbed = (1.0 - sensor.transmittance).astype(np.float32)
        self._width = edge_width(sensor.camera.blur_px)
        self._square = sensor.markers.form == "square"
        self._redraw = redraw
        self._encoding = encoding_table()
        ground = ground_image(sensor)
        self._ground = _in_tiles(ground)
        self._clear = np.empty(ground.shape, dtype=np.uint8)
        encode(ground, self._encoding, self._clear)
        self._image = self._clear.copy()
        view = sensor.view
        self._dirty = np.zeros((-(-view.height // TILE), -(-view.width // TILE)), dtype=np.bool_)
        self._forget(0)

    def render(self, membrane: Membrane) -> NDArray[np.uint8]:
        """Noise-free sRGB image of the membrane, shape (H, W, 3)."""
        coefficients = outlines(membrane, self._view)
        if coefficients.shape[1] != len(self._boxes):
            self._forget(coefficients.shape[1])
        if self._redraw:
            self._drawn[:], self._dirty[:] = np.inf, True
        rows, size = self._view.height, (self._view.height, self._view.width)
        kept = self._drawn, self._numbers, self._boxes, self._changed, self._dirty
        shape = prepare_changed(coefficients, GRID, self._width, self._square, size, *kept)
        room = self._room
        if not room.holds(shape):
            room = self._make_room()
        update_pairs(
            self._numbers,
            self._boxes,
            self._changed,
            self._width,
            self._square,
            self._absorbed,
            room.ramp,
            room.covered,
            self._spans,
            self._left,
            self._hidden,
        )
        paint_tiles(
            self._image.reshape(rows, -1),
            self._clear.reshape(rows, -1),
            self._ground,
            self._numbers,
            self._boxes,
            self._spans,
            self._left,
            self._hidden,
            self._encoding,
            self._dirty,
            self._width,
        )
        return self._image.copy()

    def _forget(self, count: int) -> None:
        """Reset all arrays for another number of pairs."""
        self._drawn = np.full((2, count, 6, 2), np.inf)
        self._numbers = np.full((2, count, NUMBERS), np.nan, dtype=np.float32)
        self._boxes = np.zeros((count, 4), dtype=np.int64)
        self._changed = np.empty(count, dtype=np.bool_)
        self._dirty[:] = True
        self._make_room()

    def _make_room(self) -> "_Room":
        """Allocate arrays for the largest pair, and mark all pairs as changed."""
        self._room = room = _Room(self._boxes, 3 if self._square else 2)
        count, pixels = len(self._boxes), room.covered.shape[1]
        self._spans = np.empty((count, *room.spans.shape), dtype=np.int64)
        self._left = np.empty((count, 3 * pixels), dtype=np.float32)
        self._hidden = np.empty((count, pixels), dtype=np.float32)
        self._changed[:] = True
        return room

    def close(self) -> None:
        """Do nothing: the painter holds nothing to release."""


def coverage_image(
    coefficients: Array, width: float, square: bool, size: tuple[int, int]
) -> NDArray[np.float32]:
    """Share of each pixel that is covered by any of K markers, as the painter draws them.

    Parameters
    ----------
    coefficients: outlines of the markers, see `outlines`, shape (K, 6, 2)
    width: standard deviation of an edge [px]
    square: whether markers are squares, else discs
    size: height and width of the image [px]

    Returns
    -------
    Shape (H, W).
    """
    count = len(coefficients)
    numbers = np.empty((1, count, NUMBERS), dtype=np.float32)
    boxes = np.zeros((count, 4), dtype=np.int64)
    rounded = np.rint(coefficients / GRID)[None] * GRID
    prepare(rounded, width, square, size, numbers, boxes)
    room, image = _Room(boxes, 1), np.zeros(size, dtype=np.float32)
    union(numbers, boxes, width, square, room.ramp, room.covered, room.spans, image)
    return image


def _in_tiles(ground: NDArray[np.float32]) -> NDArray[np.float32]:
    """Split an image (H, W, 3) into tiles, row by row, padded with 0: (tiles, TILE, 3·TILE)."""
    spare = [(0, -size % TILE) for size in ground.shape[:2]]
    rows = np.pad(ground, (*spare, (0, 0))).reshape(
        -1, TILE, (ground.shape[1] + spare[1][1]) // TILE, 3 * TILE
    )
    return np.ascontiguousarray(np.swapaxes(rows, 1, 2)).reshape(-1, TILE, 3 * TILE)


class _Room:
    """Work arrays for one pair, as large as the largest of M pairs with a margin.

    Parameters
    ----------
    boxes: boxes of the pairs, see `prepare`, shape (M, 4)
    rows: rows of `covered`, see `cover_pair`
    """

    def __init__(self, boxes: NDArray[np.int64], rows: int) -> None:
        largest = (boxes[:, 3::-2] - boxes[:, 2::-2]).max(axis=0, initial=0)
        high, wide = (int(size) + LANES for size in largest)
        self._size = high, wide
        wide += 2 * LANES  # blocks begin before a box and end after it
        self.ramp = np.arange(wide, dtype=np.float32)
        self.spans = np.empty((high, 3), dtype=np.int64)
        self.covered = np.empty((rows, high * wide), dtype=np.float32)

    def holds(self, shape: tuple[int, int]) -> bool:
        """Whether a pair with that number of rows and columns fits."""
        return shape[0] <= self._size[0] and shape[1] <= self._size[1]
