"""Variations of specimen and picture in the training, and the markers' shifts under them.

The plane of the chain is carried onto the skin by two harmonics, which is a convention and not a
law; layers follow the skin as a design says, but for what was poured. A read-out that has seen one
map only takes every other one for a force. Each variation is drawn for a snapshot; many have none.
"""

import math
from dataclasses import dataclass, fields
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..model import Fingertip
from ..render import (
    Membrane,
    SensorDesign,
    areas,
    carried_axes,
    centroids,
    harmonic_map,
    outlines,
)

Array = NDArray[np.float64]

#: Terms of the smooth motion that no map describes.
_TERMS = 4


@dataclass(frozen=True, kw_only=True)
class VariationRanges:
    """Ranges of the variations; a share of the snapshots has each.

    Attributes
    ----------
    nominal_share: of the snapshots that have no variation at all
    each_share: of the others that have one kind of variation
    azimuth_noise_deg: standard deviation of the error of every estimate of the load's azimuth [°]
    azimuth_deg: standard deviation of a further error of the azimuth [°]
    azimuth_by_twist: standard deviation of a further error of the azimuth, as a share of the twist,
        which turns the shear's pattern too
    off_plane_share: largest change of each part of the map off the chain's plane
    contraction: largest lateral contraction, as a share of the shear
    twist_deg: standard deviation of a twist about the grip's axis [°]
    twist_reach_deg: angle from the apex at which it begins to fall off, smallest and largest [°]
    twist_decay: power of the distance with which it falls off, smallest and largest
    follow_share: largest change of a layer's `follow`
    depth_share: largest change of a layer's depth
    unknown_share: motion that no map describes, as a share of the skin's, smallest and largest
    size_share: change of log sizes by blur and light where the skin has moved, smallest and largest
    """

    nominal_share: float = 0.5
    each_share: float = 0.35
    azimuth_noise_deg: float = 0.15
    azimuth_deg: float = 2.0
    azimuth_by_twist: float = 1.5
    off_plane_share: float = 0.16
    contraction: float = 0.3
    twist_deg: float = 5.0
    twist_reach_deg: tuple[float, float] = (5.0, 45.0)
    twist_decay: tuple[float, float] = (1.5, 6.0)
    follow_share: float = 0.14
    depth_share: float = 0.18
    unknown_share: tuple[float, float] = (0.002, 0.04)
    size_share: tuple[float, float] = (0.0005, 0.006)


@dataclass(frozen=True, kw_only=True)
class Variations:
    """Variations of S snapshots.

    Attributes
    ----------
    azimuth: by which the load is turned out of the plane [rad], shape (S,)
    off_plane: change of (radial, shear, axial, tilt) at φ = 90°, shape (S, 4)
    contraction: lateral, over the shear, shape (S,)
    twist: about the grip's axis [rad], shape (S,)
    twist_reach: angle from the apex at which it begins to fall off [rad], shape (S,)
    twist_decay: power of the distance with which it falls off, shape (S,)
    follow, depth: factors of each layer's, shape (S, 2)
    unknown: amounts (S, 2, Q, 3) of smooth motions of each layer along (r, θ, φ)
    unknown_form: (m, phase, θ, width) of each, shape (S, 2, Q, 4)
    sizes: amounts of smooth changes of log sizes of each layer, in the same forms, shape (S, 2, Q)
    """

    azimuth: Array
    off_plane: Array
    contraction: Array
    twist: Array
    twist_reach: Array
    twist_decay: Array
    follow: Array
    depth: Array
    unknown: Array
    unknown_form: Array
    sizes: Array

    def part(self, which: slice | NDArray[np.bool_]) -> "Variations":
        """Those of some snapshots."""
        return Variations(**{f.name: getattr(self, f.name)[which] for f in fields(self)})

    @classmethod
    def none(cls, count: int) -> "Variations":
        """No variation of any snapshot."""
        return cls(
            azimuth=np.zeros(count),
            off_plane=np.zeros((count, 4)),
            contraction=np.zeros(count),
            twist=np.zeros(count),
            twist_reach=np.ones(count),
            twist_decay=np.ones(count),
            follow=np.ones((count, 2)),
            depth=np.ones((count, 2)),
            unknown=np.zeros((count, 2, _TERMS, 3)),
            unknown_form=np.ones((count, 2, _TERMS, 4)),
            sizes=np.zeros((count, 2, _TERMS)),
        )


