"""Pictures of a known sensor, scaled, cropped or padded, as the camera of its design gives them.

The design is fitted to the markers of a picture. Its roll, and what is left of scale and shift, are
told by the tracked markers at rest later, see `rest_pose`.
"""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..render import SensorDesign, decoding_table, encode_srgb
from ..stored_pictures import Image
from ..tracking import Palette, Sighting, SightSettings, detect_markers, sight
from ..tracking.forces import placement

Array = NDArray[np.float64]
#: Left, top, right and bottom of a part of a picture [px].
Box = tuple[int, int, int, int]


@dataclass(frozen=True, kw_only=True)
class Fitting:
    """What makes a picture into one of the design's camera.

    Attributes
    ----------
    size: width and height of the design's picture [px]
    box: part of the picture that is used
    scale: pixels of the design's picture over those of the picture
    corner: where the upper left corner of the scaled part lies in the design's picture, x and y
        [px]
    whole: whether the picture is a whole one
    reduced: whole factor by which the picture of a sensor that is not known is reduced
    finer: factor by which the picture is larger that shows small markers as well as is worthwhile
    seen: markers of a sensor that is not known, where they were looked for in the design's picture
    """

    size: tuple[int, int]
    box: Box
    scale: float = 1.0
    corner: tuple[int, int] = (0, 0)
    whole: bool = True
    reduced: int = 1
    finer: int = 1
    seen: Sighting | None = None

    @property
    def taken(self) -> list[float]:
        """Left, top, width and height of the design's picture in the picture [px]."""
        left, top = (
            edge - at / self.scale for edge, at in zip(self.box[:2], self.corner, strict=True)
        )
        return [left, top, self.size[0] / self.scale, self.size[1] / self.scale]

    def original(self, places: Array) -> Array:
        """Places (…, 2) in the picture, of those in the design's [px]."""
        # Pictures are scaled about the outer edge of their first pixel, not about its centre.
        return (places - self.corner + 0.5) / self.scale - 0.5 + self.box[:2]

    def part(self, image: Image) -> Image:
        """Part of the picture that is used, pixel by pixel."""
        left, top, right, bottom = self.box
        return image[top:bottom, left:right]

    def fine(self) -> "Fitting":
        """The same with pixels as fine as the markers of a sensor that is not known need."""
        return replace(
            self,
            size=(self.finer * self.size[0], self.finer * self.size[1]),
            scale=self.finer * self.scale,
            reduced=self.reduced // self.finer,
            finer=1,
            seen=None,
        )

    def __call__(self, image: Image) -> Image:
        """Picture of the design's size; black where the picture shows nothing."""
        part, (width, height) = self.part(image), self.size
        if self.reduced > 1:
            return _averaged(part, self.reduced)
        if self.whole:
            return part if part.shape[1::-1] == self.size else _resized(part, self.scale, self.size)
        if self.scale != 1.0:
            part = _resized(part, self.scale, None)
        fitted = np.zeros((height, width, 3), dtype=np.uint8)
        x, y = self.corner
        here = fitted[max(y, 0) : y + part.shape[0], max(x, 0) : x + part.shape[1]]
        from_x, from_y = max(-x, 0), max(-y, 0)
        here[:] = part[from_y : from_y + here.shape[0], from_x : from_x + here.shape[1]]
        return fitted


def _resized(image: Image, scale: float, size: tuple[int, int] | None) -> Image:
    """Picture scaled by exactly a factor, or to a width and height [px]."""
    how = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_CUBIC
    image = np.ascontiguousarray(image)
    return np.asarray(cv2.resize(image, size, fx=scale, fy=scale, interpolation=how), np.uint8)


class Fitter:
    """Fits pictures that all show a sensor at one place, which the first one tells.

    Parameters
    ----------
    sensor: None reduces large pictures by a whole factor, and leaves others as they are
    """

    def __init__(self, sensor: SensorDesign | None) -> None:
        self._sensor = sensor
        self._fitting: Fitting | None = None

    def __call__(self, image: Image) -> Image:
        """Picture as the sensor's camera gives it."""
        if self._fitting is None:
            self._fitting = fitting(image, self._sensor)
        return self._fitting(image)


