"""Compiled templates of pairs. `templates.py` documents the use."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit
from .cholesky_kernels import factorise, invert_corner
from .light_kernels import place_of
from .neighbour_kernels import slopes_of
from .pixel_kernels import (
    BY,
    CHANGE,
    F0,
    GROUND,
    LEVEL,
    READ,
    TERM,
    WEIGHT,
    Array,
    Array32,
    row_at,
)
from .run_lanes import BLOCK, FINE, NOT_READ, SUMS, add_run

#: Unknowns of a pair: (x, y, e, p, q) of both layers, and the logarithms of three gains.
UNKNOWNS = 13
#: Offset of the sRGB curve, level = 255·1.055·light^(1/_POWER) − _TOE [grey levels] …
_TOE = np.float32(255.0 * 0.055)
#: … and its exponent.
_POWER = 2.4
#: First row for the derivatives of the level with respect to the coverage by each layer, in each
#: channel; uneven light uses these rows afterwards.
_STEEP = TERM
#: Rows of the normals of the edges of both layers.
_NORMALS = (CHANGE, CHANGE + 1, CHANGE + 5, CHANGE + 6)
#: Distance from the position of its template above which a pair is fitted without it [limits].
_NEAR = 5.0
#: Allowed motion of a neighbour since a template was made, over that of the pair itself.
_STALE = 0.5
#: Change of the light's slope above which a template is outdated [1/px].
SLOPED = 2e-4
#: Misfit over the typical one above which a pair is fitted with uneven light.
UNEVEN = 1.6
#: Distance from a pair's last pixels above which a neighbour does not matter to it [px].
_FAR = 1.5


class Pool(NamedTuple):
    """Templates of M pairs; see `templates`."""

    levels: NDArray[np.int16]  # (M, 3·N) expected levels of N pixels, block by block and channel
    tells: NDArray[np.int8]  # (M, 10·N) derivatives of levels by coverage, and edges' normals
    units: Array  # (M, 2) units of these two
    runs: NDArray[np.int32]  # (M, R, 3) row, first column and blocks of each of R runs
    counts: NDArray[np.int32]  # (M, 2) numbers of runs (0: no template) and of read pixels
    inverse: Array32  # (M, 13, 13) inverse of the information matrix of the unknowns
    fits: Array  # (M, 2, 5) parameters at which it was made
    gains: Array  # (M, 3) gains at which it was made
    slopes: Array  # (M, 5) slopes of the light at which it was made
    lit: Array  # (M, 2) slope of the light from the neighbours
    present: NDArray[np.bool_]  # (M, 2) whether the model had each layer's marker
    misfit: Array  # (M,) misfit when it was made
    covariance: Array  # (M, 9, 9) covariance of (x, y, e) of both layers and log gains
    seen: Array32  # (M, K, 2, 2) positions of relevant neighbours; NaN for others


class Around(NamedTuple):
    """Neighbours of each of M pairs, from which the light's slope is estimated."""

    near: NDArray[np.int64]  # (M, K) indices of the neighbours
    to_slope: Array  # (M, 2, K) matrices of `pair_fit._slope_matrices`


@njit()
def keep_template(
    optics: Any,
    present: NDArray[np.bool_],
    fits: Array,
    gains: Array,
    slopes: Array,
    extents: Array,
    m: int,
    count: int,
    runs: NDArray[np.int64],
    buffer: Array32,
    normal: Array,
    cross: Array,
    lights: Array,
    information: Array,
    pool: Any,
) -> None:
    """Make the template of pair m from its rows of the buffer; none if it does not fit the pool.

    Parameters
    ----------
    normal, cross, lights: information matrices of markers and light as in `fit_step`, not yet
        factorised
    information: working memory, shape (2, 13, 13)
    """
    pool.counts[m, 0] = 0
    number = blocks = 0
    while runs[number, 2] > 0:
        blocks += runs[number, 2]
        number += 1
    if number > pool.runs.shape[1] or 3 * BLOCK * blocks > pool.levels.shape[1]:
        return
    _unknown_information(normal, cross, lights, information[0])
    if not factorise(information[0], UNKNOWNS):
        return
    invert_corner(information[0], 0, information[1], pool.inverse[m])
    for run in range(number):
        for j in range(3):
            pool.runs[m, run, j] = runs[run, j]
    pool.counts[m, 0], pool.counts[m, 1] = number, count
    pool.fits[m], pool.gains[m] = fits[m], gains[m]
    pool.slopes[m], pool.lit[m], pool.present[m] = slopes[m], slopes[m, :2], present[m]
    _pack(optics, m, blocks, buffer, pool)
    _note_neighbours(optics, present, fits, extents, m, pool.seen[m])


