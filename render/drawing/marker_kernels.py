"""Compiled coverage: the share of each pixel that markers cover. `painter.py` documents the use.

The pixels of a pair are stored in blocks of LANES: the blocks that it reaches in the first row of
its box, then those in the second row, and so on.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit
from .coverage import EDGE_RANGE, edge, togetherness

Array = NDArray[np.float64]

#: Side of the square tiles in which the image is drawn [px].
TILE = 16
#: Number of pixels of a row that are processed together.
LANES = 8
#: Number of parameters of a marker: c (2), A⁻¹ (4), A⁻¹·b (6), extent of its rows (3: slope of the
#: line through their middles, half width of the middle row, half height), and in the first layer
#: `togetherness` of both layers' edges (1). All are NaN if it is not visible.
NUMBERS = 16
#: Bound of the second-order part of an outline; the series does not hold beyond it.
_MAX_BEND = 0.4


@njit()
def prepare(
    coefficients: Array, width: float, square: bool, shape: Any, numbers: Any, boxes: Any
) -> None:
    """Compute the parameters of markers and the bounding boxes of pairs.

    Parameters
    ----------
    coefficients: outlines of M markers in each of L layers, see `outlines.outlines`, (L, M, 6, 2)
    width: standard deviation of the edge [px]
    square: whether markers are squares, else discs
    shape: size of the image, (H, W)
    numbers: result: parameters, see NUMBERS, float32, shape (L, M, NUMBERS)
    boxes: result: (x0, x1, y0, y1) of the pixels that a pair reaches, shape (M, 4)
    """
    for k in range(coefficients.shape[1]):
        _prepare_pair(coefficients[:, k], width, square, shape, numbers[:, k], boxes[k])


@njit()
def prepare_changed(
    coefficients: Array,
    grid: float,
    width: float,
    square: bool,
    shape: Any,
    drawn: Array,
    numbers: Any,
    boxes: Any,
    changed: NDArray[np.bool_],
    dirty: NDArray[np.bool_],
) -> tuple[int, int]:
    """Prepare the pairs whose outlines have changed, and mark the tiles that they reach or reached.

    Parameters
    ----------
    coefficients, width, square, shape: as in `prepare`, two layers
    grid: step to which outlines are rounded [px]
    drawn: rounded outlines that were drawn last; those of changed pairs are replaced
    numbers, boxes: results of `prepare`; those of changed pairs are replaced
    changed: result: whether each pair has changed, shape (M,)
    dirty: whether each tile must be redrawn; tiles are set here

    Returns
    -------
    Largest number of rows and of columns of the changed pairs' boxes.
    """
    to, high, wide = 1.0 / grid, 0, 0
    for k in range(coefficients.shape[1]):
        changed[k] = False
        for layer in range(coefficients.shape[0]):
            for i in range(coefficients.shape[2]):
                for axis in range(2):
                    now = np.rint(coefficients[layer, k, i, axis] * to) * grid
                    old = drawn[layer, k, i, axis]
                    if not (now == old or (now != now and old != old)):
                        drawn[layer, k, i, axis] = now
                        changed[k] = True
        if changed[k]:
            _mark(boxes[k], dirty)
            _prepare_pair(drawn[:, k], width, square, shape, numbers[:, k], boxes[k])
            _mark(boxes[k], dirty)
            high = max(high, boxes[k, 3] - boxes[k, 2])
            wide = max(wide, boxes[k, 1] - boxes[k, 0])
    return high, wide


@njit()
def _mark(box: Any, dirty: NDArray[np.bool_]) -> None:
    """Mark the tiles that a box reaches."""
    if box[1] > box[0] and box[3] > box[2]:
        for row in range(box[2] // TILE, (box[3] - 1) // TILE + 1):
            for col in range(box[0] // TILE, (box[1] - 1) // TILE + 1):
                dirty[row, col] = True


@njit()
def _prepare_pair(
    coefficients: Array, width: float, square: bool, shape: Any, numbers: Any, box: Any
) -> None:
    """Do `prepare` for one pair; shapes (L, 6, 2), (L, NUMBERS) and (4,)."""
    reach = EDGE_RANGE * width
    layers = coefficients.shape[0]
    box[:] = 0
    for layer in range(layers):
        c, n = coefficients[layer], numbers[layer]
        det = c[1, 0] * c[2, 1] - c[2, 0] * c[1, 1]
        n[:] = np.nan
        if not (math.isfinite(c[0, 0] + c[0, 1]) and abs(det) > 1e-6):
            continue
        i00, i01 = c[2, 1] / det, -c[2, 0] / det
        i10, i11 = -c[1, 1] / det, c[1, 0] / det
        n[0], n[1] = c[0, 0], c[0, 1]
        n[2], n[3], n[4], n[5] = i00, i01, i10, i11
        for j in range(3):
            bx, by = c[3 + j, 0], c[3 + j, 1]
            n[6 + 2 * j] = min(max(i00 * bx + i01 * by, -_MAX_BEND), _MAX_BEND)
            n[7 + 2 * j] = min(max(i10 * bx + i11 * by, -_MAX_BEND), _MAX_BEND)
        empty = box[0] == box[1] or box[2] == box[3]
        for axis in range(2):
            p, q = abs(c[1, axis]), abs(c[2, axis])
            half = p + q if square else math.sqrt(p * p + q * q)
            half += abs(c[3, axis]) + abs(c[4, axis]) + abs(c[5, axis]) + reach
            size = shape[1 - axis]
            low = max(0, min(size, math.ceil(c[0, axis] - half)))
            high = max(0, min(size, math.floor(c[0, axis] + half) + 1))
            box[2 * axis] = low if empty else min(box[2 * axis], low)
            box[2 * axis + 1] = high if empty else max(box[2 * axis + 1], high)
            n[13 + axis] = half
        n[12] = n[15] = 0.0
        if not square:
            high2 = c[1, 1] ** 2 + c[2, 1] ** 2
            n[12] = (c[1, 0] * c[1, 1] + c[2, 0] * c[2, 1]) / high2
            n[13] += abs(det) / math.sqrt(high2) - math.sqrt(c[1, 0] ** 2 + c[2, 0] ** 2)
    if layers == 2 and not square:
        numbers[0, 15] = togetherness(coefficients[0], coefficients[1])


@njit()
def cover_pair(
    numbers: Any,
    box: Any,
    width: float,
    square: bool,
    ramp: NDArray[np.float32],
    spans: Any,
    covered: NDArray[np.float32],
) -> int:
    """Compute the coverage of a pair.

    Parameters
    ----------
    numbers, box: results of `prepare` for this pair, shapes (L, NUMBERS) and (4,)
    width, square: as in `prepare`
    ramp: 0, 1, 2, … for the pixels of a row. Converting the loop counter instead takes as long as
        all the rest.
    spans: result: for each row of the box its first and last + 1 block, counted from the image's
        edge, and the number of blocks in the rows above, shape (rows, 3)
    covered: result: coverage of each pixel of these blocks by each layer, shape (L, pixels); for
        squares a third row is the coverage by both layers

    Returns
    -------
    Number of pixels of the blocks; the rest of `covered` is unchanged.
    """
    if not (box[1] > box[0] and box[3] > box[2]):
        return 0
    count = LANES * _row_spans(numbers, box, square, spans)
    for layer in range(numbers.shape[0]):
        n, out = numbers[layer], covered[layer]
        if n[0] != n[0]:
            for j in range(count):
                out[j] = 0.0
        elif square:
            _squares(n, box, spans, width, ramp, out)
        else:
            _discs(n, box, spans, width, ramp, out)
    if covered.shape[0] == 3:
        if numbers[0, 0] != numbers[0, 0] or numbers[1, 0] != numbers[1, 0]:
            for j in range(count):
                covered[2, j] = 0.0
        else:
            _both_squares(numbers[0], numbers[1], box, spans, width, ramp, covered[2])
    return count


@njit()
def _row_spans(numbers: Any, box: Any, square: bool, spans: Any) -> int:
    """Compute the spans of a pair's rows, as those of an ellipse; return the number of blocks."""
    one = np.float32(1.0)
    spare = np.float32(0.1)  # [px]: a curve at a fixed distance from an ellipse is no ellipse
    left, right, rows = box[0], box[1] - 1, box[3] - box[2]
    for row in range(rows):
        spans[row, 0], spans[row, 1] = right // LANES, 0
    for layer in range(numbers.shape[0]):
        n = numbers[layer]
        if n[0] != n[0]:
            continue
        x, lean, half, per_row = n[0], n[12], n[13] + spare, one / (n[14] + spare)
        start = np.float32(box[2]) - n[1]
        for row in range(rows):
            dy = start + np.float32(row)
            level = dy * per_row
            inside = one - level * level
            if inside > np.float32(0.0):
                middle = x + lean * dy
                reach = half if square else half * np.sqrt(inside)
                first = max(int(middle - reach), left) // LANES
                last = min(int(middle + reach), right) // LANES + 1
                spans[row, 0] = min(spans[row, 0], first)
                spans[row, 1] = max(spans[row, 1], last)
    count = 0
    for row in range(rows):
        spans[row, 2] = count
        count += max(spans[row, 1] - spans[row, 0], 0)
    return count


