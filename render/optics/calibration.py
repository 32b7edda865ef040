"""Calibration files: a camera in OpenCV's YAML, with the keys of OpenCV's samples and of ROS."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ...errors import UserError, located
from ...folders import write_whole
from .camera import Camera, FisheyeCamera, PinholeCamera

#: Names of the distortion models in a file.
MODELS = {"fisheye": FisheyeCamera, "pinhole": PinholeCamera}
#: Names of the same models in ROS's files.
_ALIASES = {"equidistant": "fisheye", "plumb_bob": "pinhole"}


def camera_text(camera: Camera, **more: float) -> str:
    """Text of a calibration file.

    Parameters
    ----------
    camera: a FisheyeCamera or PinholeCamera
    more: further numbers to write, by key
    """
    lens = camera.lens
    matrix = [
        [lens.focal_x, 0.0, lens.centre_x],
        [0.0, lens.focal_y, lens.centre_y],
        [0.0, 0.0, 1.0],
    ]
    distortion = lens.distortion[:4] if lens.fisheye else lens.distortion
    store = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    store.write("distortion_model", "fisheye" if lens.fisheye else "pinhole")
    store.write("image_width", camera.width)
    store.write("image_height", camera.height)
    store.write("camera_matrix", np.array(matrix))
    store.write("distortion_coefficients", np.array(distortion)[None])
    for name, value in more.items():
        store.write(name, float(value))
    return store.releaseAndGetString()


def save_camera(camera: Camera, path: str | Path, error: float | None = None) -> None:
    """Write a calibration file.

    Parameters
    ----------
    camera: a FisheyeCamera or PinholeCamera
    path: path of the file, ending in .yml or .yaml
    error: reprojection error of the calibration, RMS [px]
    """
    text = camera_text(camera, **({} if error is None else {"avg_reprojection_error": error}))
    with located("calibration file"):
        write_whole(Path(path), text.encode())


def load_camera(path: str | Path, size: tuple[int, int] | None = None) -> Camera:
    """Read a calibration file written by `save_camera`, OpenCV or ROS.

    Parameters
    ----------
    path: path of the file
    size: required width and height of the images [px]; None accepts any

    Raises
    ------
    UserError
        When the file is missing, is not a calibration, or is for images of another size.
    """
    path = Path(path)
    if not path.is_file():
        raise UserError(f"calibration file {path} cannot be read: there is no such file")
    try:
        store = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        model = store.getNode("distortion_model").string()
        width = int(store.getNode("image_width").real())
        height = int(store.getNode("image_height").real())
        matrix = _matrix(store.getNode("camera_matrix"))
        distortion = _matrix(store.getNode("distortion_coefficients"))
    except (cv2.error, SystemError, UnicodeDecodeError):
        raise UserError(f"calibration file {path} is not OpenCV's YAML") from None
    if matrix is None or distortion is None or matrix.shape != (3, 3) or min(width, height) < 1:
        raise UserError(
            f"calibration file {path} must hold image_width, image_height, camera_matrix (3×3) and "
            f"distortion_coefficients"
        )
    if size is not None and size != (width, height):
        raise UserError(
            f"calibration file {path} is for {width}×{height} images, these are {size[0]}×{size[1]}"
        )
    # OpenCV's own calibration sample names no model: four coefficients mean a fisheye.
    name = _ALIASES.get(model, model) or ("fisheye" if distortion.size == 4 else "pinhole")
    wanted = {"fisheye": 4, "pinhole": 5}.get(name)
    if wanted is None or distortion.size != wanted:
        raise UserError(
            f"calibration file {path}: distortion_model {model!r} with {distortion.size} "
            f"coefficients; allowed: fisheye with 4, pinhole with 5"
        )
    kind: Any = MODELS[name]
    with located(f"calibration file {path}"):
        camera: Camera = kind(
            width=width,
            height=height,
            focal=(float(matrix[0, 0]), float(matrix[1, 1])),
            centre=(float(matrix[0, 2]), float(matrix[1, 2])),
            distortion=tuple(float(v) for v in distortion.ravel()),
        )
    return camera


def _matrix(node: "cv2.FileNode") -> np.ndarray | None:
    """Read a matrix in OpenCV's form, or in ROS's (rows, cols and data); None if it is neither."""
    if node.empty():
        return None
    matrix: Any = node.mat()  # None unless the node is a matrix
    if matrix is not None:
        return np.asarray(matrix, dtype=float)
    data = node.getNode("data")
    rows, cols = int(node.getNode("rows").real()), int(node.getNode("cols").real())
    values = [data.at(i).real() for i in range(data.size())]
    return np.array(values).reshape(rows, cols) if len(values) == rows * cols else None
