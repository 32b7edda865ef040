"""Pictures of a ChArUco board: reading them, and the corners found in them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...render.optics import Board
from ...stored_pictures import MEGAPIXELS, decoded
from ...strange_files import need_file

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

#: Fewer images do not separate the lens from the poses of the board.
MIN_IMAGES = 4
#: Fewer corners hardly determine the pose of the board.
MIN_CORNERS = 6


@dataclass(frozen=True, kw_only=True)
class View:
    """Corners found in one image: on the board (n, 3) [squares], and in the image (n, 2) [px]."""

    name: str
    points: Array
    pixels: Array

    def only(self, kept: NDArray[np.bool_]) -> "View":
        """View of the corners kept, by a mask (n,)."""
        return View(name=self.name, points=self.points[kept], pixels=self.pixels[kept])


def image_files(paths: Sequence[Path]) -> list[Path]:
    """Files among the paths, and the png and jpg files of folders among them, by name."""
    found: list[Path] = []
    suffixes = {".png", ".jpg", ".jpeg"}
    for path in paths:
        if path.is_dir():
            found += sorted(p for p in path.iterdir() if p.suffix.lower() in suffixes)
        elif path.is_file():
            found.append(path)
        else:
            raise UserError(f"image {path} cannot be read: there is no such file or folder")
    if not found:
        where = f" in {', '.join(map(str, paths))}" if paths else ""
        raise UserError(
            f"there are no images{where}; give at least {MIN_IMAGES} png or jpg files, or a folder"
        )
    return list(dict.fromkeys(found))


def read_image(path: Path, max_megapixels: float = MEGAPIXELS) -> Picture:
    """Grey image of a file, as the camera stored it: its note of a turned camera is not the lens's.

    A larger one than `max_megapixels` is not decoded.
    """
    need_file(path, f"image {path}")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f"image {path} cannot be read: {error.strerror}") from None
    image: Picture | None = decoded(data, f"image {path}", max_megapixels, grey=True)
    if image is None:
        raise UserError(f"image {path} cannot be read: it is not a whole png or jpg file")
    return image


def find_corners(image: Picture, board: Board) -> tuple[NDArray[np.int64], Array]:
    """Numbers (n,) of the board's inner corners found in a grey image, and their pixels (n, 2)."""
    detector = cv2.aruco.CharucoDetector(board.opencv())
    corners, numbers, markers, _ = detector.detectBoard(image)
    if numbers is None or not len(numbers):
        return np.empty(0, dtype=np.int64), np.empty((0, 2))
    pixels = np.array(corners, dtype=np.float32).reshape(-1, 2)
    # OpenCV refines to 0.1 px in a window that reaches into the markers when the board is tilted;
    # once more, in the largest window that stays clear of them.
    rims = np.concatenate([m.reshape(-1, 2) for m in markers])
    free = np.abs(pixels[:, None] - rims).max(axis=-1).min(axis=-1)
    windows = np.clip(np.floor(free - 1.5), 2, 9).astype(int)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-3)
    for window in np.unique(windows):
        chosen = windows == window
        size = (int(window), int(window))
        pixels[chosen] = cv2.cornerSubPix(image, pixels[chosen], size, (-1, -1), stop)
    return numbers.ravel().astype(np.int64), pixels.astype(float)


def on_a_line(points: Array) -> bool:
    """Return True if points (n, 3) lie on one line, and so do not determine the board's pose."""
    return bool(np.linalg.matrix_rank(points - points[0]) < 2)


def check_count(views: list[View], left_out: dict[str, str]) -> None:
    """Refuse fewer views than `MIN_IMAGES`; `left_out` says why others are not among them."""
    if len(views) < MIN_IMAGES:
        hint = ""
        if left_out:
            name, reason = next(iter(left_out.items()))
            hint = f", and columns, rows and dictionary as printed ({name}: {reason})"
        raise UserError(
            f"the board can be used in {len(views)} of {len(views) + len(left_out)} images; "
            f"wanted: at least {MIN_IMAGES}{hint}"
        )