@njit()
def _unknown_information(normal: Array, cross: Array, lights: Array, out: Array) -> None:
    """Assemble the information matrix of the unknowns; diagonal 1 for missing ones."""
    for k in range(2):
        for i in range(5):
            for n in range(2):
                for j in range(5):
                    out[5 * k + i, 5 * n + j] = normal[place_of(k, i, 5), place_of(n, j, 5)]
            for c in range(3):
                value = cross[c, place_of(k, i, 5)]
                out[5 * k + i, 10 + c] = out[10 + c, 5 * k + i] = value
    for c in range(3):
        for d in range(3):
            out[10 + c, 10 + d] = lights[c, c] if c == d else 0.0
    for i in range(UNKNOWNS):
        if not out[i, i] > 0.0:
            out[i, i] = 1.0


@njit()
def _pack(optics: Any, m: int, blocks: int, buffer: Array32, pool: Any) -> None:
    """Store levels, their derivatives by coverage, and normals of the edges as short integers."""
    size = blocks * BLOCK
    steep, normal = np.float32(1e-6), np.float32(1e-6)
    for c in range(3):
        a0, a1, b = optics.absorbed[0, c], optics.absorbed[1, c], optics.absorbed[2, c]
        first, second, weight = row_at(_STEEP + c), row_at(_STEEP + 3 + c), row_at(WEIGHT + c)
        for i in range(np.uint64(size)):
            slope = np.sqrt(buffer[weight + i] * optics.variance)
            light = buffer[row_at(GROUND + c) + i] * slope
            buffer[first + i] = light * (b * buffer[row_at(BY) + i] - a0)
            buffer[second + i] = light * (b * buffer[row_at(BY + 1) + i] - a1)
            steep = max(steep, abs(buffer[first + i]), abs(buffer[second + i]))
    for r in range(4):
        row = row_at(_NORMALS[r])
        for i in range(np.uint64(size)):
            normal = max(normal, abs(buffer[row + i]))
    most = np.float32(127.0)
    pool.units[m, 0], pool.units[m, 1] = steep / most, normal / most
    per_steep, per_normal = most / steep, most / normal
    for block in range(blocks):
        for j in range(BLOCK):
            at = np.uint64(block * BLOCK + j)
            read = buffer[row_at(READ) + at] > F0
            for c in range(3):
                level = np.rint(buffer[row_at(LEVEL + c) + at] * np.float32(FINE))
                level = min(max(level, np.float32(NOT_READ + 1)), np.float32(-NOT_READ - 1))
                tells = read and buffer[row_at(WEIGHT + c) + at] > F0
                kept = np.int16(level) if tells else np.int16(NOT_READ)
                pool.levels[m, (3 * block + c) * BLOCK + j] = kept
            for r in range(6):
                value = np.rint(buffer[row_at(_STEEP + r) + at] * per_steep)
                pool.tells[m, (10 * block + r) * BLOCK + j] = np.int8(value)
            for r in range(4):
                value = np.rint(buffer[row_at(_NORMALS[r]) + at] * per_normal)
                pool.tells[m, (10 * block + 6 + r) * BLOCK + j] = np.int8(value)


@njit()
def _note_neighbours(
    optics: Any, present: NDArray[np.bool_], fits: Array, extents: Array, m: int, seen: Array32
) -> None:
    """Store positions of the neighbours that reach the pixels of a pair, or nearly do."""
    reach = 2.0 * optics.reach * optics.width + _FAR
    for n, other in enumerate(optics.neighbours[m]):
        for k in range(2):
            seen[n, k, :] = np.nan
            if other < 0 or not present[other, k]:
                continue
            for own in range(2):
                if present[m, own]:
                    dx = fits[m, own, 0] - fits[other, k, 0]
                    dy = fits[m, own, 1] - fits[other, k, 1]
                    far = extents[m, own] + extents[other, k] + reach
                    if dx * dx + dy * dy < far * far:
                        seen[n, k, 0], seen[n, k, 1] = fits[other, k, 0], fits[other, k, 1]


