"""Assignment of the markers of a rest frame to those of the design under a pose."""

import math
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
import scipy
from numpy.typing import NDArray

from ...errors import UserError
from ...render import Camera, SensorDesign
from ..tracks import Tracks
from .pose import CameraPose, seen_by
from .rest_settings import MatchSettings

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Shift:
    """Misalignment of the inner layer: a small rotation, or on a pad a shift and a rotation.

    Attributes
    ----------
    turn: rotation vector of the layer about the origin [rad]; on a pad about its normal only
    along: shift along a pad [m]
    """

    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    along: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class RestLayer:
    """One layer of a rest frame.

    Attributes
    ----------
    points: positions of the design's M markers [m], shape (M, 3)
    pixels: positions of the Q visible markers [px], shape (Q, 2)
    tree: search tree of these pixels
    """

    points: Array
    pixels: Array
    tree: "scipy.spatial.KDTree"


@dataclass(frozen=True, kw_only=True)
class RestMarkers:
    """Markers of a rest frame and of the design.

    Attributes
    ----------
    sensor: design of the sensor
    layers: layers of markers, from the skin inwards
    pitch: typical distance of neighbouring markers in the design's image [px]
    turns: rotations about the axis that map much of the layout onto itself [rad]
    lattice: whether a shift to a neighbour maps most of the layout onto itself
    same: distance up to which a marker is at a position of the design [pitches]
    """

    sensor: SensorDesign
    layers: tuple[RestLayer, ...]
    pitch: float
    turns: tuple[float, ...]
    lattice: bool
    same: float

    @property
    def camera(self) -> Camera:
        """Camera of the design."""
        return self.sensor.view.camera

    def designed(self, layer: int, shift: Shift | None = None, spin: float = 0.0) -> Array:
        """Pixels (M, 2) of the design's markers, of a layout rotated by `spin` [rad]."""
        points = self.layers[layer].points
        if spin:
            points = scipy.spatial.transform.Rotation.from_rotvec([0.0, 0.0, spin]).apply(points)
        if shift is not None and layer:
            points = scipy.spatial.transform.Rotation.from_rotvec(shift.turn).apply(
                points
            ) + np.array([*shift.along, 0.0])
        return self.sensor.view.project(points)

    def seen(self, pose: CameraPose, shift: Shift, spin: float = 0.0) -> list[Array]:
        """Pixels of each layer's design markers under a pose, (M, 2) each."""
        count = len(self.layers)
        return [seen_by(pose, self.camera, self.designed(k, shift, spin)) for k in range(count)]

    def inside(self, pixels: Array) -> Mask:
        """Whether markers at pixels (…, 2) are completely in the image."""
        view, edge = self.sensor.view, 0.5 * self.pitch
        size = np.array([view.width, view.height])
        return np.asarray(((pixels > edge) & (pixels < size - 1.0 - edge)).all(axis=-1))


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """Agreement of a pose with a rest frame.

    Attributes
    ----------
    share: share of the visible markers that lie at design positions
    found: share of the design positions in the image at which there is a marker
    overlap: mean of both shares, weighted by their numbers
    error: RMS distance of the visible markers from the nearest design positions [px]
    moved: RMS distance of the design positions from those without the pose [px]
    """

    share: float
    found: float
    overlap: float
    error: float
    moved: float


def rest_markers(
    sensor: SensorDesign, rest: Tracks, settings: MatchSettings = MatchSettings()
) -> RestMarkers:
    """Collect the markers of a rest frame and of the design.

    Raises
    ------
    UserError
        When there are not two layers, or too few markers.
    """
    if len(rest.position) != len(sensor.depths):
        raise UserError(
            f"the tracks have {len(rest.position)} layers of markers; wanted: {len(sensor.depths)}"
        )
    layers = []
    for depth, at, visible in zip(sensor.depths, rest.position, rest.visible, strict=True):
        pixels = at[visible]
        if len(pixels) < settings.least_markers:
            raise UserError(
                f"the rest frame shows {len(pixels)} markers of a layer, too few to tell the "
                f"camera's pose; allowed: at least {settings.least_markers}"
            )
        points = sensor.shape.points(sensor.places, depth)
        layers.append(RestLayer(points=points, pixels=pixels, tree=scipy.spatial.KDTree(pixels)))
    if sensor.defects.gore_misalignment_mm:
        # Misaligned gores (sectors) of the inner layer do not determine the camera.
        layers = layers[:1]
    designed = sensor.view.project(layers[0].points)
    scatter = math.hypot(sensor.defects.crookedness_mm, sensor.defects.misplacement_mm)
    return RestMarkers(
        sensor=sensor,
        layers=tuple(layers),
        pitch=spacing(designed),
        turns=_symmetric_turns(layers[0].points, settings),
        lattice=_lattice(designed, settings),
        same=settings.same + settings.scattered * 1e-3 * scatter / spacing(layers[0].points),
    )


