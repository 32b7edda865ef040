"""Smallest standard deviations of a contact's forces, µ and Γ that pictures of a dome allow.

1. (x, y, log size) of both layers of each marker pair against rest: the Cramér–Rao bound from the
   pixels, or that with the misfit that the reconstructor `contact` reckons with (`Noise`). The rest
   frames are the same for all pictures, and so is their noise.
2. *A contact*: the unknowns of `contact`, the object and its pose in each picture, with the spread
   of them that it takes as known before.
3. *Free tractions*: forces on the nodes of the last picture that are only known to be smooth, in
   the true zone of contact or anywhere. They do not tell µ by themselves: it is that of the nodes
   that slip, if it is known which do.

Both are posterior deviations of linear responses about the truth. Calibration, silicone and camera
are known, and there are no defects.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....model import Dome
from ....model.dome import lattice
from ....render import DomeMap, SensorDesign, layer_depths
from ....tracking.forces.dome import (
    FRICTION,
    INDEPENDENT,
    MOVING,
    ON_CORE,
    DomeResponse,
    moves_of,
    prior_of,
    units_of,
)
from ..positions import pair_limits
from .held import Held, sliding_of

Array = NDArray[np.float64]

#: Spread of free tractions over Young's modulus, and their correlation length over the radius.
SPREAD, LENGTH = 0.25, 0.1
#: The open zone: nodes up to so far from the apex [rad].
OPEN = math.radians(45.0)
#: A node slips where its friction is so much of what it can be.
_SLIPS = 0.9
#: Share of independent scatter that keeps a smooth correlation from being singular.
_ROUGH = 1e-6
#: Zones of free tractions, by name.
ZONES = ("zone known", "open zone")


@dataclass(frozen=True, kw_only=True)
class Noise:
    """What the markers' measured shifts are off by.

    Attributes
    ----------
    levels: standard deviation of each sRGB level
    place_px, log_size: misfit of every marker [px, 1], alike in all pictures beyond the first few
    frames: averaged in each picture
    rest_frames: averaged at rest
    """

    levels: float = 2.0
    place_px: float = 0.0
    log_size: float = 0.0
    frames: int = 1
    rest_frames: int = 16


@dataclass(frozen=True, kw_only=True)
class Deviations:
    """Smallest standard deviations in the last picture.

    Attributes
    ----------
    x, y, normal: of the force along x, along y and towards the core [N]
    moment: of the moment about the dome's axis [N·m]
    mu: of µ; NaN where nothing slips
    margin: of Γ; NaN where µ is
    """

    x: float
    y: float
    normal: float
    moment: float
    mu: float
    margin: float


class Seen:
    """What pictures of a contact show of it, for one sensor.

    Parameters
    ----------
    sensor: design, a dome with discs
    held: the contact
    """

    def __init__(self, sensor: SensorDesign, held: Held) -> None:
        self.held = held
        places = np.stack([sensor.places] * 2)
        self._open = min(OPEN, float(sensor.places[:, 0].max()))
        self._response = DomeResponse(sensor, held.dome, places)
        carry = DomeMap(sensor, held.dome, places)
        self._rest = pair_limits(sensor, carry(np.zeros_like(held.linear[0])))
        self._each = np.stack([pair_limits(sensor, carry(linear)) for linear in held.linear])

    def zone(self, name: str) -> NDArray[np.intp]:
        """Nodes of a zone of ZONES; an open one ends with the markers."""
        if name == ZONES[0]:
            return self.held.touching
        points, radius = lattice(self.held.dome).points, self.held.dome.radius
        return np.flatnonzero(points[:, 2] > math.cos(self._open) * radius)

    def noise(self, noise: Noise) -> Array:
        """Covariance of each pair's shifts in all K pictures, shape (P, 6·K, 6·K)."""
        count, pairs = self._each.shape[:2]
        size = self._each.shape[2]
        misfit = np.tile([noise.place_px, noise.place_px, noise.log_size], 2) ** 2
        # Errors of the model are alike in all pictures: together they count as a few.
        misfit *= max(1.0, count / INDEPENDENT)
        whole = np.zeros((pairs, count, size, count, size))
        whole += (noise.levels**2 / noise.rest_frames * self._rest)[:, None, :, None, :]
        for k in range(count):
            own = noise.levels**2 / noise.frames * self._each[k] + np.diag(misfit)
            whole[:, k, :, k] += own
        return whole.reshape(pairs, count * size, count * size)

    def contact(self, noise: Noise) -> Deviations:
        """Deviations of a contact that is fitted to all pictures."""
        slopes = self.contact_slopes()
        information = _information(slopes, self.noise(noise)) + contact_prior(self.held)
        units = units_of(self.held.dome)
        objects, last = len(units) - MOVING, slice(len(information) - MOVING, None)
        outputs = np.zeros((7, len(information)))
        outputs[:6, :objects] = self.held.slopes[:, MOVING:]
        outputs[:6, last] = self.held.slopes[:, :MOVING]
        outputs[6, FRICTION] = self.held.friction * units[MOVING + FRICTION]
        spread = outputs @ np.linalg.solve(information, outputs.T)
        return _deviations(self.held, spread, self.held.friction)

    def _along(self, linear: Array) -> Array:
        """Change of the shifts (C, P, 6) by changes of the forces on all nodes (C, N, 3)."""
        return self._response.along(np.arange(linear.shape[1]), linear)

    def contact_slopes(self) -> Array:
        """Shifts in all K pictures by the object, then each pose, over units, (P, 6·K, 8 + 4·K)."""
        count = len(self.held.linear)
        own = [self._along(changes) for changes in self.held.changes]
        pairs, objects = own[0].shape[1], len(own[0]) - MOVING
        slopes = np.zeros((pairs, count, 6, objects + MOVING * count))
        for k, each in enumerate(own):
            slopes[:, k, :, :objects] = np.moveaxis(each[MOVING:], 0, -1)
            here = slice(objects + MOVING * k, objects + MOVING * (k + 1))
            slopes[:, k, :, here] = np.moveaxis(each[:MOVING], 0, -1)
        return slopes.reshape(pairs, 6 * count, -1)

    def tractions(self, noises: Sequence[Noise], zone: NDArray[np.intp]) -> list[Deviations]:
        """Deviations of free tractions in a zone of nodes, seen in the last picture alone."""
        nodes, held = lattice(self.held.dome), self.held
        root = _root(nodes.points[zone], LENGTH * held.dome.radius)
        root *= SPREAD * held.dome.young * nodes.areas[zone, None]
        weights, mu = sum_weights(held, zone)
        slopes, sums = [], []
        for axis in range(3):
            forces = np.zeros((len(zone), *held.contact.linear.shape))
            forces[np.arange(len(zone)), zone, axis] = 1.0
            slopes.append(np.moveaxis(self._along(forces), 0, -1) @ root)
            sums.append(weights[..., axis] @ root)
        known, outputs = np.concatenate(slopes, axis=-1), np.concatenate(sums, axis=-1)
        found = []
        for noise in noises:
            information = _information(known, self.noise(noise)[:, -6:, -6:])
            information += np.eye(len(information))
            spread = outputs @ np.linalg.solve(information, outputs.T)
            found.append(_deviations(held, spread, mu))
        return found


