"""Compiled painting of an image in tiles that fit the cache. `painter.py` documents the use.

A tile's pixels depend only on the markers that reach into it and on their order. So redrawing the
changed tiles alone gives, bit for bit, the image that is redrawn in full.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit
from .coverage import APART, EDGE_RANGE, beside, covered_by_both, crossing, odds_ratio
from .marker_kernels import LANES, TILE, cover_pair


@njit()
def update_pairs(
    numbers: Any,
    boxes: Any,
    changed: NDArray[np.bool_],
    width: float,
    square: bool,
    absorbed: NDArray[np.float32],
    ramp: NDArray[np.float32],
    covered: NDArray[np.float32],
    spans: NDArray[np.int64],
    left: NDArray[np.float32],
    hidden: NDArray[np.float32],
) -> None:
    """Compute the light that passes each changed pair.

    Parameters
    ----------
    numbers, boxes: results of `prepare`, two layers of M markers
    changed: whether each pair has changed, see `prepare_changed`, shape (M,)
    width, square: as in `prepare`
    absorbed: 1 − transmittance of each layer's dye, shape (2, 3)
    ramp, covered: see `cover_pair`; large enough for any pair
    spans: result: spans of each pair, see `cover_pair`, shape (M, rows, 3)
    left: result: share of red, green and blue that passes the dyes at each pixel of a pair's
        blocks, shape (M, 3·pixels)
    hidden: result: share of these pixels that is covered by either layer, shape (M, pixels)
    """
    one = np.float32(1.0)
    r0, g0, b0 = absorbed[0, 0], absorbed[0, 1], absorbed[0, 2]
    r1, g1, b1 = absorbed[1, 0], absorbed[1, 1], absorbed[1, 2]
    known = covered.shape[0] == 3
    first, second, shared = covered[0], covered[1], covered[-1]
    for k in range(boxes.shape[0]):
        if not changed[k]:
            continue
        count = cover_pair(numbers[:, k], boxes[k], width, square, ramp, spans[k], covered)
        together = numbers[0, k, 15]
        odds = together if together == together else one  # NaN: only one layer's marker is visible
        light, cover = left[k], hidden[k]
        for j in range(count):
            c0, c1 = first[j], second[j]
            both = shared[j] if known else covered_by_both(c0, c1, odds)
            cover[j] = c0 + c1 - both
            light[3 * j] = one - c0 * r0 - c1 * r1 + both * (r0 * r1)
            light[3 * j + 1] = one - c0 * g0 - c1 * g1 + both * (g0 * g1)
            light[3 * j + 2] = one - c0 * b0 - c1 * b1 + both * (b0 * b1)


@njit()
def paint_tiles(
    image: NDArray[np.uint8],
    clear: NDArray[np.uint8],
    ground: NDArray[np.float32],
    numbers: Any,
    boxes: Any,
    spans: NDArray[np.int64],
    left: NDArray[np.float32],
    hidden: NDArray[np.float32],
    encoding: NDArray[np.uint8],
    dirty: NDArray[np.bool_],
    width: float,
) -> None:
    """Redraw the dirty tiles and mark them clean.

    Parameters
    ----------
    image: sRGB image to draw into, shape (H, 3·W)
    clear: sRGB image without markers, shape (H, 3·W)
    ground: linear light without markers, not negative, tile by tile so that a tile is contiguous,
        shape (tiles, TILE, 3·TILE)
    numbers, boxes: results of `prepare`, two layers
    spans, left, hidden: results of `update_pairs`
    encoding: `colour.encoding_table()`
    dirty: whether each tile must be redrawn
    width: standard deviation of an edge [px]
    """
    rows, cols = dirty.shape
    # Counting sort: pairs of dirty tile t are members[ends[t] : ends[t + 1]], in their order.
    ends = np.zeros(rows * cols + 1, dtype=np.int64)
    members = np.empty(0, dtype=np.int64)
    filled = ends
    for fill in (False, True):
        for k in range(boxes.shape[0]):
            b = boxes[k]
            if b[1] > b[0] and b[3] > b[2]:
                for row in range(b[2] // TILE, (b[3] - 1) // TILE + 1):
                    for col in range(b[0] // TILE, (b[1] - 1) // TILE + 1):
                        t = row * cols + col
                        if dirty[row, col] and fill:
                            members[filled[t]] = k
                            filled[t] += 1
                        elif dirty[row, col]:
                            ends[t + 1] += 1
        if not fill:
            for t in range(rows * cols):
                ends[t + 1] += ends[t]
            members = np.empty(ends[-1], dtype=np.int64)
            filled = ends[:-1].copy()
    light = np.empty((TILE, 3 * TILE), dtype=np.float32)
    taken = np.empty((TILE, TILE), dtype=np.float32)
    owner = np.empty((TILE, TILE), dtype=np.int64)
    touched = np.empty((TILE, TILE // LANES), dtype=np.bool_)
    place = np.empty(3 * TILE, dtype=np.uint32)
    for row in range(rows):
        for col in range(cols):
            if not dirty[row, col]:
                continue
            dirty[row, col] = False
            t = row * cols + col
            y0, x0 = row * TILE, col * TILE
            y1 = min(y0 + TILE, image.shape[0])
            for y in range(TILE):
                for j in range(light.shape[1]):
                    light[y, j] = 1.0
                for j in range(taken.shape[1]):
                    taken[y, j] = 0.0
                for h in range(touched.shape[1]):
                    touched[y, h] = False
            meet = _meet(members[ends[t] : ends[t + 1]], numbers, width)
            for i in range(ends[t], ends[t + 1]):
                k = members[i]
                if meet:
                    _absorb_beside(
                        numbers, k, x0, y0, y1, boxes, spans, left, hidden, light, taken, owner,
                        touched,
                    )  # fmt: skip
                else:
                    _absorb(k, x0, y0, y1, boxes, spans, left, light, touched)
            _finish(image, clear, ground[t], x0, y0, y1, light, touched, encoding, place)


@njit()
def _finish(
    image: NDArray[np.uint8],
    clear: NDArray[np.uint8],
    ground: NDArray[np.float32],
    x0: int,
    y0: int,
    y1: int,
    light: NDArray[np.float32],
    touched: NDArray[np.bool_],
    encoding: NDArray[np.uint8],
    place: NDArray[np.uint32],
) -> None:
    """Encode the tile at (x0, y0) with its ground; copy pixels without markers from `clear`."""
    most, half = np.float32(encoding.shape[0] - 1), np.float32(0.5)
    # Unsigned indices need no check for negative ones: these loops vectorise.
    start, wide = np.uint64(3 * x0), np.uint64(3 * LANES)
    for y in range(y0, y1):
        any_touched = False
        for h in range(touched.shape[1]):
            any_touched |= touched[y - y0, h]
        if not any_touched:
            for j in range(min(np.uint64(light.shape[1]), np.uint64(image.shape[1]) - start)):
                image[y, start + j] = clear[y, start + j]
            continue
        for j in range(np.uint64(light.shape[1])):  # a tile index would stop vectorising
            value = ground[y - y0, j] * light[y - y0, j]  # dyes add no light
            place[j] = np.uint32(np.int32(value * most + half))
        for h in range(np.uint64(TILE // LANES)):
            first = wide * h
            last = min(first + wide, np.uint64(max(image.shape[1] - 3 * x0, 0)))
            if touched[y - y0, h]:
                for j in range(first, last):
                    image[y, start + j] = encoding[place[j]]
            else:
                for j in range(first, last):
                    image[y, start + j] = clear[y, start + j]


@njit()
def union(
    numbers: Any,
    boxes: Any,
    width: float,
    square: bool,
    ramp: NDArray[np.float32],
    covered: NDArray[np.float32],
    spans: NDArray[np.int64],
    out: NDArray[np.float32],
) -> None:
    """Compute the share of each pixel that any marker of one layer covers.

    Parameters
    ----------
    numbers, boxes, width, square: as in `prepare`, one layer
    ramp, covered, spans: see `cover_pair`; large enough for any marker
    out: result, zeros before, shape (H, W)
    """
    one = np.float32(1.0)
    for k in range(boxes.shape[0]):
        if cover_pair(numbers[:, k], boxes[k], width, square, ramp, spans, covered) == 0:
            continue
        for row in range(boxes[k, 3] - boxes[k, 2]):
            y, start = boxes[k, 2] + row, LANES * spans[row, 0]
            at = LANES * spans[row, 2] - start
            for x in range(max(start, 0), min(LANES * spans[row, 1], out.shape[1])):
                out[y, x] = min(out[y, x] + covered[0, at + x], one)


@njit(inline="always")
def _blocks(span: Any, tile: int) -> tuple[int, int]:
    """First and last + 1 block of a row inside the tile that starts at block `tile`."""
    return max(span[0] - tile, 0), min(span[1] - tile, TILE // LANES)


@njit()
def _absorb(
    k: int, x0: int, y0: int, y1: int, boxes: Any, spans: Any, left: Any, light: Any, touched: Any
) -> None:
    """Apply a pair's absorption to the tile at (x0, y0), in which no pairs meet."""
    tile = x0 // LANES
    for y in range(max(boxes[k, 2], y0), min(boxes[k, 3], y1)):
        span = spans[k, y - boxes[k, 2]]
        first, last = _blocks(span, tile)
        if first < last:
            for h in range(first, last):
                touched[y - y0, h] = True
            of_left = np.uint64(3 * LANES * (span[2] + first + tile - span[0]))
            of_light = np.uint64(3 * LANES * first)
            for j in range(np.uint64(3 * LANES * (last - first))):
                light[y - y0, of_light + j] *= left[k, of_left + j]