def spacing(points: Array) -> float:
    """Median distance of n points (n, K) from the nearest other one."""
    return float(np.median(np.asarray(scipy.spatial.KDTree(points).query(points, k=2)[0])[:, 1]))


def _symmetric_turns(points: Array, settings: MatchSettings) -> tuple[float, ...]:
    """Rotations about the axis that map many points (M, 3) onto points [rad]."""
    tree, limit = scipy.spatial.KDTree(points), settings.own * spacing(points)
    turns: set[Fraction] = set()
    for order in range(2, settings.largest_order + 1):
        turned = scipy.spatial.transform.Rotation.from_rotvec(
            [0.0, 0.0, 2 * math.pi / order]
        ).apply(points)
        # Weight decreases with distance: an approximate coincidence is no symmetry.
        near = np.clip(1.0 - np.asarray(tree.query(turned)[0]) / limit, 0.0, None)
        if near.mean() > settings.symmetric:
            turns |= {Fraction(k, order) for k in range(1, order)}
    return tuple(2 * math.pi * float(turn) for turn in sorted(turns))


def _lattice(pixels: Array, settings: MatchSettings) -> bool:
    """Whether a shift to a neighbour maps most pixels (M, 2) onto pixels."""
    tree, limit = scipy.spatial.KDTree(pixels), settings.same * spacing(pixels)
    middle = pixels[np.argmin(np.linalg.norm(pixels - pixels.mean(axis=0), axis=-1))]
    count = min(settings.neighbours + 1, len(pixels))
    nearest = np.asarray(tree.query(middle, k=count)[1])[1:]
    shares = [
        (np.asarray(tree.query(pixels + step)[0]) < limit).mean()
        for step in pixels[nearest] - middle
    ]
    return max(shares) > settings.lattice


def agreement(markers: RestMarkers, pose: CameraPose, shift: Shift, spin: float = 0.0) -> Agreement:
    """Agreement of a pose with the rest frame, with the layout rotated by `spin` [rad]."""
    limit = markers.same * markers.pitch * pose.scale
    near = seen = met = expected = 0
    squares: list[Array] = []
    moved: list[Array] = []
    for k, (layer, places) in enumerate(
        zip(markers.layers, markers.seen(pose, shift, spin), strict=True)
    ):
        distance = np.asarray(scipy.spatial.KDTree(places).query(layer.pixels)[0])
        near, seen = near + int((distance < limit).sum()), seen + len(distance)
        squares.append(distance**2)
        there = markers.inside(places)
        reached = np.asarray(layer.tree.query(places[there])[0]) < limit
        met, expected = met + int(reached.sum()), expected + len(reached)
        moved.append(((places - markers.designed(k)) ** 2).sum(axis=-1))
    return Agreement(
        share=near / seen,
        found=met / max(expected, 1),
        overlap=(near + met) / (seen + expected),
        error=math.sqrt(float(np.concatenate(squares).mean())),
        moved=math.sqrt(float(np.concatenate(moved).mean())),
    )


def spun(pose: CameraPose, spin: float) -> CameraPose:
    """The pose from which the layout looks as from `pose` when it is turned by `spin` [rad]."""
    roll = math.remainder(pose.roll + spin, 2 * math.pi)
    x, y = pose.tilt
    cos, sin = math.cos(spin), math.sin(spin)
    # R(roll)·R(tilt)·R(spin): the tilt's axis turns back with the layout.
    return replace(pose, roll=roll, tilt=(cos * x + sin * y, cos * y - sin * x))
