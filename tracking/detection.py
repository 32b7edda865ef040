"""Detection of markers in a single picture, and in a rest frame, from which all trackers start."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from ..errors import UserError
from ..render import Frame, SensorDesign, inside_rim, pixel_places
from .measured_spots import Levels, Markers, measured, over_ground
from .palette import Palette
from .spots import Spots, SpotSettings, find_spots, typical_area
from .unmixing import (
    AROUND,
    COLOURED,
    DARKEST,
    dye_densities,
    estimate_ground,
    linear_light,
    plain_pixels,
    rough_ground,
    unmixing_matrix,
)

Array = NDArray[np.float64]
Single = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class RestFrame:
    """Image of the unloaded sensor, and M numbered markers in each of its L layers.

    Attributes
    ----------
    image: mean of the rest frames [sRGB levels], shape (H, W, 3)
    ground: linear light of the unmarked skin, 0 off the skin, shape (H, W, 3)
    position: positions of the markers [px], shape (L, M, 2); markers of one number lie on each
        other; NaN where a layer has none
    radius: radius of a typical marker of each layer [px], shape (L,)
    shapes: matrices that map the unit circle to each marker's ellipse [px], shape (L, M, 2, 2)
    pitch: typical distance to the nearest other marker [px]
    doubt: message where layers are out of register, as under a load; empty if nowhere. In an
        unknown sensor a layer may be misplaced there
    """

    image: Array
    ground: Array
    position: Array
    radius: Array
    shapes: Array
    pitch: float
    doubt: str = ""

    @functools.cached_property
    def radii(self) -> Array:
        """Radius of each marker [px], shape (L, M): its own if there are several kinds, or typical.

        One kind has the typical size, though it does not look like that from everywhere.
        """
        (a, b), (c, d) = np.moveaxis(self.shapes, (-2, -1), (0, 1))
        own = np.sqrt(a * d - b * c)
        radii = np.repeat(self.radius[:, None], own.shape[1], axis=1)
        few, limits = 0.03, SpotSettings()  # share of the markers that are no kind of their own
        for radius, each in zip(radii, own, strict=True):
            known = np.isfinite(each)
            if not known.any():
                continue
            typical = typical_area(each[known] ** 2)
            low, high = np.quantile(each[known] ** 2, [few / 2.0, 1.0 - few / 2.0])
            if low < limits.smallest * typical or high > limits.largest * typical:
                radius[known] = each[known]
        return radii

    @property
    def sizes(self) -> list[tuple[float, float] | None]:
        """Areas of the smallest and the largest markers of each layer with several kinds [px²]."""
        ends = np.stack([self.radii.min(axis=1), self.radii.max(axis=1)], axis=-1)
        return [
            (float(np.pi * low**2), float(np.pi * high**2)) if low < high else None
            for low, high in ends
        ]


def detect_markers(image: Levels, palette: Palette) -> list[Markers]:
    """Detect the markers of each of the palette's layers in one picture.

    Parameters
    ----------
    image: sRGB levels 0…255, shape (H, W, 3)
    palette: colours of the markers

    Raises
    ------
    UserError
        When the picture is grey and the palette is not, or it shows no markers.
    """
    return _detect(image, palette)[0]


def check_told_apart(layers: Sequence[Markers | Spots], palette: Palette) -> None:
    """Refuse a picture if few of the dots that are seen, or a known sensor has, are told apart."""
    found, dots = sum(len(layer.area) for layer in layers), 0
    if palette.seen is not None:
        dots = len(palette.seen.position)
    elif palette.sensor is not None:
        dots = len(palette.sensor.places)
    if found < dots / 2:
        raise UserError(
            f"{found} of the {dots} dots in the image stand out from what is around them; wanted: "
            "dots with plain ground between them"
        )


def detect_again(image: NDArray[np.uint8], rest: RestFrame, palette: Palette) -> list[Markers]:
    """Detect the markers of each layer in a later frame, with the ground of the rest frame.

    That ground is smoother than a new estimate: sizes are twice as precise. It is scaled to the
    frame's light by a factor for each channel. A layer may have no markers.
    """
    linear = linear_light(image)
    field = rest.ground[..., 0] > 0.0
    ground = np.where(field[..., None], rest.ground, 1.0).astype(np.float32)
    ground_share = 0.3  # share of the pixels that is certainly plain ground
    share = 100.0 * (ground_share if palette.bright else 1.0 - ground_share)
    ground *= np.percentile(linear[field] / ground[field], share, axis=0).astype(np.float32)
    matrix = unmixing_matrix(palette.transmittance)
    plain = plain_pixels(dye_densities(linear, ground, matrix) * field, field, 2)
    if plain.any():
        # A channel may have no light at all.
        ground *= np.median(linear[plain] / np.maximum(ground[plain], 1e-4), axis=0)
    densities = dye_densities(linear, ground, matrix)
    spots = [
        find_spots(density, field, True, sizes=sizes)
        for density, sizes in zip(densities, rest.sizes, strict=True)
    ]
    return measured(spots, image, over_ground(linear, ground, field), palette)


def resting_ground(image: Levels, palette: Palette) -> Array:
    """Estimate the linear light of the skin without markers from one picture, (H, W, 3)."""
    return _detect(image, palette)[1].astype(float)


def read_rest(rest: list[Frame], palette: Palette) -> RestFrame:
    """Detect markers and ground of an unloaded sensor in the mean of its frames.

    Raises
    ------
    UserError
        When there is no frame, or it does not show the markers, or shows them under load.
    """
    if not rest:
        raise UserError("the tracker needs at least one rest frame")
    shapes = {frame.image.shape for frame in rest}
    if len(shapes) > 1:
        raise UserError(f"rest frames have different shapes: {sorted(shapes)}")
    mean = np.mean([frame.image for frame in rest], axis=0)
    layers, ground, field = _detect(mean, palette)
    check_told_apart(layers, palette)
    counts = ", ".join(
        f"{len(layer.area)} {name}" for layer, name in zip(layers, palette.names, strict=True)
    )
    if palette.sensor is not None:
        expected = len(palette.sensor.places)
        if not all(0.5 * expected <= len(layer.area) <= 1.2 * expected for layer in layers):
            raise UserError(f"rest frame shows {counts} markers; the sensor has {expected} of each")
    if not all(len(layer.area) for layer in layers):
        raise UserError(
            f"rest frame shows {counts} markers; wanted: some of each. One layer of dots needs its "
            "own palette, such as --palette dark-dots"
        )
    typical = np.array([np.median(layer.area) for layer in layers])
    for name, area in zip(palette.names, typical, strict=True):
        if not area > 0.0:  # the light is not that of the dyes
            raise UserError(f"rest frame shows {counts} markers; those of {name} cover nothing")
    if palette.bright:
        # The brightness of dark ground does not scale the light of bright markers.
        ground = np.broadcast_to(np.median(ground[field], axis=0), ground.shape)
    radius = np.sqrt(typical / np.pi)
    position = join_layers(
        [layer.position for layer in layers], reach=float(radius.max()) + _own_offset(palette)
    )
    first = layers[0].position
    near, _ = scipy.spatial.KDTree(first).query(first, k=2)
    pitch = float(np.median(np.asarray(near)[:, 1])) if len(first) > 1 else float(4 * radius[0])
    frame = RestFrame(
        image=mean,
        ground=np.where(field[..., None], np.maximum(ground, 1e-5), 0.0).astype(float),
        position=position,
        radius=radius,
        shapes=_shapes(layers, position),
        pitch=pitch,
    )
    doubt = _loaded(frame)
    # The gores (sectors) of some sensors are out of register even when untouched.
    aligned = palette.sensor is None or not palette.sensor.defects.gore_misalignment_mm
    if doubt and palette.seen is None and aligned:
        raise UserError(f"rest frame looks loaded: {doubt}; give a frame of the untouched sensor")
    return replace(frame, doubt=doubt)


def check_each_layer(visible: NDArray[np.bool_], palette: Palette) -> None:
    """Refuse a rest frame in which a layer has no visible marker, with a mask of them (L, M)."""
    for name, seen in zip(palette.names, visible, strict=True):
        if not seen.any():
            raise UserError(
                f"no {name} marker of the rest frame can be followed; one layer of dots needs its "
                "own palette, such as --palette dark-dots"
            )


def _own_offset(palette: Palette) -> float:
    """Largest distance of a known sensor's layers due to misaligned gores (sectors) [px]."""
    sensor = palette.sensor
    if sensor is None or not sensor.defects.gore_misalignment_mm:
        return 0.0
    scale = sensor.view.jacobian(sensor.shape.points(np.zeros(2), sensor.depths[-1]))
    return 1e-3 * sensor.defects.gore_misalignment_mm * float(np.linalg.norm(scale[0]))