def moving_layers(sensor: SensorDesign, dome: Dome) -> int:
    """How many layers of markers do not lie on the core."""
    depths = np.array(layer_depths(sensor, dome))
    return int((depths < (1.0 - ON_CORE) * dome.thickness).sum())


def contact_prior(held: Held) -> Array:
    """Information on the object and the poses before a picture is seen, over units."""
    dome, count = held.dome, len(held.poses)
    units, known = units_of(dome), prior_of(dome).deviation
    objects = len(known)
    information = np.zeros((objects + MOVING * count,) * 2)
    information[:objects, :objects] = np.diag((units[MOVING:] / known) ** 2)
    # Each pose is near the one before, the first one near rest.
    step = np.eye(count) - np.eye(count, k=-1)
    each = (units[:MOVING] / moves_of(dome, held.poses)) ** 2
    for axis in range(MOVING):
        here = slice(objects + axis, None, MOVING)
        information[here, here] = step.T @ (each[:, axis, None] * step)
    return information


def _information(slopes: Array, covariance: Array) -> Array:
    """Information on unknowns of slopes (P, Y, U) of values with covariances (P, Y, Y)."""
    white = np.linalg.solve(np.linalg.cholesky(covariance), slopes)
    flat = white.reshape(-1, white.shape[-1])
    return np.asarray(flat.T @ flat, np.float64)