@njit()
def _absorb_beside(
    numbers: Any,
    k: int,
    x0: int,
    y0: int,
    y1: int,
    boxes: Any,
    spans: Any,
    left: Any,
    hidden: Any,
    light: Any,
    taken: Any,
    owner: Any,
    touched: Any,
) -> None:
    """Apply a pair's absorption to a tile in which pairs meet, pixel by pixel.

    `taken` is the share of a pixel that pairs cover so far, `owner` the pair that covers most.
    """
    one, little, tile = np.float32(1.0), np.float32(1e-6), x0 // LANES
    partner, side = -1, one
    for y in range(max(boxes[k, 2], y0), min(boxes[k, 3], y1)):
        span = spans[k, y - boxes[k, 2]]
        first, last = _blocks(span, tile)
        for h in range(first, last):
            touched[y - y0, h] = True
        for x in range(LANES * first, LANES * last):
            j = x + LANES * (span[2] + tile - span[0])
            cover, before, share = hidden[k, j], taken[y - y0, x], one
            if before * cover > little:
                if owner[y - y0, x] != partner:
                    partner = owner[y - y0, x]
                    side = _side_by_side(numbers, k, partner)
                share = covered_by_both(before, cover, side) / (before * cover)
            if cover > before:
                owner[y - y0, x] = k
            taken[y - y0, x] = before + cover - share * before * cover
            for c in range(3):
                old = light[y - y0, 3 * x + c]
                light[y - y0, 3 * x + c] = beside(old, left[k, 3 * j + c], share)


