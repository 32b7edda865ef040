"""Pictures of a known sensor in another size than its design's camera gives."""

import cv2
import numpy as np

from ..errors import UserError
from ..output.pictures import Image

#: Smallest and largest size of a picture over that of the design. Smaller ones, magnified, are
#: smoother than any camera's: forces would be read too low in silence.
SIZES = (0.9, 2.5)
#: Largest difference of width and height in that, as a share.
_ASPECT = 0.01


def at_size(image: Image, size: tuple[int, int]) -> Image:
    """Picture scaled to a width and height [px]; itself where it has them.

    Raises
    ------
    UserError
        When it is no whole picture of that shape, or too much smaller or larger.
    """
    (height, width), (wanted_width, wanted_height) = image.shape[:2], size
    across, down = width / wanted_width, height / wanted_height
    low, high = SIZES
    if abs(across / down - 1.0) > _ASPECT or not low <= across <= high:
        raise UserError(
            f"the pictures are {width}×{height} pixels, the sensor's camera gives "
            f"{wanted_width}×{wanted_height}; wanted: whole pictures of that shape, "
            f"{low:g} to {high:g} times as large"
        )
    if (width, height) == size:
        return image
    how = cv2.INTER_AREA if across > 1.0 else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(image, size, interpolation=how), dtype=np.uint8)