@njit(inline="always")
def _twelve(n: Any) -> Any:
    """Parameters c, A⁻¹ and A⁻¹·b of a marker."""
    return n[0], n[1], n[2], n[3], n[4], n[5], n[6], n[7], n[8], n[9], n[10], n[11]


@njit()
def _discs(n: Any, box: Any, spans: Any, width: float, ramp: Any, covered: Any) -> None:
    """Compute the coverage of a box by the image of a disc.

    It uses float32 and local variables only, so that the compiler vectorises it. Along a row q is a
    parabola in x.
    """
    # At the very centre, where the distance has no gradient: deep inside.
    tiny, tinier, two = np.float32(1e-12), np.float32(1e-16), np.float32(2.0)
    cx, cy, i00, i01, i10, i11, u0, v0, u1, v1, u2, v2 = _twelve(n)
    bulge = np.float32(0.5 * width * width)
    scale = np.float32(1.0 / (EDGE_RANGE * width))
    # |∇q|² is a quadratic form of q/|q|.
    m_xx, m_yy = i00 * i00 + i01 * i01, i10 * i10 + i11 * i11
    m_xy = two * (i00 * i10 + i01 * i11)
    x_2 = -(u0 * i00 * i00 + u1 * i00 * i10 + u2 * i10 * i10)
    y_2 = -(v0 * i00 * i00 + v1 * i00 * i10 + v2 * i10 * i10)
    for row in range(box[3] - box[2]):
        dy = np.float32(box[2] + row) - cy
        start = np.float32(LANES * spans[row, 0]) - cx
        e, f = i01 * dy, i11 * dy
        cross = i00 * f + i10 * e
        x_1 = i00 - (u0 * two * i00 * e + u1 * cross + u2 * two * i10 * f)
        y_1 = i10 - (v0 * two * i00 * e + v1 * cross + v2 * two * i10 * f)
        x_0 = e - (u0 * e * e + u1 * e * f + u2 * f * f)
        y_0 = f - (v0 * e * e + v1 * e * f + v2 * f * f)
        at = np.uint64(
            LANES * spans[row, 2]
        )  # an unsigned index is not checked, and loops vectorise
        for j in range(np.uint64(LANES * max(spans[row, 1] - spans[row, 0], 0))):
            dx = start + ramp[j]
            qx = x_0 + dx * (x_1 + dx * x_2)
            qy = y_0 + dx * (y_1 + dx * y_2)
            # First-order distance (1 − |q|)/|∇q|; blurring a curved edge moves its half level
            # inwards by s²/(2R).
            xx, yy = qx * qx, qy * qy
            square = xx + yy + tiny
            steep = m_xx * xx + m_yy * yy + m_xy * (qx * qy) + tinier
            radius = np.sqrt(square)
            inside = (radius - square - bulge * steep / radius) / np.sqrt(steep)
            covered[at + j] = edge(inside * scale)