@njit()
def _meet(members: Any, numbers: Any, width: float) -> bool:
    """Whether edges of different pairs that reach into a tile come close."""
    reach = (APART - 2.0 * EDGE_RANGE) * width  # half widths of pairs include their edges
    for a in range(1, members.shape[0]):
        for b in range(a):
            for i in range(numbers.shape[0]):
                n = numbers[i, members[a]]
                for j in range(numbers.shape[0]):
                    m = numbers[j, members[b]]
                    near = max(n[13], n[14]) + max(m[13], m[14]) + reach
                    if (n[0] - m[0]) ** 2 + (n[1] - m[1]) ** 2 < near * near:
                        return True
    return False


@njit()
def _side_by_side(numbers: Any, k: int, other: int) -> np.float32:
    """Odds ratio of the edges of two pairs, for those two discs that overlap most."""
    deepest = -1.0
    for i in range(numbers.shape[0]):
        n = numbers[i, k]
        for j in range(numbers.shape[0]):
            m = numbers[j, other]
            # A missing marker is NaN, and the comparison below is false.
            apart2 = (n[0] - m[0]) ** 2 + (n[1] - m[1]) ** 2
            r2, s2 = abs(n[2] * n[5] - n[3] * n[4]), abs(m[2] * m[5] - m[3] * m[4])
            if apart2 < 4.0 / min(r2, s2):
                deepest = max(deepest, crossing(1.0 / r2, 1.0 / s2, apart2))
    return np.float32(odds_ratio(math.acos(deepest)))


@njit()
def encode(linear: NDArray[np.float32], table: NDArray[np.uint8], out: NDArray[np.uint8]) -> None:
    """Encode a linear-light image (H, W, 3) as sRGB, with `colour.encoding_table`."""
    flat, result = linear.reshape(-1), out.reshape(-1)
    top = table.shape[0] - 1
    for i in range(flat.shape[0]):
        value = flat[i]
        index = int(min(max(value, 0.0), 1.0) * top + 0.5)
        result[i] = table[index]
