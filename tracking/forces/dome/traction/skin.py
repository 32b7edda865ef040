"""Normal force and friction on each node, from the forces that the linear skin carries.

The object is not known, but the skin lies on it. A surface of two curvatures is fitted to the
deformed positions of each patch of touching nodes. Its normals split the forces, and the normal
part is stiffened like that of the body. The indentation of the object cannot be distinguished from
its curvature, as both are round. So the object is assumed to have a usual softness.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from .....model import Dome
from .....model.dome import SkinField, lattice, stiffening_of
from .settings import SkinSettings

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Parted:
    """Forces on n nodes in contact, split along the object's normals and across them.

    Attributes
    ----------
    displacement: displacements of the nodes [m], shape (n, 3)
    directions: unit vectors of the normal forces, away from the object, shape (n, 3)
    normal: normal forces [N], shape (n,)
    friction: friction forces [N], shape (n, 3)
    stiffening: factor on the linear skin's normal force, shape (n,)
    rim: share of the normal force that is on nodes at the rim of the contact
    """

    displacement: Array
    directions: Array
    normal: Array
    friction: Array
    stiffening: Array
    rim: float

    @property
    def added(self) -> float:
        """Share of the linear skin's normal force that stiffening adds."""
        return float(self.normal.sum() / (self.normal / self.stiffening).sum() - 1.0)

    @property
    def axis(self) -> Array:
        """Mean direction of the normal forces, shape (3,)."""
        whole = self.normal @ self.directions
        return np.asarray(whole / max(float(np.linalg.norm(whole)), 1e-12))


def neighbours(dome: Dome, settings: SkinSettings) -> Index:
    """Indices of each node and its neighbours, (N, K), padded with N."""
    points = lattice(dome).points
    tree = scipy.spatial.KDTree(points)
    lists = [tree.query_ball_point(point, settings.beside * dome.spacing) for point in points]
    out = np.full((len(points), max(len(each) for each in lists)), len(points))
    for row, each in zip(out, lists, strict=True):
        row[: len(each)] = each
    return out


