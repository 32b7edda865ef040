"""Coverage of a pixel by a blurred marker: the profile that is painted and that trackers fit."""

import math

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit

Array = NDArray[np.float64]

#: An edge reaches over ± this many standard deviations of the blur.
EDGE_RANGE = 3.5
#: Φ(EDGE_RANGE·u) − 1/2 on −1…1 as an odd polynomial in u, within 3e-5: no table, no branch.
_C1 = np.float32(1.395861965)
_C3 = np.float32(-2.832835122)
_C5 = np.float32(5.022045093)
_C7 = np.float32(-6.455834289)
_C9 = np.float32(5.579158215)
_C11 = np.float32(-2.845730945)
_C13 = np.float32(0.637130102)
#: Its derivative: each coefficient times its power.
_D3 = np.float32(3) * _C3
_D5 = np.float32(5) * _C5
_D7 = np.float32(7) * _C7
_D9 = np.float32(9) * _C9
_D11 = np.float32(11) * _C11
_D13 = np.float32(13) * _C13
#: Literals in float32: a float64 one would make the whole expression float64.
_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
#: Lower bound of the radicand of a root in a denominator.
_LITTLE = np.float32(1e-6)
#: Odds ratio of edges that face each other; a smaller one is below float32's rounding.
_FACING = 1e-3
#: Odds ratio of edges that run side by side; a larger one is beyond float32's rounding.
SIDE_BY_SIDE = 1e6
#: Edges further apart than this many standard deviations do not meet.
APART = 4.0
#: Exponent of √η at Φ₂(0, 0) in the odds ratio; it fits all of Φ₂ best. 2 fits its middle exactly.
_STEEPER = 2.22


def edge_width(blur: float) -> float:
    """Standard deviation of an edge [px]: lens blur and the pixel's box, of variance 1/12.

    Parameters
    ----------
    blur: standard deviation of the lens blur [px]
    """
    return math.sqrt(blur**2 + 1.0 / 12.0)


@njit(inline="always")
def edge(inside: np.float32) -> np.float32:
    """Coverage at a distance inside the edge, in units of EDGE_RANGE standard deviations."""
    u = min(max(inside, -_ONE), _ONE)
    t = u * u
    q = t * t  # in three short chains instead of a long one, which processors wait for
    p = (_C1 + t * _C3) + q * ((_C5 + t * _C7) + q * ((_C9 + t * _C11) + q * _C13))
    return _HALF + u * p


@njit(inline="always")
def edge_slope(inside: np.float32) -> np.float32:
    """Derivative of `edge` with respect to `inside`; 0 beyond its range."""
    u = min(max(inside, -_ONE), _ONE)
    t = u * u
    q = t * t
    p = (_C1 + t * _D3) + q * ((_D5 + t * _D7) + q * ((_D9 + t * _D11) + q * _D13))
    return p if abs(inside) < _ONE else _ZERO


@njit()
def signed_distance(
    dx: float, dy: float, inverse: Array, correction: float
) -> tuple[float, float, float]:
    """First-order distance from a point to an ellipse's edge, positive inside.

    Parameters
    ----------
    dx, dy: offset of the point from the ellipse's centre [px]
    inverse: inverse of the matrix whose columns are the semi-axes [1/px], shape (2, 2)
    correction: s²/2 [px²], s the blur; it moves the half level of an edge of radius R inwards by
        s²/(2R)

    Returns
    -------
    distance [px] and its gradient (x, y).
    """
    qx = inverse[0, 0] * dx + inverse[0, 1] * dy
    qy = inverse[1, 0] * dx + inverse[1, 1] * dy
    radius = math.sqrt(qx * qx + qy * qy)
    if radius < 1e-9:
        return 1e9, 0.0, 0.0
    gx = (inverse[0, 0] * qx + inverse[1, 0] * qy) / radius
    gy = (inverse[0, 1] * qx + inverse[1, 1] * qy) / radius
    slope = math.sqrt(gx * gx + gy * gy)
    return (1.0 - radius) / slope - correction * slope, -gx / slope, -gy / slope