@njit()
def _squares(n: Any, box: Any, spans: Any, width: float, ramp: Any, covered: Any) -> None:
    """Compute the coverage of a box by the image of a square: an edge profile along each side."""
    one = np.float32(1.0)
    cx, cy, i00, i01, i10, i11, u0, v0, u1, v1, u2, v2 = _twelve(n)
    reach = np.float32(EDGE_RANGE * width)
    across = one / (reach * np.sqrt(i00 * i00 + i01 * i01))
    along = one / (reach * np.sqrt(i10 * i10 + i11 * i11))
    for row in range(box[3] - box[2]):
        dy = np.float32(box[2] + row) - cy
        start = np.float32(LANES * spans[row, 0]) - cx
        at = np.uint64(
            LANES * spans[row, 2]
        )  # an unsigned index is not checked, and loops vectorise
        for j in range(np.uint64(LANES * max(spans[row, 1] - spans[row, 0], 0))):
            dx = start + ramp[j]
            px, py = i00 * dx + i01 * dy, i10 * dx + i11 * dy
            xx, xy, yy = px * px, px * py, py * py
            qx = px - u0 * xx - u1 * xy - u2 * yy
            qy = py - v0 * xx - v1 * xy - v2 * yy
            wide = edge((one - qx) * across) - edge((-one - qx) * across)
            high = edge((one - qy) * along) - edge((-one - qy) * along)
            covered[at + j] = wide * high