def fitting(image: Image, sensor: SensorDesign | None) -> Fitting:
    """What makes pictures like that of an unloaded sensor into those of its design's camera.

    In the size that its camera gives they stay as they are. Without a sensor large ones are reduced
    by a whole factor, as far as their markers allow.

    Raises
    ------
    UserError
        When it does not show the sensor, or in a size that forces cannot be read in.
    """
    height, width = image.shape[:2]
    everything = (0, 0, width, height)
    if sensor is None:
        return reduction(image)
    if (width, height) == (sensor.view.width, sensor.view.height):
        return Fitting(size=(width, height), box=everything)
    size = (sensor.view.width, sensor.view.height)
    across, down = width / size[0], height / size[1]
    # Smallest and largest size of the sensor in a picture over that in the design's. Smaller ones,
    # magnified, are smoother than any camera's: forces would be read too low in silence.
    low, high = 0.9, 2.5
    # Largest difference of width and height in that, as a share, of a whole picture.
    aspect_error = 0.01
    shaped = abs(across / down - 1.0) <= aspect_error and low <= across <= high
    as_whole = Fitting(size=size, box=everything, scale=1.0 / across)
    try:
        found = _found(image, sensor)
    except UserError as error:
        if shaped:
            return as_whole
        raise UserError(
            f"the pictures are {width}×{height} pixels, the sensor's camera gives "
            f"{size[0]}×{size[1]}, and the sensor is not found in them: {error}"
        ) from None
    times = 1.0 / found.scale
    if not low <= times <= high:
        raise UserError(
            f"the pictures of {width}×{height} pixels show the sensor {times:.2f} times as large "
            f"as its camera does in {size[0]}×{size[1]}; allowed: {low:g} to {high:g} times"
        )
    left, top, _, _ = found.taken
    # A picture of the whole shape is a whole one unless the markers say otherwise by more than
    # these shares of the scale, and of the picture's smaller side. A mount shifts a camera by less.
    whole_scale, whole_shift = 0.03, 0.05
    near = max(abs(left), abs(top)) < whole_shift * min(width, height)
    if shaped and near and abs(across / times - 1.0) < whole_scale:
        return as_whole
    return found