@njit()
def follow(
    image: NDArray[np.uint8],
    optics: Any,
    around: Any,
    size: float,
    limit: float,
    pool: Any,
    present: NDArray[np.bool_],
    fits: Array,
    gains: Array,
    slopes: Array,
    misfit: Array,
    covariance: Array,
    active: NDArray[np.bool_],
) -> None:
    """Fit all pairs by their templates, as far as these are good enough.

    Parameters
    ----------
    image: sRGB image, shape (H, W, 3)
    optics: constants of the pixel model
    around: neighbours of each pair
    size: typical radius, which converts strain to motion of an edge [px]
    limit: largest motion of an edge since its template was made [px]
    pool: templates
    present: whether each layer's marker is searched, shape (M, 2)
    fits, gains, slopes: expected state of the pairs, fitted in place, shapes (M, 2, 5), (M, 3) and
        (M, 5)
    misfit: result: mean squared residual over noise variance, shape (M,)
    covariance: result: covariance of (x, y, e) of both layers and log gains, (M, 9, 9)
    active: result: pairs that need a fit without template, shape (M,)
    """
    flat, breadth = image.reshape(-1), image.shape[1]
    levels, tells = pool.levels.reshape(-1), pool.tells.reshape(-1)
    sums, gradient = np.empty(SUMS * BLOCK, dtype=np.float32), np.empty(UNKNOWNS, dtype=np.float32)
    fit, gain = np.empty((2, 5)), np.empty(3)
    for m in range(fits.shape[0]):
        active[m], misfit[m] = True, np.inf
        shift = 0.0
        for k in range(2):
            if present[m, k] != pool.present[m, k]:
                shift = np.inf
            for i in range(2 if present[m, k] else 0):
                shift = max(shift, abs(fits[m, k, i] - pool.fits[m, k, i]))
        if pool.counts[m, 0] == 0 or not shift < _NEAR * limit:
            continue
        _add_runs(flat, breadth, optics, m, pool, levels, tells, sums)
        squares = _gradient(optics, m, sums, pool, gradient)
        gained, moved = _template_step(m, size, pool, gradient, fit, gain)
        if not moved < _NEAR * limit:
            continue
        fits[m], gains[m] = fit, gain
        slopes[m], covariance[m] = pool.slopes[m], pool.covariance[m]
        active[m] = not moved < limit
        misfit[m] = max(squares - gained, 0.0) / max(3 * pool.counts[m, 1] - UNKNOWNS, 1)
    typical = max(1.0, _typical(misfit))
    for m in range(len(active)):
        # Do not fit a pair again in every frame if its full fit had a large misfit, too.
        if not misfit[m] < UNEVEN * max(typical, pool.misfit[m]):
            active[m] = True
    stale(optics.neighbours, around, limit, pool, fits, gains, active)


@njit()
def _typical(misfit: Array) -> float:
    """Median misfit of pairs with a fit; 1 without any."""
    found = misfit[np.isfinite(misfit)]
    return float(np.median(found)) if len(found) > 0 else 1.0


