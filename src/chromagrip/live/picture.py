"""The camera's picture on the page."""

import cv2
import numpy as np
from numpy.typing import NDArray

from ..loop.results.tactile_video import MAGNIFY
from ..tracking import Tracks

Image = NDArray[np.uint8]

#: Width of the picture on the page [px].
WIDTH = 420
#: Colour of the markers' motion, RGB.
MOTION = (0, 130, 60)


def blank_picture() -> Image:
    """Grey picture in place of a missing one, RGB."""
    return np.full((WIDTH, WIDTH, 3), 128, np.uint8)


def picture_of(image: Image | None, tracks: Tracks | None, rest: Tracks | None) -> Image:
    """Draw the magnified motion of the markers on the camera's picture, RGB."""
    if image is None:
        return blank_picture()
    canvas = image.copy()
    if tracks is not None and rest is not None:
        visible = tracks.visible[0] & rest.visible[0]
        start, now = rest.position[0, visible], tracks.position[0, visible]
        tips = now + (MAGNIFY - 1.0) * (now - start)
        lines = np.rint(16.0 * np.stack([start, tips], axis=1)).astype(np.int32)
        moved = abs(tips - start).max(axis=1) > 1.0
        cv2.polylines(canvas, list(lines[moved]), False, MOTION, 2, cv2.LINE_AA, 4)
    return resized(canvas, WIDTH)


def resized(image: Image, width: int) -> Image:
    """Resize a picture to a width [px]."""
    height = max(1, round(width / image.shape[1] * image.shape[0]))
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def packed(image: Image) -> bytes:
    """Compress a picture as JPEG."""
    return cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()


def unpacked(data: bytes) -> Image:
    """Decompress a packed picture."""
    found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert found is not None
    return np.ascontiguousarray(found[..., ::-1], np.uint8)
