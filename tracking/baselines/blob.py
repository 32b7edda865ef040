"""OpenCV's blob detector on the density of each dye; a blob is assigned to the nearest marker."""

import cv2
import numpy as np
from numpy.typing import NDArray

from ..detection import RestFrame
from .density_images import density_images, density_tables
from .density_kernels import UNIT, ZERO
from .follower import Follower, Image, Measured, nearest

Array = NDArray[np.float64]


class BlobDetector(Follower):
    """`cv2.SimpleBlobDetector`: connected pixels above several densities, their mean centroid."""

    def _prepare(self, rest: RestFrame, image: Image) -> None:
        self._tables = density_tables(rest, self._palette)
        self._detectors = [_detector(min(each), max(each)) for each in rest.radii.tolist()]

    def _find(self, image: Image, expected: Array) -> Measured:
        position = np.full_like(expected, np.nan)
        for k, density in enumerate(density_images(image, self._tables)):
            blobs = self._detectors[k].detect(density)
            centres = np.array([blob.pt for blob in blobs]).reshape(-1, 2)
            number = nearest(centres, expected[k], self._reach, mutual=True)
            position[k, number >= 0] = centres[number[number >= 0]]
        return Measured(position)


def _detector(smallest: float, largest: float) -> cv2.SimpleBlobDetector:
    """Make a detector of blobs with 0.3 to 3 times markers' areas, at densities of 0.3 to 0.7."""
    settings = cv2.SimpleBlobDetector.Params()
    settings.minThreshold, settings.maxThreshold = ZERO + UNIT * 0.3, ZERO + UNIT * 0.7
    settings.thresholdStep = UNIT * 0.1
    settings.minRepeatability = 2
    smallest = max(smallest, 0.5)  # of a spot of noise it may be 0
    settings.minDistBetweenBlobs = smallest
    settings.filterByColor, settings.blobColor = True, 255
    settings.filterByArea = True
    settings.minArea, settings.maxArea = 0.3 * np.pi * smallest**2, 3.0 * np.pi * largest**2
    settings.filterByCircularity = settings.filterByInertia = settings.filterByConvexity = False
    return cv2.SimpleBlobDetector.create(settings)
