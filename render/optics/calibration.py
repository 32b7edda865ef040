"""Calibration files: written in OpenCV's YAML, read from those of OpenCV, ROS, Kalibr, NumPy."""

import sys
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import UserError, located
from ...folders import write_whole
from ...strange_files import shortened
from .camera import Camera, FisheyeCamera, PinholeCamera
from .camera_files import KEYS, camera_values
from .nearest_lens import nearest_lens

Array = NDArray[np.float64]

#: Numbers of coefficients that are read of each model.
_COUNTS = {"fisheye": (4,), "pinhole": (0, 4, 5, 8, 12, 14)}
#: Models by their names in files: ours, those of ROS, and those of Kalibr.
_ALIASES = {
    "fisheye": "fisheye",
    "pinhole": "pinhole",
    "equidistant": "fisheye",
    "plumb_bob": "pinhole",
    "rational_polynomial": "pinhole",
    "radtan": "pinhole",
    "none": "pinhole",
}


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


def load_camera(
    path: str | Path, size: tuple[int, int] | None = None, model: str | None = None
) -> Camera:
    """Read a camera file of `save_camera`, OpenCV, ROS, Kalibr or NumPy; see `camera_files`.

    A pinhole has 4, 5, 8, 12 or 14 coefficients in OpenCV's order, or none. More than five that
    are not zero are read as the nearest lens with five, and the largest error is printed.

    Parameters
    ----------
    path: path of the file
    size: required width and height of the images [px]; None accepts any, and needs a file that
        has them
    model: `fisheye` or `pinhole`, for a file of four coefficients that does not say which

    Raises
    ------
    UserError
        When the file is missing, is not a calibration, is for images of another size, is of
        another model, leaves the model open, or is of a lens that cannot be represented.
    """
    path = Path(path)
    if not path.is_file():
        raise UserError(f"calibration file {path} cannot be read: there is no such file")
    with located(f"calibration file {path}"):
        values = camera_values(path)
        matrix, distortion = _matrix(values), _numbers(values, "distortion")
        width, height = _size(values, size)
        name = _model(values, distortion.size, model)
        if distortion.size > 5 and distortion[5:].any():
            lens, error = nearest_lens(matrix, distortion, (width, height))
            _say(
                f"calibration file {path}: its {distortion.size} coefficients are read as the "
                f"nearest five, at most {error:.2g} px off"
            )
            focal, centre = (lens.focal_x, lens.focal_y), (lens.centre_x, lens.centre_y)
            distortion = np.array(lens.distortion)
        else:
            focal = (float(matrix[0, 0]), float(matrix[1, 1]))
            centre = (float(matrix[0, 2]), float(matrix[1, 2]))
        kind, count = (FisheyeCamera, 4) if name == "fisheye" else (PinholeCamera, 5)
        own: Any = (*distortion.tolist(), *[0.0] * count)[:count]
        return kind(width=width, height=height, focal=focal, centre=centre, distortion=own)


@lru_cache(maxsize=32)
def _say(sentence: str) -> None:
    """Print a sentence on stderr, once: a design is built often."""
    print(f"chromagrip: {sentence}", file=sys.stderr, flush=True)


def _numbers(values: dict[str, Any], name: str) -> Array:
    """Numbers of a value, in one row."""
    if name not in values:
        raise UserError(f"it has no {name}: none of the keys {', '.join(KEYS[name])}")
    try:
        numbers = np.array(values[name], dtype=float).ravel()
    except (ValueError, TypeError):
        numbers = np.array([np.nan])
    if not np.isfinite(numbers).all():
        raise UserError(f"its {name} {shortened(values[name])} is no list of numbers")
    return numbers


def _matrix(values: dict[str, Any]) -> Array:
    """Camera matrix, also of Kalibr's four intrinsics, shape (3, 3)."""
    projection = values.get("projection") or "pinhole"
    if projection != "pinhole":
        raise UserError(f"camera_model {shortened(projection)} is none of ours; allowed: pinhole")
    if "matrix" not in values and "intrinsics" in values:
        numbers = _numbers(values, "intrinsics")
        if numbers.size != 4:
            raise UserError(f"its intrinsics are {numbers.size} numbers; allowed: fu, fv, pu, pv")
        return np.array([[numbers[0], 0, numbers[2]], [0, numbers[1], numbers[3]], [0, 0, 1]])
    numbers = _numbers(values, "matrix")
    if numbers.size != 9:
        raise UserError(f"its camera matrix has {numbers.size} numbers; allowed: 9")
    matrix = numbers.reshape(3, 3)
    plain = np.diag([matrix[0, 0], matrix[1, 1], 1.0])
    plain[:2, 2] = matrix[:2, 2]
    if (matrix != plain).any() or min(matrix[0, 0], matrix[1, 1]) <= 0.0:
        raise UserError(
            f"its camera matrix is {matrix.tolist()}; allowed: focal lengths above 0 and a centre, "
            "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
        )
    return matrix


def _size(values: dict[str, Any], wanted: tuple[int, int] | None) -> tuple[int, int]:
    """Width and height of the images [px]."""
    there = [name for name in ("width", "height") if name in values]
    if not there and "size" not in values:
        if wanted is None:
            raise UserError("it names no size of the images: add image_width and image_height")
        return wanted
    names = ("width", "height") if there else ("size",)
    numbers = np.concatenate([_numbers(values, name) for name in names])
    if numbers.size != 2 or (numbers % 1).any() or numbers.min() < 1:
        raise UserError(f"its image size is {numbers.tolist()}; allowed: width and height")
    size = (int(numbers[0]), int(numbers[1]))
    if wanted not in (None, size):
        raise UserError(f"it is for {size[0]}×{size[1]} images, these are {wanted[0]}×{wanted[1]}")
    return size


def _model(values: dict[str, Any], count: int, wanted: str | None) -> str:
    """Name of the model of a file with so many coefficients."""
    named = values.get("model") or None
    if named is None and values.get("fisheye") is not None:
        named = "fisheye" if values["fisheye"] else "pinhole"
    if named is not None and (not isinstance(named, str) or named not in _ALIASES):
        raise UserError(
            f"distortion_model {shortened(named)} is none of ours; allowed: {', '.join(_ALIASES)}"
        )
    told = None if named is None else _ALIASES[named]
    if told and wanted and told != wanted:
        raise UserError(f"its lens is a {told}, not a {wanted}")
    model = told or wanted or ("pinhole" if count > 4 else None)
    if model is None and count == 4:
        raise UserError(
            "it does not say whether its four coefficients are a fisheye's (k1, k2, k3, k4) or a "
            "pinhole's (k1, k2, p1, p2); give model in [camera] of the design"
        )
    if model is None or count not in _COUNTS[model]:
        raise UserError(
            f"{model or 'it'} has {count} distortion coefficients; allowed: fisheye with 4, "
            "pinhole with 4, 5, 8, 12 or 14"
        )
    return model
