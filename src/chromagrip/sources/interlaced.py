"""Pictures whose odd and even rows were taken at two instants, as an interlaced camera sends them.

Their markers are half a frame late in every other row, so that all motion is read too late.
"""

from typing import Any

import cv2
import numpy as np

from ..stored_pictures import Image


class Rows:
    """Compares the odd with the even rows of some of the frames of a source.

    Compression leaves a difference, too, and leaves it at rest as well; so the difference is
    measured above the least one that was seen.
    """

    #: Frames from one comparison to the next.
    every = 8
    #: Least difference over that at rest, and largest one that compression leaves at rest [px].
    least, at_rest = 0.3, 0.6

    def __init__(self) -> None:
        self._count = self._found = 0
        self._least, self._most = self.at_rest, 0.0

    def add(self, image: Image) -> None:
        """Look at a frame, shape (H, W, 3)."""
        self._count += 1
        if self._count % self.every != 1 or self._found == 3 or min(image.shape[:2]) < 16:
            return
        apart = rows_apart(image)
        self._least = min(self._least, apart)
        if apart > self._least + self.least:
            self._found, self._most = self._found + 1, max(self._most, apart)

    @property
    def doubt(self) -> str:
        """What is wrong with the frames, in words; empty if nothing is."""
        if self._found < 3:
            return ""
        return (
            f"its odd and even rows are of two instants, {self._most:.1f} px apart (interlaced): "
            "give it deinterlaced, as by ffmpeg -i FILE -vf bwdif OUT.mkv"
        )


def rows_apart(image: Image, side: int = 160, parts: int = 4) -> float:
    """Motion between the odd and the even rows in the middle of a picture, rms over its parts [px].

    A row is the mean of those beside it, plus motion times the slope of the light.
    """
    top, left = (max(0, length - side) // 2 for length in image.shape[:2])
    light = image[top : top + side, left : left + side, 1].astype(np.float32)
    middle = light[1:-1, 1:-1]
    off = middle - 0.5 * (light[:-2] + light[2:])[:, 1:-1]
    off[::2] *= -1.0
    x, y = 0.5 * (light[1:-1, 2:] - light[1:-1, :-2]), 0.5 * (light[2:] - light[:-2])[:, 1:-1]

    def mean(values: Any) -> Any:
        return cv2.resize(values, (parts, parts), interpolation=cv2.INTER_AREA)

    xx, xy, yy, ox, oy = mean(x * x), mean(x * y), mean(y * y), mean(off * x), mean(off * y)
    det = xx * yy - xy * xy + 1e-3
    along, down = (yy * ox - xy * oy) / det, (xx * oy - xy * ox) / det
    slope = xx + yy + 1e-3
    return float(np.sqrt((slope * (along**2 + down**2)).sum() / slope.sum()))