def _root(points: Array, length: float) -> Array:
    """Root of a smooth correlation of places (n, 3) [m], shape (n, n)."""
    apart = ((points[:, None] - points) ** 2).sum(axis=-1)
    smooth = np.exp(-0.5 * apart / length**2) + _ROUGH * np.eye(len(points))
    return np.asarray(np.linalg.cholesky(smooth), np.float64)


def sum_weights(held: Held, zone: NDArray[np.intp]) -> tuple[Array, float]:
    """Sums of `held.sums` and the µ that slips, by the forces of nodes on the linear skin.

    Returns
    -------
    weights: of each node's force, shape (7, n, 3)
    mu: friction over pressure of the nodes that slip; NaN where none does
    """
    contact, points = held.contact, lattice(held.dome).points[zone]
    normals = contact.normals[zone].copy()
    free = ~normals.any(axis=1)
    normals[free] = -points[free] / held.dome.radius
    pressure, linear = (
        np.einsum("ij,ij->i", forces[zone], normals) for forces in (contact.forces, contact.linear)
    )
    # Rubber that is pressed against the core carries more than the linear skin.
    stiffer = np.where(linear > 0.0, pressure / np.where(linear > 0.0, linear, 1.0), 1.0)
    across = np.eye(3) - normals[:, :, None] * normals[:, None]
    along = stiffer[:, None] * normals
    whole = across + along[:, :, None] * normals[:, None]  # of all components, (n, 3, 3)
    slides = sliding_of(contact)
    size = float(np.linalg.norm(slides))
    way = slides / size if size > 0.0 else np.array([1.0, 0.0, 0.0])
    friction = contact.friction[zone]
    each = np.linalg.norm(friction, axis=1)
    slipping = (pressure > 0.0) & (each > _SLIPS * held.friction * pressure)
    push = float(pressure[slipping].sum())
    mu = float(each[slipping].sum()) / push if slipping.any() else math.nan
    own = friction[slipping] / each[slipping, None]
    ratio = np.zeros_like(normals)
    if slipping.any():
        ratio[slipping] = (
            np.einsum("ni,nij->nj", own, across[slipping]) - mu * along[slipping]
        ) / push
    moment = points[:, 0, None] * whole[:, 1] - points[:, 1, None] * whole[:, 0]
    rows = [whole[:, 0], whole[:, 1], -whole[:, 2], moment, along, way @ across, ratio]
    return np.stack(rows), mu


def _deviations(held: Held, spread: Array, mu: float) -> Deviations:
    """Deviations from the covariance of the sums and µ, shape (7, 7)."""
    pressing, sliding = held.sums[4:]
    slope = np.array([sliding / pressing, -1.0, sliding / mu]) / (mu * pressing)
    x, y, normal, moment = np.sqrt(np.diag(spread)[:4])
    told = math.isfinite(mu)
    margin = float(slope @ spread[4:, 4:] @ slope) if told else math.nan
    return Deviations(
        x=float(x),
        y=float(y),
        normal=float(normal),
        moment=float(moment),
        mu=math.sqrt(spread[6, 6]) if told else math.nan,
        margin=math.sqrt(margin) if told else math.nan,
    )