def _shapes(layers: list[Markers], position: Array) -> Array:
    """Shapes of the markers in the order of `position` (L, M, 2); NaN for missing ones."""
    shapes = np.full((*position.shape, 2), np.nan)
    for own, layer, at in zip(shapes, layers, position, strict=True):
        known = np.isfinite(at[:, 0])
        own[known] = layer.shape[
            np.asarray(scipy.spatial.KDTree(layer.position).query(at[known])[1])
        ]
    return shapes


def neighbours(points: Array, count: int) -> NDArray[np.int64]:
    """Indices (n, K) of the K nearest others of n points (n, 2); K is `count`, or n − 1 if less."""
    among = min(count, len(points) - 1) + 1
    near = np.asarray(scipy.spatial.KDTree(points).query(points, k=among)[1]).reshape(
        len(points), among
    )
    return near[:, 1:].astype(np.int64)


def join_layers(layers: list[Array], reach: float) -> Array:
    """Number the markers of all layers; pairs of nearest markers share a number.

    Parameters
    ----------
    layers: positions of each layer's markers [px], shapes (M₀, 2) and (M₁, 2)
    reach: largest distance between the two markers of a pair [px]

    Returns
    -------
    Positions by layer and number, NaN where a layer has none, shape (L, M, 2).
    """
    if len(layers) == 1:
        return layers[0][None]
    first, second = layers
    pairs = _mutual(first, second, reach)
    alone = [np.delete(layer, pairs[:, k], axis=0) for k, layer in enumerate((first, second))]
    joined = np.full((2, len(pairs) + len(alone[0]) + len(alone[1]), 2), np.nan)
    joined[0, : len(pairs)] = first[pairs[:, 0]]
    joined[1, : len(pairs)] = second[pairs[:, 1]]
    joined[0, len(pairs) : len(pairs) + len(alone[0])] = alone[0]
    joined[1, len(pairs) + len(alone[0]) :] = alone[1]
    return joined