@njit()
def togetherness(first: Array, second: Array) -> float:
    """Odds ratio η of the edges of two discs where they cross; NaN if a disc is missing.

    It determines the share of a pixel that both discs cover, see `covered_by_both`. A lens blurs
    the light behind both dyes, not each dye. Two straight edges at distances d₁ and d₂, with the
    cosine ρ between their normals, both cover the share Φ₂(d₁, d₂; ρ) of the blur (bivariate normal
    distribution). Plackett's distribution (1965) with the odds ratio η is algebraic and within
    0.012 of Φ₂. η is 1 for edges that cross at right angles: both cover the product of the
    coverages. It is ∞ for edges side by side: both cover the smaller coverage. It is 0 for edges
    that face each other: both cover nothing.

    Parameters
    ----------
    first, second: coefficients (c, a₁, a₂, …) of the outlines [px], shape (3 or more, 2)
    """
    r2 = abs(first[1, 0] * first[2, 1] - first[2, 0] * first[1, 1])
    s2 = abs(second[1, 0] * second[2, 1] - second[2, 0] * second[1, 1])
    apart2 = (first[0, 0] - second[0, 0]) ** 2 + (first[0, 1] - second[0, 1]) ** 2
    cosine = crossing(r2, s2, apart2)
    return cosine if math.isnan(cosine) else odds_ratio(math.acos(cosine))


@njit(inline="always")
def crossing(r2: float, s2: float, apart2: float) -> float:
    """Cosine of the angle at which two circles cross, from squared radii and distance [px²].

    If they do not cross, their nearest edges are parallel: the cosine is 1 or −1.
    """
    return min(max((r2 + s2 - apart2) / (2.0 * math.sqrt(r2 * s2)), -1.0), 1.0)


@njit()
def odds_ratio(angle: float) -> float:
    """Odds ratio of edges whose normals enclose an angle [rad], see `togetherness`."""
    # Φ₂(0, 0; ρ), from which √η follows.
    both = max(0.5 - angle / (2.0 * math.pi), 0.0)
    root = 2.0 * both / max(1.0 - 2.0 * both, 1e-9)
    return min(max(root**_STEEPER, _FACING), SIDE_BY_SIDE)


@njit(inline="always")
def covered_by_both(first: np.float32, second: np.float32, odds: np.float32) -> np.float32:
    """Share of a pixel that is covered by both of two markers.

    Parameters
    ----------
    first, second: share that each marker covers
    odds: odds ratio of their edges, see `togetherness`
    """
    more, apart = odds - _ONE, first - second
    either = first + second - _TWO * first * second
    square = _ONE + _TWO * more * either + more * more * apart * apart
    root = np.sqrt(max(square, _ZERO))
    return _TWO * odds * first * second / (_ONE + more * (first + second) + root)


@njit(inline="always")
def covered_slope(first: np.float32, second: np.float32, odds: np.float32) -> np.float32:
    """Derivative of `covered_by_both` with respect to the first coverage."""
    more, apart = odds - _ONE, first - second
    either = first + second - _TWO * first * second
    root = np.sqrt(max(_ONE + _TWO * more * either + more * more * apart * apart, _LITTLE))
    return _HALF - _HALF * (_ONE - _TWO * second + more * apart) / root


@njit(inline="always")
def beside(first: np.float32, second: np.float32, share: np.float32) -> np.float32:
    """Share of light that passes two neighbouring marker pairs.

    Parameters
    ----------
    first, second: share of light that passes each pair alone
    share: coverage by both pairs over the product of their coverages: 0 where their edges face each
        other, so that absorptions add up; 1 where one lies on the other, so that light multiplies
    """
    return first + second - _ONE + share * (_ONE - first) * (_ONE - second)


@njit()
def shared_coverage(
    first: NDArray[np.float32], second: NDArray[np.float32], angle: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Apply `covered_by_both` to images (H, W) of coverages and of the angle of the edges [rad]."""
    shared = np.empty_like(first)
    for y in range(first.shape[0]):
        for x in range(first.shape[1]):
            odds = np.float32(odds_ratio(angle[y, x]))
            shared[y, x] = covered_by_both(first[y, x], second[y, x], odds)
    return shared