@njit()
def _add_runs(
    flat: NDArray[np.uint8],
    breadth: int,
    optics: Any,
    m: int,
    pool: Any,
    levels: NDArray[np.int16],
    tells: NDArray[np.int8],
    sums: Array32,
) -> None:
    """Add up the sums over all runs of a pair; see `add_run`."""
    black, at = optics.black, pool.fits[m]
    offsets = _offset(black[0]), _offset(black[1]), _offset(black[2])
    sums[:] = F0
    block = m * (pool.levels.shape[1] // (3 * BLOCK))
    for run in range(pool.counts[m, 0]):
        row, column, blocks = pool.runs[m, run, 0], pool.runs[m, run, 1], pool.runs[m, run, 2]
        first = 3 * (np.int64(row) * breadth + column)
        x, y = np.float32(column - at[0, 0]), np.float32(row - at[0, 1])
        add_run(
            flat, np.uint64(first), levels, tells, np.uint64(block), np.uint64(blocks), x, y,
            offsets, sums,
        )  # fmt: skip
        block += blocks


@njit()
def _template_step(
    m: int, size: float, pool: Any, gradient: Array32, fit: Array, gain: Array
) -> tuple[float, float]:
    """Step a pair from the state of its template.

    Returns
    -------
    Decrease of the sum of squares by the step, and largest motion of an edge [px].
    """
    gained = moved = 0.0
    for i in range(UNKNOWNS):
        change = F0
        for j in range(UNKNOWNS):
            change += pool.inverse[m, i, j] * gradient[j]
        gained += change * gradient[i]
        if i < 10:
            fit[i // 5, i % 5] = pool.fits[m, i // 5, i % 5] + change
            moved = max(moved, abs(float(change)) * (1.0 if i % 5 < 2 else size))
        else:
            gain[i - 10] = pool.gains[m, i - 10] * math.exp(change)
    return gained, moved


@njit()
def _offset(black: np.float32) -> np.float32:
    """Offset c such that (level + c)/_POWER is the level's derivative with respect to log light."""
    return (np.float32(255.0) - black) * np.float32(_TOE / 255.0) - black


@njit()
def _gradient(optics: Any, m: int, sums: Array32, pool: Any, gradient: Array32) -> float:
    """Compute the gradient by the unknowns from all sums; return the sum of squares."""
    per_variance = 1.0 / optics.variance
    for i in range(SUMS):
        o = i * BLOCK
        sums[i] = ((sums[o] + sums[o + 1]) + (sums[o + 2] + sums[o + 3])) + (
            (sums[o + 4] + sums[o + 5]) + (sums[o + 6] + sums[o + 7])
        )
    at = pool.fits[m]
    dx, dy = np.float32(at[0, 0] - at[1, 0]), np.float32(at[0, 1] - at[1, 1])
    unit = np.float32(pool.units[m, 0] * pool.units[m, 1] * per_variance)
    for k in range(2):
        o = 4 + 6 * k
        across, up = sums[o], sums[o + 1]
        xx, xy, yx, yy = sums[o + 2], sums[o + 3], sums[o + 4], sums[o + 5]
        if k == 1:  # coordinates are relative to the first layer
            xx += dx * across
            xy += dy * across
            yx += dx * up
            yy += dy * up
        gradient[5 * k], gradient[5 * k + 1] = unit * across, unit * up
        gradient[5 * k + 2] = unit * (xx + yy)
        gradient[5 * k + 3], gradient[5 * k + 4] = unit * (xx - yy), unit * (xy + yx)
    for c in range(3):
        gradient[10 + c] = np.float32(sums[1 + c] * per_variance / _POWER)
    return float(sums[0] * per_variance)


@njit()
def stale(
    near: NDArray[np.int64],
    around: Any,
    limit: float,
    pool: Any,
    fits: Array,
    gains: Array,
    active: NDArray[np.bool_],
) -> None:
    """Add to `active` the pairs whose surroundings have changed since their template was made.

    Parameters
    ----------
    near: indices of pairs that may come near each pair, shape (M, K)
    around: neighbours of each pair, for the slope of the light
    limit: largest motion of a pair itself [px]
    pool: templates
    fits, gains: present parameters and gains
    active: pairs fitted without template, shape (M,); pairs are added
    """
    slopes = np.empty((len(active), 2))
    slopes_of(gains, around.near, around.to_slope, slopes)
    most = _STALE * limit
    for m in range(len(active)):
        if not active[m] and pool.counts[m, 0] > 0:
            dx, dy = slopes[m, 0] - pool.lit[m, 0], slopes[m, 1] - pool.lit[m, 1]
            active[m] = not (abs(dx) < SLOPED and abs(dy) < SLOPED)
            for n in range(near.shape[1]):
                other = near[m, n]
                if other < 0:
                    break
                for k in range(2):
                    if (
                        abs(fits[other, k, 0] - pool.seen[m, n, k, 0]) > most
                        or abs(fits[other, k, 1] - pool.seen[m, n, k, 1]) > most
                    ):
                        active[m] = True


@njit()
def settle(
    optics: Any,
    around: Any,
    present: NDArray[np.bool_],
    pool: Any,
    fits: Array,
    gains: Array,
    slopes: Array,
    misfit: Array,
    extents: Array,
    fitted: NDArray[np.bool_],
) -> None:
    """Update the surroundings in new templates of pairs with uneven light, or next to such pairs.

    These pairs are first fitted under even light, and the template stored the surroundings of that
    fit, which differ from the final ones.

    Parameters
    ----------
    misfit: misfit of each pair, shape (M,)
    extents: extents of the markers, see `extents_of`, shape (M, 2)
    fitted: pairs whose templates were made in this frame, shape (M,)

    Other parameters are as in `follow`.
    """
    uneven = np.zeros(len(fitted), dtype=np.bool_)
    for m in range(len(fitted)):
        uneven[m] = slopes[m, 2:].any() or not math.isfinite(misfit[m])
    lit = np.empty((len(fitted), 2))
    slopes_of(gains, around.near, around.to_slope, lit)
    for m in range(len(fitted)):
        if fitted[m] and (uneven[m] or uneven[around.near[m]].any()):
            pool.lit[m] = lit[m]
            _note_neighbours(optics, present, fits, extents, m, pool.seen[m])
