"""What may become of finished pictures: the camera sits elsewhere, or the light has changed."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ....render import Camera, Frame, decoding_table, encode_srgb
from ..force_scenes import Pictures

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Steps of linear light from black to white.
_FINE = 65535


def each(change: Callable[[Image], Image]) -> Pictures:
    """The same change of every frame, at rest and of the run."""

    def both(rest: list[Frame], run: list[Frame]) -> tuple[list[Frame], list[Frame]]:
        return _changed(rest, change), _changed(run, change)

    return both


def of_run(change: Callable[[Image], Image]) -> Pictures:
    """A change that came after the frames at rest."""
    return lambda rest, run: (rest, _changed(run, change))


def _changed(frames: list[Frame], change: Callable[[Image], Image]) -> list[Frame]:
    return [replace(frame, image=change(frame.image)) for frame in frames]


def rolled(angle: float, smooth: bool) -> Callable[[Image], Image]:
    """Picture turned about its middle.

    Parameters
    ----------
    angle: anticlockwise on the screen [rad]
    smooth: whether pixels are interpolated by cubics, rather than linearly
    """
    how = cv2.INTER_CUBIC if smooth else cv2.INTER_LINEAR

    def change(image: Image) -> Image:
        height, width = image.shape[:2]
        middle = ((width - 1) / 2, (height - 1) / 2)
        matrix = cv2.getRotationMatrix2D(middle, np.rad2deg(angle), 1.0)
        size = (width, height)
        return np.asarray(
            cv2.warpAffine(image, matrix, size, flags=how, borderMode=cv2.BORDER_REPLICATE)
        )

    return change


def shifted(shift: tuple[float, float], scale: float) -> Callable[[Image], Image]:
    """Picture enlarged about its middle, then shifted.

    Parameters
    ----------
    shift: along x and y [px]
    scale: of lengths
    """

    def change(image: Image) -> Image:
        height, width = image.shape[:2]
        middle = np.array([(width - 1) / 2, (height - 1) / 2])
        offset = (1.0 - scale) * middle + shift
        matrix = np.array([[scale, 0.0, offset[0]], [0.0, scale, offset[1]]])
        return np.asarray(
            cv2.warpAffine(image, matrix, (width, height), borderMode=cv2.BORDER_REPLICATE)
        )

    return change


def tilted(camera: Camera, tilt: float, direction: float) -> Callable[[Image], Image]:
    """Picture of the camera turned about its own centre, light and all.

    A camera at the centre of a dome sees no parallax then.

    Parameters
    ----------
    camera: that took the picture
    tilt: angle between its axes before and after [rad]
    direction: azimuth of the axis that it turns about [rad]
    """
    axis = tilt * np.array([np.cos(direction), np.sin(direction), 0.0])
    rotation, _ = cv2.Rodrigues(axis)
    y, x = np.mgrid[: camera.height, : camera.width].astype(float)
    source = camera.project(camera.rays(np.stack([x, y], axis=-1)) @ rotation.T)
    maps: Any = np.ascontiguousarray(np.moveaxis(source, -1, 0), dtype=np.float32)

    def change(image: Image) -> Image:
        return np.asarray(
            cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        )

    return change


def lit(factor: Array | float) -> Callable[[Image], Image]:
    """Picture with its linear light multiplied by a factor, one number or one for each pixel."""
    decode = decoding_table()
    encode = np.rint(encode_srgb(np.linspace(0.0, 1.0, _FINE + 1))).astype(np.uint8)
    share = np.asarray(factor, dtype=float)[..., None]

    def change(image: Image) -> Image:
        light = np.clip(decode[image] * share, 0.0, 1.0)
        return np.asarray(encode[np.rint(_FINE * light).astype(int)])

    return change


def gradient(width: int, height: int, loss: float, direction: float) -> Array:
    """Factor on the light that falls evenly across the picture, from 1 to 1 − loss, (H, W)."""
    y, x = np.mgrid[-1.0 : 1.0 : height * 1j, -1.0 : 1.0 : width * 1j]
    along = (np.cos(direction) * x + np.sin(direction) * y) / np.sqrt(2.0)
    return 1.0 - loss * (0.5 + 0.5 * along)