def reduction(image: Image, enough: int = 2_500_000, least_radius: float = 3.5) -> Fitting:
    """How the picture of a sensor that is not known is reduced, by a whole factor if it is large.

    Its markers are looked for in few pixels, and measured in as many as tell more of them.

    Parameters
    ----------
    enough: number of pixels to which it is reduced
    least_radius: radius of a typical marker that is left [px]; in few pixels it looks smaller
    """
    # Pictures of more pixels than this are large. More than this radius [px], as markers of the
    # designs have, does not tell more of a typical marker.
    large, typical_radius = 2_500_000, 8.0
    height, width = image.shape[:2]
    everything = Fitting(size=(width, height), box=(0, 0, width, height))
    if height * width <= large:
        return everything
    look = math.ceil(max(height, width) / SightSettings.longest_side)
    try:
        seen = sight(_averaged(image, look))
    except UserError:  # a part may show more than the whole
        return everything
    radius = look * seen.radius
    finest = max(1, int(radius / typical_radius))
    needed = math.ceil(math.sqrt(height * width / enough) / finest)
    finer = max(1, min(needed, int(radius / finest / least_radius)))
    factor = finest * finer
    size = (width // factor, height // factor)
    return Fitting(
        size=size,
        box=(0, 0, factor * size[0], factor * size[1]),
        scale=1.0 / factor,
        reduced=factor,
        finer=finer,
        seen=seen.scaled(look / factor, size),
    )


def _averaged(image: Image, factor: int) -> Image:
    """Picture reduced by a whole factor, with the mean light of its pixels."""
    size = (image.shape[1] // factor, image.shape[0] // factor)
    # Sixteen bits tell the darkest levels apart.
    most = np.iinfo(np.uint16).max
    light = cv2.LUT(image, np.rint(most * decoding_table()).astype(np.uint16))
    light = light[: factor * size[1], : factor * size[0]]
    mean = np.asarray(cv2.resize(light, size, interpolation=cv2.INTER_AREA))
    levels = np.rint(encode_srgb(np.linspace(0.0, 1.0, most + 1))).astype(np.uint8)
    return levels[mean]


def _found(image: Image, sensor: SensorDesign) -> Fitting:
    """Where the markers of the unloaded sensor lie in a picture."""
    edges = _without_border(image)
    (left, top, right, bottom), seen = _sighted(image, edges)
    inner = np.ascontiguousarray(image[top:bottom, left:right])
    palette = replace(Palette.of_sensor(sensor), sensor=None, seen=seen)
    markers = [layer.position for layer in detect_markers(inner, palette)]
    place = placement(sensor, markers, (right - left, bottom - top))
    same_scale = 0.005  # scales this near to 1 leave the pixels as they are
    scale = 1.0 if abs(place.scale - 1.0) < same_scale else 1.0 / place.scale
    # Pictures are scaled about the outer edge of their first pixel, not about its centre.
    half = 0.5 * (1.0 - place.scale)
    x, y = left + place.corner[0] + half, top + place.corner[1] + half
    size = (sensor.view.width, sensor.view.height)
    box = (
        max(edges[0], round(x)),
        max(edges[1], round(y)),
        min(edges[2], round(x + size[0] / scale)),
        min(edges[3], round(y + size[1] / scale)),
    )
    corner = (round(scale * (box[0] - x)), round(scale * (box[1] - y)))
    return Fitting(size=size, box=box, scale=scale, corner=corner, whole=False)


def _sighted(image: Image, box: Box) -> tuple[Box, Sighting]:
    """Part of a picture that shows a sensor, and where in it; the part given, or one around it."""
    left, top, right, bottom = box
    seen = sight(np.ascontiguousarray(image[top:bottom, left:right]))
    y, x = np.nonzero(seen.field)
    # Markers are looked for again, in the sensor alone, where it is less than this share of a
    # picture.
    small_share = 0.5
    if np.ptp(x) * np.ptp(y) > small_share * seen.field.size:
        return box, seen
    around = math.ceil(2.0 * seen.pitch)
    box = (
        max(left, left + int(x.min()) - around),
        max(top, top + int(y.min()) - around),
        min(right, left + int(x.max()) + around),
        min(bottom, top + int(y.max()) + around),
    )
    left, top, right, bottom = box
    return box, sight(np.ascontiguousarray(image[top:bottom, left:right]))


def _without_border(image: Image) -> Box:
    """A picture without the even rows and columns along its edges.

    With little noise the dark housing is as even as a border; it looks like the rows and columns
    further in. That of a pad ends with its straight side, as a border does, and is taken off.
    """
    left, right = _uneven(image, 0)
    top, bottom = _uneven(image, 1)
    left, right = _with_housing(image[top:bottom], 0, left, right)
    top, bottom = _with_housing(image[:, left:right], 1, top, bottom)
    return left, top, right, bottom


def _uneven(image: Image, axis: int) -> tuple[int, int]:
    """First column (axis 0) or row (axis 1) that is not even, and one past the last; or all."""
    plain = 12  # rows and columns are even where no channel spreads more [grey levels]
    uneven = np.flatnonzero(np.ptp(image, axis=axis).max(axis=-1) > plain)
    return (int(uneven[0]), int(uneven[-1]) + 1) if len(uneven) else (0, image.shape[1 - axis])


def _with_housing(image: Image, axis: int, first: int, end: int) -> tuple[int, int]:
    """Range of columns (axis 0) or rows (axis 1), with those around it that are of the housing."""
    # Rows and columns look alike where the darkest pixels, this share of them, differ by less than
    # this [grey levels] from those this far inside, where compression has left nothing of a border.
    dark_share, alike, inset = 0.25, 3.0, 16
    dark = np.quantile(image, dark_share, axis=axis)  # of each one, shape (L, 3)
    inside = min(inset, (end - first) // 2)
    before = abs(dark[:first] - dark[first + inside]).max(axis=-1) > alike
    after = abs(dark[end:] - dark[end - 1 - inside]).max(axis=-1) > alike
    return (
        int(max(np.flatnonzero(before) + 1, default=0)),
        int(min(np.flatnonzero(after) + end, default=len(dark))),
    )