def random_variations(
    rng: np.random.Generator, chain: Array, ranges: VariationRanges
) -> Variations:
    """Variations of snapshots of the chain (S, N, 2) [m]."""
    count = len(chain)
    varied = rng.random(count) >= ranges.nominal_share

    def some(values: Array, neutral: float = 0.0) -> Array:
        which = varied & (rng.random(count) < ranges.each_share)
        return np.where(which.reshape(-1, *[1] * (values.ndim - 1)), values, neutral)

    def uniform(most: float, *shape: int) -> Array:
        return most * rng.uniform(-1.0, 1.0, (count, *shape))

    moved = np.sqrt((chain**2).sum(axis=2).mean(axis=1))
    amount = moved * log_uniform(rng, ranges.unknown_share, count)
    unknown = amount[:, None, None, None] * rng.standard_normal((count, 2, _TERMS, 3))
    # Motion of the skin moves both layers, that of a layer one.
    unknown[:, 1] = np.where(rng.random((count, 1, 1)) < 0.5, unknown[:, 0], unknown[:, 1])
    form = np.stack(
        [
            rng.integers(0, 4, (count, 2, _TERMS)).astype(float),
            rng.uniform(0.0, 2.0 * np.pi, (count, 2, _TERMS)),
            rng.uniform(0.0, 1.2, (count, 2, _TERMS)),
            rng.uniform(0.2, 0.8, (count, 2, _TERMS)),
        ],
        axis=-1,
    )
    form[:, 1] = np.where(
        (unknown[:, 1] == unknown[:, 0]).all(axis=(1, 2))[:, None, None], form[:, 0], form[:, 1]
    )
    # Motion of the skin at which blur and light have changed sizes by half of what they do [m].
    moved_m = 1e-4
    sizes = log_uniform(rng, ranges.size_share, count) * moved / (moved + moved_m)
    # The estimate of the azimuth is never exact.
    azimuth = np.deg2rad(ranges.azimuth_noise_deg * rng.standard_normal(count))
    azimuth += some(np.deg2rad(ranges.azimuth_deg) * rng.standard_normal(count))
    twist = some(np.deg2rad(ranges.twist_deg) * rng.standard_normal(count))
    azimuth += ranges.azimuth_by_twist * twist * rng.standard_normal(count)
    return Variations(
        azimuth=azimuth,
        off_plane=some(uniform(ranges.off_plane_share, 4)),
        contraction=some(uniform(ranges.contraction)),
        twist=twist,
        twist_reach=np.deg2rad(rng.uniform(*ranges.twist_reach_deg, count)),
        twist_decay=rng.uniform(*ranges.twist_decay, count),
        follow=some(1.0 + uniform(ranges.follow_share, 2), 1.0),
        depth=some(1.0 + uniform(ranges.depth_share, 2), 1.0),
        unknown=some(unknown),
        unknown_form=form,
        sizes=some(sizes[:, None, None] * rng.standard_normal((count, 2, _TERMS))),
    )


def log_uniform(rng: np.random.Generator, limits: tuple[float, float], count: int) -> Array:
    """Numbers between limits, each factor as likely."""
    low, high = (math.log(limit) for limit in limits)
    return np.exp(rng.uniform(low, high, count))


def varied_shifts(
    sensor: SensorDesign, places: Array, tip: Fingertip, chain: Array, variations: Variations
) -> Array:
    """Shifts (x, y, log size) of both layers of pairs since rest, shape (S, P, 6).

    A marker at another depth is taken to be under the same place of the skin, as it is where the
    camera sits in the middle of the dome.

    Parameters
    ----------
    sensor: design
    places: of the pairs, shape (P, 2)
    tip: the chain
    chain: displacements of its nodes [m], shape (S, N, 2)
    variations: of the S snapshots
    """
    markers = _Markers(sensor, places, tip)
    at_once = 50  # snapshots at a time: all of them would need much memory
    parts = [
        markers.shifts(chain[k : k + at_once], variations.part(slice(k, k + at_once)))
        for k in range(0, len(chain), at_once)
    ]
    return np.concatenate(parts)


