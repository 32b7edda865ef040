"""One factor between the pictures that are read and those of a source."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..render import SensorDesign, decoding_table, encode_srgb
from ..stored_pictures import Image
from ..tracking import SightSettings, sight

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Scale:
    """Makes pictures larger or smaller, equally in both directions.

    Attributes
    ----------
    size: width and height of the pictures that are read [px]
    factor: their pixels over those of the source's pictures
    times: whole number of pixels that are averaged along each side; 0: any number
    """

    size: tuple[int, int]
    factor: float = 1.0
    times: int = 0

    def original(self, places: Array) -> Array:
        """Places (…, 2) in the source's picture, of those in the one that is read [px]."""
        # Pictures are scaled about the outer edge of their first pixel, not about its centre.
        return (places + 0.5) / self.factor - 0.5

    def __call__(self, image: Image) -> Image:
        """Picture that is read."""
        if image.shape[1::-1] == self.size:
            return image
        if self.times:
            return _averaged(image, self.times)
        how = cv2.INTER_AREA if self.factor < 1.0 else cv2.INTER_CUBIC
        image = np.ascontiguousarray(image)
        return np.asarray(cv2.resize(image, self.size, interpolation=how), np.uint8)


def scale_to(sensor: SensorDesign, image: Image) -> Scale:
    """Scale from whole pictures of a sensor to those of its design's camera.

    Raises
    ------
    UserError
        When they have another shape, or are too small or too large.
    """
    height, width = image.shape[:2]
    size = (sensor.view.width, sensor.view.height)
    across, down = width / size[0], height / size[1]
    # Smaller ones, magnified, are smoother than any camera's: forces would be read too low in
    # silence.
    low, high = 0.9, 2.5
    aspect_error = 0.01  # largest difference of width and height in the factor, as a share
    if (width, height) == size:
        return Scale(size=size)
    said = (
        f"the pictures are {width}×{height} pixels, the sensor's camera gives {size[0]}×{size[1]}"
    )
    if abs(across / down - 1.0) > aspect_error:
        fits = min(across, down)
        part = f"{round(fits * size[0])}:{round(fits * size[1])}"
        raise UserError(
            f"{said}, and one factor must lead from one to the other: cut or pad them to that "
            f"shape, as with `ffmpeg -i PICTURES -vf crop={part}:LEFT:TOP CUT.mp4`"
        )
    if not low <= across <= high:
        mend = "take larger ones" if across < low else f"reduce them to {size[0]}×{size[1]}"
        raise UserError(
            f"{said}; allowed: {low:g} to {high:g} times as large, not {across:.2f}: {mend}"
        )
    return Scale(size=size, factor=1.0 / across)


def reduction(image: Image) -> Scale:
    """Whole factor by which pictures of a sensor that is not known are reduced if they are large.

    Its markers are looked for in few pixels; as many are left as tell more of a typical one.
    """
    enough = 2_500_000  # pixels; pictures of more are large
    # More than this radius [px] does not tell more of a marker; the last one is left for speed.
    typical_radius, least_radius = 8.0, 3.5
    height, width = image.shape[:2]
    everything = Scale(size=(width, height))
    if height * width <= enough:
        return everything
    look = math.ceil(max(height, width) / SightSettings.longest_side)
    try:
        radius = look * sight(_averaged(image, look)).radius
    except UserError:  # a part may show more than the whole
        return everything
    finest = max(1, int(radius / typical_radius))
    needed = math.ceil(math.sqrt(height * width / enough) / finest)
    times = finest * max(1, min(needed, int(radius / finest / least_radius)))
    return Scale(size=(width // times, height // times), factor=1.0 / times, times=times)


def _averaged(image: Image, times: int) -> Image:
    """Picture reduced by a whole factor, with the mean light of its pixels."""
    size = (image.shape[1] // times, image.shape[0] // times)
    # Sixteen bits tell the darkest levels apart.
    most = np.iinfo(np.uint16).max
    light = cv2.LUT(image, np.rint(most * decoding_table()).astype(np.uint16))
    light = light[: times * size[1], : times * size[0]]
    mean = np.asarray(cv2.resize(light, size, interpolation=cv2.INTER_AREA))
    levels = np.rint(encode_srgb(np.linspace(0.0, 1.0, most + 1))).astype(np.uint8)
    return levels[mean]
