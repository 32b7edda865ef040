"""Values of a camera file of OpenCV, ROS, Kalibr or NumPy, by one set of names."""

import re
from contextlib import suppress
from itertools import accumulate
from pathlib import Path
from typing import Any

import cv2

from ...errors import UserError
from ...strange_files import array_names, read_arrays, read_small

#: Names of each value in a file, in lower case; the first that is there counts.
KEYS = {
    "matrix": ("camera_matrix", "cameramatrix", "intrinsic_matrix", "mtx", "k"),
    "intrinsics": ("intrinsics",),
    "distortion": (
        *("distortion_coefficients", "distortion_coeffs", "dist_coeffs", "dist_coeff"),
        *("distcoeffs", "dist", "d"),
    ),
    "model": ("distortion_model",),
    "projection": ("camera_model",),
    "fisheye": ("fisheye_model",),
    "width": ("image_width", "width"),
    "height": ("image_height", "height"),
    "size": ("image_size", "imagesize", "img_size", "resolution"),
}
#: Largest number of values of an array.
_MOST = 10_000
#: Deepest list, table or element; OpenCV calls itself for each, and crashes at some ten thousand.
_DEEPEST = 1000


def camera_values(path: Path) -> dict[str, Any]:
    """Values of a camera file by the names of KEYS: numbers, texts and lists.

    Parameters
    ----------
    path: a NumPy file (.npz), or OpenCV's or plain YAML, XML or JSON

    Raises
    ------
    UserError
        When it cannot be read, or holds several cameras.
    """
    if path.suffix.lower() == ".npz":
        try:
            own = _own_names(array_names(path))
            arrays = read_arrays(path, own.values(), _MOST)
        except UserError as error:  # which names the file again
            raise UserError(str(error).replace(f"{path} ", "it ", 1)) from None
        return {name: arrays[key].tolist() for name, key in own.items()}
    try:
        text = read_small(path).decode("utf-8-sig")
        if _depth(text) > _DEEPEST:
            raise UserError("it is nested too deeply")
        store = _opened(text)  # its nodes live as long
        node = store.root()
        cameras = [key for key in node.keys() if re.fullmatch(r"cam\d+", key)]  # noqa: SIM118
        if len(cameras) > 1:
            raise UserError(f"it has the cameras {', '.join(cameras)}; keep one of them")
        node = node.getNode(cameras[0]) if cameras else node
        return {
            name: _plain(node.getNode(key)) for name, key in _own_names(list(node.keys())).items()
        }
    except (cv2.error, SystemError, UnicodeDecodeError, RecursionError):
        raise UserError("it is no YAML, XML or JSON that OpenCV reads, and no .npz") from None


def _own_names(names: list[str]) -> dict[str, str]:
    """Name of each value of KEYS that is among the names of a file."""
    lower = {name.lower(): name for name in names}
    return {
        name: lower[key]
        for name, choices in KEYS.items()
        if (key := next((choice for choice in choices if choice in lower), None))
    }


def _depth(text: str) -> int:
    """Depth of the lists, tables and elements of a text."""
    if re.search(rf"(?:- *){{{_DEEPEST}}}", text):  # rows in rows of YAML
        return _DEEPEST + 1
    marks = re.findall(r"[\[{\]}]|</?\w", text)
    return max(accumulate(1 if m in "[{" or m[1:2].isalnum() else -1 for m in marks), default=0)


def _opened(text: str) -> cv2.FileStorage:
    """Open a text; also YAML that OpenCV does not read as it is.

    OpenCV needs the first line `%YAML`, and takes no second document, as of `ros2 topic echo`, and
    no list at the depth of its key, as in Kalibr's files.
    """
    flags = cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY
    if text.lstrip()[:1] in ("<", "{"):
        return cv2.FileStorage(text.lstrip(), flags)
    text = re.sub(r"\A(%YAML.*\n)?(\s*---.*\n)?", "", text)
    text = "%YAML:1.0\n---\n" + re.split(r"^(?:---|\.\.\.)", text, flags=re.MULTILINE)[0]
    for each in (text, re.sub(r"^( *)- ", r"\1  - ", text, flags=re.MULTILINE)):
        indents = [len(indent) for indent in re.findall(r"^( *)[^ \n#%]", each, re.MULTILINE)[1:]]
        if indents and min(indents) < indents[0]:  # OpenCV would never come to an end
            raise UserError("a line of it stands further left than the first one")
        with suppress(cv2.error, SystemError):
            return cv2.FileStorage(each, flags)
    raise SystemError("neither is YAML")


def _plain(node: cv2.FileNode) -> Any:
    """Number, text or nested list of a node; a matrix of OpenCV or ROS is the list of its data."""
    if node.isMap():
        return _plain(node.getNode("data"))
    if node.isSeq():
        return [_plain(node.at(k)) for k in range(node.size())]
    if node.isString():
        return node.string()
    return None if node.empty() or node.isNone() else node.real()