class _Markers:
    """Markers of a design at P places, both layers above each other."""

    #: Step of derivatives by differences [rad].
    nudge = 1e-4

    def __init__(self, sensor: SensorDesign, places: Array, tip: Fingertip) -> None:
        self._sensor, self._places = sensor, places
        self._carry = harmonic_map(sensor.shape, places, tip.angles())

    def shifts(self, chain: Array, variations: Variations) -> Array:
        count, nodes = chain.shape[:2]
        flat = chain.transpose(1, 0, 2).reshape(nodes, -1)
        carry = self._carry

        def at(matrix: object) -> Array:
            """Values (S, P, 2) of the chain at the places."""
            return np.asarray(matrix @ flat).reshape(-1, count, 2).transpose(1, 0, 2)  # type: ignore[operator]

        value = _harmonics(at(carry.right), at(carry.left))
        slope = _harmonics(at(carry.right_slope), at(carry.left_slope))
        theta, phi = self._places.T
        displaced = partial(_displacement, self._sensor.shape.radius)
        parts = []
        for layer in range(2):
            moved = displaced(theta, phi, value, variations, layer)
            ahead, back = (
                displaced(theta, phi + h, value, variations, layer)
                for h in (self.nudge, -self.nudge)
            )
            # What the chain carries is held still here: its slope comes after.
            up, down = (
                displaced(theta + h, phi, value, variations, layer)
                for h in (self.nudge, -self.nudge)
            )
            along = displaced(theta, phi, slope, variations, layer, derivative=True)
            along = along + (up - down) / (2.0 * self.nudge)
            around = (ahead - back) / (2.0 * self.nudge) / carry.ring[:, None]
            here = self._measured(layer, variations, moved, along, around)
            here = here - self._at_rest(layer, variations)
            turned = phi - variations.azimuth[:, None]
            waves = _waves(theta, turned, variations.unknown_form[:, layer])
            here[..., 2] += np.einsum("sqp,sq->sp", waves, variations.sizes[:, layer])
            parts.append(here)
        return np.concatenate(parts, axis=-1)

    def _at_rest(self, layer: int, variations: Variations) -> Array:
        """Places and log sizes (S, P, 3) of markers at rest, which only their depth changes."""
        deep = variations.depth[:, layer] != 1.0
        zero = np.zeros((1, len(self._places), 3))
        rest = self._measured(layer, Variations.none(1), zero, zero, zero)
        rest = np.repeat(rest, len(deep), axis=0)
        if deep.any():
            zero = np.repeat(zero, deep.sum(), axis=0)
            rest[deep] = self._measured(layer, variations.part(deep), zero, zero, zero)
        return rest

    def _measured(
        self, layer: int, variations: Variations, moved: Array, along: Array, around: Array
    ) -> Array:
        """Places and log sizes (S, P, 3) of displaced markers."""
        sensor, skin = self._sensor, self._sensor.shape
        depth = (variations.depth[:, layer] * sensor.depths[layer])[:, None]
        follow = (variations.follow[:, layer] * sensor.follow[layer])[:, None, None]
        # Points of a dome scale with their distance from its centre.
        top = skin.points(self._places, 0.0)
        rest = top * (1.0 - depth / skin.radius)[..., None]
        metric = (skin.radius - depth)[..., None, None]
        tangents = np.stack(skin.tangents(self._places), axis=-1)
        slope = np.stack([along, around], axis=-1)
        strain = follow[..., None] / metric * slope
        half_size = sensor.half_sizes[layer]
        axes = carried_axes(sensor.markers, half_size, tangents, strain, moved, follow[..., 0])
        image = outlines(Membrane(centres=rest + follow * moved, axes=axes), sensor.view)
        log_size = 0.5 * np.log(areas(image, False))
        return np.concatenate([centroids(image, False), log_size[..., None]], axis=-1)