@njit()
def _both_squares(
    n: Any, m: Any, box: Any, spans: Any, width: float, ramp: Any, covered: Any
) -> None:
    """Compute the coverage of a box by the overlap of two squares: the inner one of each side."""
    one, zero = np.float32(1.0), np.float32(0.0)
    cx, cy, i00, i01, i10, i11, _, _, _, _, _, _ = _twelve(n)
    dx, dy, j00, j01, j10, j11, _, _, _, _, _, _ = _twelve(m)
    reach = np.float32(EDGE_RANGE * width)
    a1 = one / (reach * np.sqrt(i00 * i00 + i01 * i01))
    a2 = one / (reach * np.sqrt(i10 * i10 + i11 * i11))
    b1 = one / (reach * np.sqrt(j00 * j00 + j01 * j01))
    b2 = one / (reach * np.sqrt(j10 * j10 + j11 * j11))
    for row in range(box[3] - box[2]):
        y = np.float32(box[2] + row)
        start = np.float32(LANES * spans[row, 0])
        at = np.uint64(
            LANES * spans[row, 2]
        )  # an unsigned index is not checked, and loops vectorise
        for j in range(np.uint64(LANES * max(spans[row, 1] - spans[row, 0], 0))):
            x = start + ramp[j]
            q1, q2 = i00 * (x - cx) + i01 * (y - cy), i10 * (x - cx) + i11 * (y - cy)
            p1, p2 = j00 * (x - dx) + j01 * (y - dy), j10 * (x - dx) + j11 * (y - dy)
            wide = min(edge((one - q1) * a1), edge((one - p1) * b1))
            wide += min(edge((one + q1) * a1), edge((one + p1) * b1)) - one
            high = min(edge((one - q2) * a2), edge((one - p2) * b2))
            high += min(edge((one + q2) * a2), edge((one + p2) * b2)) - one
            covered[at + j] = max(wide, zero) * max(high, zero)
