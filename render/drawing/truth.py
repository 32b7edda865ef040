"""Labels of an image: place of every marker; coverage, motion and depth at every pixel."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from ...model import SoftBody
from ..design.sensor import SensorDesign
from ..dome_map import DomeSheets
from ..ground import pixel_grid
from ..harmonics import harmonic_map
from ..membrane import Membrane
from ..outlines import areas, centroids, outlines, place_markers
from .coverage import edge_width
from .painter import coverage_image
from .truth_kernels import shares_inside

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class MarkerTruth:
    """Truth of the markers in one image; layer 0 is magenta, layer 1 yellow.

    Attributes
    ----------
    pixels: projected centre of each marker [px], shape (2, M, 2)
    image_centres: centroid of each marker's outline in the image, which perspective moves off the
        projected centre [px], shape (2, M, 2)
    areas: areas of the outlines [px²], shape (2, M)
    visible: whether a marker exists, faces the camera and lies in the image, shape (2, M)
    overlap: share of each magenta marker's image that its yellow partner covers, shape (M,)
    centres: centres of the markers in the sensor frame [m], shape (2, M, 3)
    normals: outward unit normals of the markers, shape (2, M, 3)
    """

    pixels: Array
    image_centres: Array
    areas: Array
    visible: NDArray[np.bool_]
    overlap: Array
    centres: Array
    normals: Array


@dataclass(frozen=True, kw_only=True)
class GroundTruth(MarkerTruth):
    """Truth of one image: its markers and every pixel.

    Attributes
    ----------
    masks: share of each pixel that a layer covers, float32, shape (2, H, W)
    flow: motion in the image, since rest, of the point of each layer that the pixel shows at rest
        [px]; NaN off the skin, float32, shape (2, H, W, 2)
    depth: straight distance from the camera to the point of the skin that the pixel shows [m]; NaN
        off the skin, float32, shape (H, W)
    """

    masks: NDArray[np.float32]
    flow: NDArray[np.float32]
    depth: NDArray[np.float32]


def marker_truth(sensor: SensorDesign, membrane: Membrane) -> MarkerTruth:
    """Truth of the markers of a membrane in the image of a sensor."""
    view, square = sensor.view, sensor.markers.form == "square"
    pixels, coefficients = place_markers(membrane, view)
    right, down = pixels[..., 0], pixels[..., 1]
    inside = (right > -0.5) & (right < view.width - 0.5)
    inside &= (down > -0.5) & (down < view.height - 0.5)
    normals = membrane.normals
    x, y, z = (normals[..., i] * membrane.centres[..., i] for i in range(3))
    facing = x + y + z - normals[..., 2] * view.position > 0.0
    return MarkerTruth(
        pixels=pixels,
        image_centres=centroids(coefficients, square),
        areas=areas(coefficients, square),
        visible=inside & facing,
        overlap=overlap_share(coefficients, square),
        centres=membrane.centres,
        normals=normals,
    )


class TruthMap:
    """Ground truth of the images of one sensor; built once, called for each image.

    Parameters
    ----------
    sensor: design of the sensor
    body: silicone body, or a chain's number of nodes or their places, see `harmonic_map`
    """

    def __init__(self, sensor: SensorDesign, body: int | Array | SoftBody) -> None:
        self._sensor = sensor
        view, skin = sensor.view, sensor.shape
        self._pixels = pixel_grid(sensor)
        traced = view.trace(self._pixels)
        places = skin.meet(*traced, 0.0)
        self._skin = np.nan_to_num(skin.rim_distance(places), nan=-1.0) > 0.0
        self._rays = traced[1][self._skin]
        # Points under the pixels on each layer and on the skin itself.
        depths = (*map(float, sensor.depths), 0.0)
        under = [skin.meet(traced[0][self._skin], traced[1][self._skin], d) for d in depths]
        self._rest = [skin.points(place, d) for place, d in zip(under, depths, strict=True)]
        self._moved = (
            DomeSheets(sensor, body, under)
            if isinstance(body, SoftBody)  # else the nodes of a chain, as a number or places
            else ChainSheets(sensor, body, under)
        )

    def __call__(self, membrane: Membrane, displacement: Array) -> GroundTruth:
        """Truth of the image of a membrane.

        Parameters
        ----------
        displacement: displacements of a chain's nodes [m], (N, 2), or forces on a dome's nodes [N],
            (N, 3)
        """
        return GroundTruth(
            **vars(marker_truth(self._sensor, membrane)),
            masks=self._masks(membrane),
            flow=self._flow(displacement),
            depth=self._depth(displacement),
        )

    def images(
        self, names: Sequence[str], membrane: Membrane, displacement: Array
    ) -> dict[str, NDArray[np.float32]]:
        """Compute only the named ones of `masks`, `flow` and `depth`; see `GroundTruth`."""
        makers = {
            "masks": lambda: self._masks(membrane),
            "flow": lambda: self._flow(displacement),
            "depth": lambda: self._depth(displacement),
        }
        return {name: makers[name]() for name in names}

    def _masks(self, membrane: Membrane) -> NDArray[np.float32]:
        sensor, view = self._sensor, self._sensor.view
        square = sensor.markers.form == "square"
        size, width = (view.height, view.width), edge_width(sensor.camera.blur_px)
        layers = outlines(membrane, view)
        return np.stack([coverage_image(layer, width, square, size) for layer in layers])

    def _flow(self, displacement: Array) -> NDArray[np.float32]:
        flow = np.full((2, *self._skin.shape, 2), np.nan, dtype=np.float32)
        for layer in range(2):
            now = self._rest[layer] + self._moved(displacement, layer)
            flow[layer, self._skin] = self._sensor.view.project(now) - self._pixels[self._skin]
        return flow

    def _depth(self, displacement: Array) -> NDArray[np.float32]:
        """Distance from the camera to the point of the deformed skin that each pixel shows.

        The points that the pixels show at rest form a warped grid after deformation. Their
        distances are interpolated to the pixels.
        """
        now = self._rest[2] + self._moved(displacement, 2)
        distance = np.linalg.norm(now - [0.0, 0.0, self._sensor.view.position], axis=-1)
        return self._seen(now, distance[:, None])[..., 0]

    def skin_image(self, displacement: Array, values: Array) -> NDArray[np.float32]:
        """Image of values on the nodes of a dome, NaN off the skin.

        Parameters
        ----------
        displacement: forces on the nodes [N], (N, 3)
        values: C values at each node, (N, C)

        Returns
        -------
        Shape (H, W, C).
        """
        return self._seen(self._rest[2] + self._moved(displacement, 2), self._moved.spread(values))

    def _seen(self, now: Array, values: Array) -> NDArray[np.float32]:
        """Interpolate values (P, C) of points of the skin, now at `now` (P, 3), to the pixels."""
        moved = np.zeros((*self._skin.shape, 2))
        moved[self._skin] = self._sensor.view.project(now) - self._pixels[self._skin]
        source = self._pixels.astype(np.float32)
        rounds = 12  # largest number of steps from a pixel to the point of the skin that it shows
        arrived = 1e-3  # length of a step after which no more is taken [px]
        for _ in range(rounds):
            step = self._pixels - (source + _sample(moved, source))
            source = (source + step).astype(np.float32)
            if np.nanmax(abs(step)[self._skin]) < arrived:
                break
        field = np.zeros(self._skin.shape)
        seen = np.empty((*self._skin.shape, values.shape[1]), np.float32)
        for k in range(values.shape[1]):
            field[self._skin] = values[:, k]
            seen[..., k] = _sample(field, source)
        known = _sample(self._skin.astype(float), source) > 1.0 - 1e-6
        seen[~(self._skin & known)] = np.nan
        return seen


class ChainSheets:
    """Displacement of any places of both layers and the skin of a chain; see `DomeSheets`.

    Parameters
    ----------
    sensor: design of the sensor
    nodes: number of the chain's nodes, or their places
    under: places of interest in each layer and on the skin, three arrays (P, 2)
    """

    def __init__(self, sensor: SensorDesign, nodes: int | Array, under: list[Array]) -> None:
        self._maps = [harmonic_map(sensor.shape, places, nodes) for places in under]
        self._follow = (*map(float, sensor.follow), 1.0)

    def __call__(self, displacement: Array, sheet: int) -> Array:
        """Displacements of a sheet's places [m], (P, 3), for those of the nodes [m], (N, 2)."""
        return np.asarray(self._follow[sheet] * self._maps[sheet].displacement(displacement))

    def spread(self, values: Array) -> Array:
        """Raise TypeError: a chain's nodes do not cover the skin."""
        raise TypeError("only the skin of a dome has values in the image")


def _sample(field: Array, places: NDArray[np.float32]) -> Array:
    """Interpolate an image (H, W, …) at places (H, W, 2) [px]."""
    return np.asarray(
        cv2.remap(
            field.astype(np.float32),
            places[..., 0],
            places[..., 1],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        ),
        dtype=float,
    )


def overlap_share(coefficients: Array, square: bool) -> Array:
    """Share of each magenta outline's area that lies within its yellow partner's, shape (M,).

    Parameters
    ----------
    coefficients: magenta and yellow outlines, see `outlines`, shape (2, M, 6, 2)
    square: whether markers are squares, else discs
    """
    magenta, yellow = np.ascontiguousarray(coefficients[:, :, :3])
    return np.asarray(shares_inside(magenta, yellow, square, _samples(square)))


@lru_cache(maxsize=2)
def _samples(square: bool) -> Array:
    """Coordinates of K evenly spaced points of the unit square or disc, shape (2, K)."""
    samples = 24  # samples of a marker along each axis, for its overlap
    line = (np.arange(samples) + 0.5) / samples * 2.0 - 1.0
    q = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    return np.ascontiguousarray((q if square else q[(q**2).sum(axis=-1) < 1.0]).T)