def _mutual(first: Array, second: Array, reach: float) -> NDArray[np.intp]:
    """Indices (k, 2) of the pairs of points that are mutually nearest and within reach."""
    if len(first) == 0 or len(second) == 0:
        return np.empty((0, 2), dtype=np.intp)
    distance, partner = scipy.spatial.KDTree(second).query(first)
    partner = np.asarray(partner)
    back = np.asarray(scipy.spatial.KDTree(first).query(second)[1])
    mutual = (np.asarray(distance) < reach) & (back[partner] == np.arange(len(first)))
    return np.column_stack([np.flatnonzero(mutual), partner[mutual]])


def _detect(image: Levels, palette: Palette) -> tuple[list[Markers], Single, NDArray[np.bool_]]:
    """Markers of each layer, the ground between them, and a mask of the skin."""
    _check_image(image, palette)
    linear = linear_light(image)
    # The median removes noise, whose extremes would bias the rough ground.
    if palette.bright:
        # Shares of a ground that is black in a channel would be undefined.
        linear += np.float32(DARKEST)
    smooth = np.asarray(cv2.medianBlur(linear, 5), dtype=np.float32)
    matrix = unmixing_matrix(palette.transmittance)
    sizes, skin = _first_sizes(image.shape, palette)
    anywhere = np.ones(skin.shape, dtype=bool)
    seen = anywhere if palette.seen is None else palette.seen.field
    # Try a larger size if the markers turn out larger than this one allows.
    for size in sizes:
        ground, lit = rough_ground(smooth, size, seen, palette.bright)
        field = skin & lit
        densities = dye_densities(linear, ground, matrix)
        areas = np.concatenate([find_spots(d, field, parted=False).area for d in densities])
        typical = typical_area(areas)
        if 0.0 < 6.0 * np.sqrt(typical / np.pi) <= size:
            break
    # Replace the closing by the mean of pixels that are certainly ground.
    count = max(1, len(areas) // len(densities))
    scale = float(np.sqrt(field.sum() / count))
    # Between dense markers there is none; that beside them does not tell the light among them.
    dense = palette.seen is not None and palette.seen.pitch < 2.7 * palette.seen.radius
    for margin in () if dense else (3, 2):
        plain = plain_pixels(densities * field, field, margin)
        if plain.sum() > 0.02 * field.sum():
            ground = estimate_ground(linear, plain, scale)
            densities = dye_densities(linear, ground, matrix)
    spots = [find_spots(density, field, True, palette.spots) for density in densities]
    if not any(len(layer.area) for layer in spots):
        if palette.seen is not None:
            check_told_apart(spots, palette)
        raise UserError(
            f"no markers found: nothing in the image has the colours of the palette's "
            f"{' and '.join(palette.names)}"
        )
    return measured(spots, image, over_ground(linear, ground, field), palette), ground, field


def _check_image(levels: Levels, palette: Palette) -> None:
    """Refuse an image of wrong shape, or a grey one for a coloured palette."""
    if levels.ndim != 3 or levels.shape[2] != 3:
        raise UserError(f"image has shape {levels.shape}, expected (height, width, 3)")
    if min(levels.shape[:2]) < 16:
        raise UserError(f"image has shape {levels.shape}, expected 16 pixels or more a side")
    sensor = palette.sensor
    if sensor is not None and levels.shape[:2] != (sensor.view.height, sensor.view.width):
        raise UserError(
            f"image has shape {levels.shape}, the sensor's camera gives "
            f"{(sensor.view.height, sensor.view.width, 3)}"
        )
    log = np.log(palette.transmittance)
    coloured = (np.ptp(log, axis=1) > 0.3).any()
    spread = np.percentile(np.ptp(levels[::2, ::2], axis=2), 99.5)
    if coloured and spread < COLOURED:
        raise UserError(
            f"image is grey (channels differ by at most {spread:.0f} levels), the palette's "
            f"{' and '.join(palette.names)} need a colour image"
        )


def _first_sizes(shape: tuple[int, ...], palette: Palette) -> tuple[list[int], NDArray[np.bool_]]:
    """Window sizes larger than a marker, for `rough_ground` [px], and a mask of the skin."""
    if palette.seen is not None:
        return [int(AROUND * palette.seen.pitch)], palette.seen.field
    if palette.sensor is not None:
        size, skin = _resting_skin(palette.sensor)
        return [size], skin
    sizes = [max(5, int(share * shape[0])) for share in (0.06, 0.12, 0.24)]
    return sizes, np.ones(shape[:2], dtype=np.bool_)


@functools.lru_cache(maxsize=8)
def _resting_skin(sensor: SensorDesign) -> tuple[int, NDArray[np.bool_]]:
    """Size larger than a marker in the image [px], and a mask of the skin."""
    view, skin = sensor.view, sensor.shape
    middle = [skin.points(np.array([[1e-6, 0.0]]), depth) for depth in sensor.depths]
    gain = np.array([np.sqrt(np.linalg.det(view.jacobian(p)[0, :, :2])) for p in middle])
    field = inside_rim(sensor, pixel_places(sensor)) > 4.0 * sensor.camera.blur_px
    return int(4.5 * (gain * sensor.half_sizes).max()), field


def _loaded(rest: RestFrame) -> str:
    """Describe where layers are locally out of register, as under a load; empty if nowhere.

    A misplaced layer is out of register smoothly over the whole image, a loaded one locally.
    """
    position = rest.position
    if len(position) < 2:
        return ""
    both = np.isfinite(position).all(axis=(0, 2))
    at, apart = position[0, both], (position[0] - position[1])[both]
    if len(at) < 12:
        return ""
    x, y = ((at - at.mean(axis=0)) / at.std()).T
    smooth = np.column_stack([np.ones(len(at)), x, y, x * x, x * y, y * y])
    local = apart - smooth @ np.linalg.lstsq(smooth, apart, rcond=None)[0]
    near = np.asarray(scipy.spatial.KDTree(at).query(at, k=7)[1])
    shift = np.linalg.norm(local[near].mean(axis=1), axis=-1)
    if shift.max() <= 0.25 * rest.radius.max():
        return ""
    x, y = at[int(shift.argmax())]
    return f"around ({x:.0f}, {y:.0f}) the layers are {shift.max():.1f} px out of register"
