"""The fast renderer: analytic anti-aliased markers, whose dyes multiply in linear light."""

import numpy as np
from numpy.typing import NDArray

from ..colour import encoding_table
from ..design.sensor import SensorDesign
from ..ground import ground_image
from ..membrane import Membrane
from ..outlines import outlines
from .coverage import edge_width
from .marker_kernels import LANES, NUMBERS, TILE, prepare, update_coverage
from .paint_kernels import encode, paint_tiles, union

Array = NDArray[np.float64]

#: Outlines are rounded to this share of a pixel. So a marker that stands still is not drawn again,
#: and an image does not depend on the one before it.
GRID = 1.0 / 1024.0


class Painter:
    """Draws each marker as the shape that it projects to; redraws only where one has moved.

    Parameters
    ----------
    sensor: design
    redraw: draw every frame in full, to measure the time that this saves
    """

    def __init__(self, sensor: SensorDesign, *, redraw: bool = False) -> None:
        self._view = sensor.view
        self._absorbed = (1.0 - sensor.transmittance).astype(np.float32)
        self._width = edge_width(sensor.camera.blur_px)
        self._square = sensor.markers.form == "square"
        self._redraw = redraw
        self._encoding = encoding_table()
        ground = ground_image(sensor)
        spare = -ground.shape[1] % LANES
        self._ground = np.pad(np.moveaxis(ground, -1, 0), ((0, 0), (0, 0), (0, spare)))
        self._clear = np.empty(ground.shape, dtype=np.uint8)
        encode(ground, self._encoding, self._clear)
        self._image = self._clear.copy()
        view = sensor.view
        self._dirty = np.zeros((-(-view.height // TILE), -(-view.width // TILE)), dtype=np.bool_)
        self._numbers = np.empty((2, 2, 0, NUMBERS), dtype=np.float32)
        self._boxes = np.empty((2, 0, 4), dtype=np.int64)
        self._covered = np.empty((0, 2, 0, 0), dtype=np.float32)
        self._spans = np.empty((0, 0, 2), dtype=np.int64)

    def render(self, membrane: Membrane) -> NDArray[np.uint8]:
        """Noise-free sRGB image of the membrane, shape (H, W, 3)."""
        coefficients = outlines(membrane, self._view) * (1.0 / GRID)
        if coefficients.shape[1] != self._boxes.shape[1]:
            self._forget(coefficients.shape[1])
        np.rint(coefficients, out=coefficients)
        coefficients *= GRID
        self._numbers[1], self._boxes[1] = self._numbers[0], self._boxes[0]
        rows, size = self._view.height, (self._view.height, self._view.width)
        prepare(coefficients, self._width, self._square, size, self._numbers[0], self._boxes[0])
        self._make_room()
        if self._redraw:
            self._numbers[1], self._dirty[:] = np.inf, True
        update_coverage(
            self._numbers[0],
            self._boxes[0],
            self._numbers[1],
            self._boxes[1],
            self._width,
            self._square,
            self._covered,
            self._spans,
            self._dirty,
        )
        paint_tiles(
            self._image.reshape(rows, -1),
            self._clear.reshape(rows, -1),
            self._ground,
            self._numbers[0],
            self._boxes[0],
            self._covered,
            self._spans,
            self._absorbed,
            self._encoding,
            self._dirty,
            self._width,
        )
        return self._image.copy()

    def _forget(self, count: int) -> None:
        """Start anew with another number of pairs."""
        self._numbers = np.full((2, 2, count, NUMBERS), np.nan, dtype=np.float32)
        self._boxes = np.zeros((2, count, 4), dtype=np.int64)
        self._dirty[:] = True

    def _make_room(self) -> None:
        """Make room for the coverage of the largest pair."""
        boxes, have = self._boxes[0], self._covered.shape
        rows = (boxes[:, 3] - boxes[:, 2]).max(initial=0)
        cols = (boxes[:, 1] - boxes[:, 0]).max(initial=0) + 2 * LANES
        if len(boxes) != have[0] or rows > have[2] or cols > have[3]:
            self._covered, self._spans = _room(boxes, 3 if self._square else 2)
            self._numbers[1] = np.inf  # draws all pairs anew

    def close(self) -> None:
        """Nothing to release."""


def coverage_image(
    coefficients: Array, width: float, square: bool, size: tuple[int, int]
) -> NDArray[np.float32]:
    """Share of each pixel that is covered by any of the markers, as the painter draws them.

    Parameters
    ----------
    coefficients: of `outlines`, shape (K, 6, 2)
    width: standard deviation of an edge [px]
    square: whether markers are squares, else discs
    size: height and width of the image [px]

    Returns
    -------
    Shape (H, W).
    """
    count = len(coefficients)
    numbers = np.full((2, 1, count, NUMBERS), np.inf, dtype=np.float32)
    boxes = np.zeros((2, count, 4), dtype=np.int64)
    rounded = np.rint(coefficients / GRID)[None] * GRID
    prepare(rounded, width, square, size, numbers[0], boxes[0])
    covered, spans = _room(boxes[0], 1)
    dirty = np.zeros((-(-size[0] // TILE), -(-size[1] // TILE)), dtype=np.bool_)
    update_coverage(
        numbers[0], boxes[0], numbers[1], boxes[1], width, square, covered, spans, dirty
    )
    image = np.zeros(size, dtype=np.float32)
    union(boxes[0], covered, spans, image)
    return image


def _room(boxes: NDArray[np.int64], layers: int) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Arrays for the coverage of pairs up to the size of the largest of these, with a margin."""
    rows = int((boxes[:, 3] - boxes[:, 2]).max(initial=0)) + LANES
    cols = int((boxes[:, 1] - boxes[:, 0]).max(initial=0)) + 3 * LANES
    return (
        np.zeros((len(boxes), layers, rows, cols // LANES * LANES), dtype=np.float32),
        np.zeros((len(boxes), rows, 2), dtype=np.int64),
    )