def _harmonics(right: Array, left: Array) -> tuple[Array, Array, Array, Array]:
    """Radial, shear, axial and tilt part, each (S, P), of values (S, P, 2) at ±θ."""
    return (
        (right[..., 0] - left[..., 0]) / 2,
        (right[..., 0] + left[..., 0]) / 2,
        (right[..., 1] + left[..., 1]) / 2,
        (right[..., 1] - left[..., 1]) / 2,
    )


def _displacement(
    radius: float,
    theta: Array,
    phi: Array,
    parts: tuple[Array, Array, Array, Array],
    v: Variations,
    layer: int,
    *,
    derivative: bool = False,
) -> Array:
    """Displacement (S, P, 3) at places of a dome, by the chain and by what no chain describes.

    With `derivative` the parts are those of the chain's derivative along θ, of which only the
    turning is left to do.
    """
    turned = phi - v.azimuth[:, None]
    cos, sin = np.cos(turned), np.sin(turned)
    aside = sin**2
    radial, shear, axial, tilt = (
        part * (1.0 + v.off_plane[:, k, None] * aside) for k, part in enumerate(parts)
    )
    drawn_in = v.contraction[:, None] * parts[1] * sin * cos
    total = np.stack([radial * cos + shear, radial * sin - drawn_in, axial + tilt * cos], axis=-1)
    if not derivative:
        moves = np.asarray(v.unknown[:, layer].any(axis=(1, 2)))
        total[moves] += _unknown(theta, turned[moves], v.part(moves), layer)
    some = np.asarray(v.twist != 0.0)
    at_rest = 0.0 if derivative else radius * np.sin(theta)
    total[some] += _twist(theta, turned[some], v.part(some), total[some], at_rest)
    c, s = np.cos(v.azimuth)[:, None], np.sin(v.azimuth)[:, None]
    x, y = total[..., 0].copy(), total[..., 1].copy()
    total[..., 0], total[..., 1] = c * x - s * y, s * x + c * y
    return total


def _twist(theta: Array, phi: Array, v: Variations, moved: Array, at_rest: Array | float) -> Array:
    """Further displacement (S, P, 3) by a turn about the axis of points that have moved.

    Parameters
    ----------
    theta, phi: places, shapes (P,) and (S, P)
    v: variations
    moved: displacement without the twist [m], shape (S, P, 3)
    at_rest: distance of the places from the axis [m], shape (P,)
    """
    # As far outside the contact as that of a half space under a turned disc, or otherwise.
    reach = v.twist_reach[:, None]
    share = (1.0 + (theta / reach) ** 4) ** (-0.25 * v.twist_decay[:, None])
    angle = v.twist[:, None] * share
    cos, sin = np.cos(angle) - 1.0, np.sin(angle)
    x, y = at_rest * np.cos(phi) + moved[..., 0], at_rest * np.sin(phi) + moved[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y, np.zeros_like(x)], axis=-1)


def _waves(theta: Array, phi: Array, form: Array) -> Array:
    """Smooth functions of the place (S, Q, P) of forms (S, Q, 4), see `Variations`."""
    m, phase, middle, width = np.moveaxis(form, -1, 0)[..., None]
    wave: Array = np.cos(m * phi[:, None] + phase) * np.exp(-(((theta - middle) / width) ** 2))
    return wave


def _unknown(theta: Array, phi: Array, v: Variations, layer: int) -> Array:
    """Motion that no map describes (S, P, 3) [m]."""
    waves = _waves(theta, phi, v.unknown_form[:, layer])
    radial, along, around = np.einsum("sqp,sqk->ksp", waves, v.unknown[:, layer])
    cos, sin = np.cos(phi), np.sin(phi)
    up, out = np.cos(theta), np.sin(theta)
    outwards = radial * out + along * up
    return np.stack(
        [outwards * cos - around * sin, outwards * sin + around * cos, radial * up - along * out],
        axis=-1,
    )