class Skin:
    """Splits forces on one dome into normal force and friction.

    Parameters
    ----------
    dome: body
    settings: tuned parameters
    """

    def __init__(self, dome: Dome, settings: SkinSettings) -> None:
        self._dome, self._settings = dome, settings
        self._nodes = lattice(dome)
        self.beside = neighbours(dome, settings)
        self._field = SkinField(dome)

    def __call__(self, nodes: Index, linear: Array, friction: float) -> Parted:
        """Split the forces `linear` (n, 3) [N] of the linear skin on nodes (n,).

        Parameters
        ----------
        friction: µ, which determines how much of the contact slips, and so the stiffening
        """
        settings = self._settings
        forces = np.zeros_like(self._nodes.points)
        forces[nodes] = linear
        displacement = self._field(forces)[nodes]
        places = self._nodes.points[nodes] + displacement
        directions = -self._nodes.outwards[nodes]
        among = self._among(nodes)
        patches = _patches(among)
        for _ in range(settings.passes):
            normal, _, _ = self._parted(nodes, linear, directions, displacement, friction)
            pressure = normal / self._nodes.areas[nodes]
            pressure = np.maximum(pressure, settings.least_pressure * pressure.max())
            surface = places + settings.softness * pressure[:, None] * directions
            turned = np.empty_like(directions)
            for patch in patches:
                turned[patch] = self._normals(surface[patch], directions[patch], pressure[patch])
            directions = turned
        normal, tangential, factor = self._parted(nodes, linear, directions, displacement, friction)
        return Parted(
            displacement=displacement, directions=directions, normal=normal, friction=tangential,
            stiffening=factor, rim=float(normal[_at_rim(among)].sum() / normal.sum()),
        )  # fmt: skip

    def _parted(
        self, nodes: Index, linear: Array, directions: Array, displacement: Array, friction: float
    ) -> tuple[Array, Array, Array]:
        """Normal force (n,), friction (n, 3) and factor of stiffening (n,), for given normals."""
        along = np.einsum("ij,ij->i", linear, directions)
        tangential = linear - along[:, None] * directions
        along = np.maximum(along, 1e-12)
        depth = -np.einsum("ij,ij->i", displacement, self._nodes.outwards[nodes])
        depth = np.maximum(depth, 0.0) / self._dome.thickness
        forces = along[:, None] * directions + tangential
        law = stiffening_of(self._dome, friction, self._nodes.areas[nodes], forces, tangential)
        factor = 1.0 + law.share * depth**law.power
        return factor * along, tangential, factor

    def _normals(self, surface: Array, directions: Array, pressure: Array) -> Array:
        """Fit a surface to p positions (p, 3); return its normals, away from the object, (p, 3).

        In axes along its mean normal it is z = a + b·x + c·y + (d·x² + 2e·xy + f·y² + g·z²)/2. With
        g its largest curvature this is exactly a sphere or a cylinder, however far around it is.
        """
        settings = self._settings
        radius = self._dome.radius
        curve = settings.curve / radius
        slope = settings.slope
        prior = np.array([settings.height * radius, slope, slope, curve, 0.5 * curve, curve])
        weights = pressure / pressure.max()
        middle = weights @ surface / weights.sum()
        axis = -(pressure @ directions)
        bend, steep = 0.0, np.ones(len(surface))
        normals = directions
        for _ in range(settings.rounds):
            axes = _axes(axis)
            x, y, z = ((surface - middle) @ axes).T
            design = np.stack([np.ones_like(x), x, y, x**2 / 2, x * y, y**2 / 2], axis=1)
            weighted = design * (weights / (settings.roughness * steep) ** 2)[:, None]
            information = weighted.T @ design + np.diag(prior**-2)
            a = np.linalg.solve(information, weighted.T @ (z - bend * z**2 / 2))
            curves = np.linalg.eigvalsh([[a[3], a[4]], [a[4], a[5]]])
            most = settings.sharpest / radius
            bend = float(np.clip(curves[np.argmax(abs(curves))], -most, most))
            upright = np.maximum(1.0 - bend * z, settings.upright)
            slopes = np.stack([a[1] + a[3] * x + a[4] * y, a[2] + a[4] * x + a[5] * y], axis=1)
            normals = np.column_stack([slopes, -upright])
            steep = np.linalg.norm(normals, axis=1)
            normals = normals / steep[:, None] @ axes.T
            axis = -(weights @ normals)
        return np.asarray(normals)

    def _among(self, nodes: Index) -> Index:
        """Neighbours as indices among `nodes`; n: no neighbour, n + 1: one without contact."""
        place = np.full(len(self.beside) + 1, len(nodes) + 1)
        place[nodes], place[-1] = np.arange(len(nodes)), len(nodes)
        return place[self.beside[nodes]]


def _patches(among: Index) -> list[Index]:
    """Split n nodes into connected patches, from neighbours as in `Skin._among`."""
    out, left = [], np.ones(len(among), np.bool_)
    while left.any():
        patch = np.zeros(len(among), np.bool_)
        reached = np.array([np.argmax(left)])
        while len(reached):
            patch[reached] = True
            near = among[reached].ravel()
            near = near[near < len(among)]
            reached = np.unique(near[~patch[near]])
        out.append(np.flatnonzero(patch))
        left &= ~patch
    return out


def _at_rim(among: Index) -> NDArray[np.bool_]:
    """Mask of nodes with a neighbour without contact, see `Skin._among`."""
    return np.asarray((among == len(among) + 1).any(axis=1))


def _axes(axis: Array) -> Array:
    """Matrix whose columns are two unit vectors across an axis, and the axis, shape (3, 3)."""
    third = axis / np.linalg.norm(axis)
    x, y, z = third
    first = np.array([0.0, z, -y] if abs(x) < 0.8 else [-z, 0.0, x])
    first /= math.sqrt(first @ first)
    a, b, c = first
    return np.array([[a, y * c - z * b, x], [b, z * a - x * c, y], [c, x * b - y * a, z]])
