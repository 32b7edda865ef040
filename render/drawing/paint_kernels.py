"""Compiled painting: tiles of the image, each finished in cache. `painter.py` documents the use.

A tile's pixels depend only on the markers that reach into it, in their order: an image of which
changed tiles alone were redrawn is, bit for bit, the image redrawn in full.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit
from .coverage import APART, EDGE_RANGE, beside, covered_by_both, crossing, odds_ratio
from .marker_kernels import LANES, TILE


@njit()
def paint_tiles(
    image: NDArray[np.uint8],
    clear: NDArray[np.uint8],
    ground: NDArray[np.float32],
    numbers: Any,
    boxes: Any,
    covered: NDArray[np.float32],
    spans: NDArray[np.int64],
    absorbed: NDArray[np.float32],
    encoding: NDArray[np.uint8],
    dirty: NDArray[np.bool_],
    width: float,
) -> None:
    """Redraw the dirty tiles and mark them clean.

    Parameters
    ----------
    image: sRGB, drawn into, shape (H, 3·W)
    clear: sRGB without markers, shape (H, 3·W)
    ground: linear light without markers, not negative, shape (3, H, at least W and whole blocks)
    numbers, boxes, covered, spans: of `update_coverage`, two layers
    absorbed: 1 − transmittance of each layer's dye, shape (2, 3)
    encoding: `colour.encoding_table()`
    dirty: tiles to draw
    width: standard deviation of an edge [px]
    """
    rows, cols = dirty.shape
    # Pairs of each dirty tile, by counting: ends[t] − ends[t − 1] of them, in their order.
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
    light = np.empty((TILE, TILE // LANES, 3 * LANES), dtype=np.float32)
    taken = np.empty((TILE, TILE // LANES, LANES), dtype=np.float32)
    owner = np.empty((TILE, TILE // LANES, LANES), dtype=np.int64)
    touched = np.empty((TILE, TILE // LANES), dtype=np.bool_)
    place = np.empty(3 * LANES, dtype=np.uint32)
    most, half = np.float32(encoding.shape[0] - 1), np.float32(0.5)
    for row in range(rows):
        for col in range(cols):
            if not dirty[row, col]:
                continue
            dirty[row, col] = False
            t = row * cols + col
            y0, x0 = row * TILE, col * TILE
            y1, x1 = min(y0 + TILE, image.shape[0]), min(x0 + TILE, image.shape[1] // 3)
            # Indices that start at 0 need no check for negative ones: these loops vectorise.
            out, unmarked = image[y0:y1, 3 * x0 : 3 * x1], clear[y0:y1, 3 * x0 : 3 * x1]
            for y in range(out.shape[0]):
                for j in range(out.shape[1]):
                    out[y, j] = unmarked[y, j]
            if ends[t] == ends[t + 1]:
                continue
            for y in range(TILE):
                for h in range(TILE // LANES):
                    touched[y, h] = False
            meet = _meet(members[ends[t] : ends[t + 1]], numbers, width)
            for i in range(ends[t], ends[t + 1]):
                k = members[i]
                if meet:
                    _absorb_beside(
                        absorbed, numbers, k, x0, y0, y1, boxes, spans, covered, light, taken,
                        owner, touched,
                    )  # fmt: skip
                else:
                    _absorb(absorbed, numbers, k, x0, y0, y1, boxes, spans, covered, light, touched)
            for y in range(y1 - y0):
                for h in range(TILE // LANES):
                    if touched[y, h]:
                        x = x0 + LANES * h
                        for c in range(3):
                            for j in range(light.shape[2] // 3):
                                value = ground[c, y0 + y, x + j] * light[y, h, LANES * c + j]
                                level = np.int32(value * most + half)  # dyes add no light
                                place[LANES * c + j] = np.uint32(level)
                        for j in range(min(LANES, x1 - x)):
                            image[y0 + y, 3 * (x + j)] = encoding[place[j]]
                            image[y0 + y, 3 * (x + j) + 1] = encoding[place[LANES + j]]
                            image[y0 + y, 3 * (x + j) + 2] = encoding[place[2 * LANES + j]]


@njit()
def union(boxes: Any, covered: NDArray[np.float32], spans: Any, out: NDArray[np.float32]) -> None:
    """Share of each pixel that any marker of the first layer covers, into zeros, shape (H, W)."""
    one = np.float32(1.0)
    for k in range(boxes.shape[0]):
        for row in range(boxes[k, 3] - boxes[k, 2]):
            y, start = boxes[k, 2] + row, LANES * spans[k, row, 0]
            for x in range(max(start, 0), min(LANES * spans[k, row, 1], out.shape[1])):
                out[y, x] = min(out[y, x] + covered[k, 0, row, x - start], one)


@njit(inline="always")
def _blocks(span: Any, tile: int) -> tuple[int, int]:
    """First and last + 1 block of a row that lie in the tile which starts at block `tile`."""
    return max(span[0] - tile, 0), min(span[1] - tile, TILE // LANES)


@njit()
def _absorb(
    absorbed: Any,
    numbers: Any,
    k: int,
    x0: int,
    y0: int,
    y1: int,
    boxes: Any,
    spans: Any,
    covered: Any,
    light: Any,
    touched: Any,
) -> None:
    """Take away what a pair's dyes absorb in the tile at (x0, y0), where no other one meets it."""
    one, tile = np.float32(1.0), x0 // LANES
    r0, g0, b0 = absorbed[0, 0], absorbed[0, 1], absorbed[0, 2]
    r1, g1, b1 = absorbed[1, 0], absorbed[1, 1], absorbed[1, 2]
    together = numbers[0, k, 15]
    odds = together if together == together else one  # a lone marker has no partner
    known = covered.shape[1] == 3
    for y in range(max(boxes[k, 2], y0), min(boxes[k, 3], y1)):
        row = y - boxes[k, 2]
        first, last = _blocks(spans[k, row], tile)
        for h in range(first, last):
            offset = LANES * (h + tile - spans[k, row, 0])
            fresh = not touched[y - y0, h]
            touched[y - y0, h] = True
            for j in range(light.shape[2] // 3):  # with LANES it would not become vector code
                c0, c1 = covered[k, 0, row, offset + j], covered[k, 1, row, offset + j]
                if known:
                    both = covered[k, 2, row, offset + j]
                else:
                    both = covered_by_both(c0, c1, odds)
                red = one - c0 * r0 - c1 * r1 + both * (r0 * r1)
                green = one - c0 * g0 - c1 * g1 + both * (g0 * g1)
                blue = one - c0 * b0 - c1 * b1 + both * (b0 * b1)
                if fresh:
                    light[y - y0, h, j] = red
                    light[y - y0, h, LANES + j] = green
                    light[y - y0, h, 2 * LANES + j] = blue
                else:
                    light[y - y0, h, j] *= red
                    light[y - y0, h, LANES + j] *= green
                    light[y - y0, h, 2 * LANES + j] *= blue


@njit()
def _absorb_beside(
    absorbed: Any,
    numbers: Any,
    k: int,
    x0: int,
    y0: int,
    y1: int,
    boxes: Any,
    spans: Any,
    covered: Any,
    light: Any,
    taken: Any,
    owner: Any,
    touched: Any,
) -> None:
    """The same in a tile in which pairs meet, one pixel after the other.

    `taken` is the share of a pixel that pairs cover so far, `owner` which of them covers most.
    """
    one, little, tile = np.float32(1.0), np.float32(1e-6), x0 // LANES
    together = numbers[0, k, 15]
    odds = together if together == together else one
    partner, side = -1, one
    for y in range(max(boxes[k, 2], y0), min(boxes[k, 3], y1)):
        row = y - boxes[k, 2]
        first, last = _blocks(spans[k, row], tile)
        for h in range(first, last):
            offset = LANES * (h + tile - spans[k, row, 0])
            if not touched[y - y0, h]:
                light[y - y0, h], taken[y - y0, h], owner[y - y0, h] = one, 0.0, k
            touched[y - y0, h] = True
            for j in range(LANES):
                c0, c1 = covered[k, 0, row, offset + j], covered[k, 1, row, offset + j]
                both = covered_by_both(c0, c1, odds)
                if covered.shape[1] == 3:
                    both = covered[k, 2, row, offset + j]
                cover, before, share = c0 + c1 - both, taken[y - y0, h, j], one
                if before * cover > little:
                    if owner[y - y0, h, j] != partner:
                        partner = owner[y - y0, h, j]
                        side = _side_by_side(numbers, k, partner)
                    share = covered_by_both(before, cover, side) / (before * cover)
                if cover > before:
                    owner[y - y0, h, j] = k
                taken[y - y0, h, j] = before + cover - share * before * cover
                for c in range(3):
                    a, b = absorbed[0, c], absorbed[1, c]
                    left = one - c0 * a - c1 * b + both * (a * b)
                    old = light[y - y0, h, LANES * c + j]
                    light[y - y0, h, LANES * c + j] = beside(old, left, share)


@njit()
def _meet(members: Any, numbers: Any, width: float) -> bool:
    """Whether edges of different pairs, of discs that reach into a tile, come close."""
    reach = (APART - 2.0 * EDGE_RANGE) * width  # what is wide is wide with its edges
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
    """Odds ratio of the edges of two pairs, where their discs are deepest in each other."""
    deepest = -1.0
    for i in range(numbers.shape[0]):
        n = numbers[i, k]
        for j in range(numbers.shape[0]):
            m = numbers[j, other]
            # A marker that is not there is nowhere, and no larger than anything.
            apart2 = (n[0] - m[0]) ** 2 + (n[1] - m[1]) ** 2
            r2, s2 = abs(n[2] * n[5] - n[3] * n[4]), abs(m[2] * m[5] - m[3] * m[4])
            if apart2 < 4.0 / min(r2, s2):
                deepest = max(deepest, crossing(1.0 / r2, 1.0 / s2, apart2))
    return np.float32(odds_ratio(math.acos(deepest)))


@njit()
def encode(linear: NDArray[np.float32], table: NDArray[np.uint8], out: NDArray[np.uint8]) -> None:
    """SRGB image (H, W, 3) of a linear-light one, by `colour.encoding_table`."""
    flat, result = linear.reshape(-1), out.reshape(-1)
    top = table.shape[0] - 1
    for i in range(flat.shape[0]):
        value = flat[i]
        index = int(min(max(value, 0.0), 1.0) * top + 0.5)
        result[i] = table[index]
