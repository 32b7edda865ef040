"""A ChArUco board: chessboard with ArUco markers in its white squares, to calibrate cameras with.

Its frame is OpenCV's: origin at the upper left corner, x to the right, y down, z into the board,
away from who looks at it.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from .camera import Camera

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

_DICTIONARIES = {
    name.removeprefix("DICT_"): getattr(cv2.aruco, name)
    for name in dir(cv2.aruco)
    if name.startswith("DICT_") and name.isupper()
}

#: Pixels of a square in the picture that `photograph` samples: finer than most cameras see it.
_PICTURE = 96


@dataclass(frozen=True, kw_only=True)
class Board:
    """A ChArUco board.

    Attributes
    ----------
    columns, rows: number of squares, at least 3 each
    square: side of a square [m]
    marker: side of a marker, less than that of a square [m]
    dictionary: OpenCV's name of the set of markers without DICT_, such as 4X4_100
    """

    columns: int
    rows: int
    square: float
    marker: float
    dictionary: str

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < 3:
            raise UserError(
                f"a board of {self.columns}×{self.rows} squares is too small; "
                f"allowed: at least 3 columns and 3 rows"
            )
        if not 0.0 < self.marker < self.square < np.inf:
            raise UserError(
                f"markers of {1e3 * self.marker:g} mm do not fit into squares of "
                f"{1e3 * self.square:g} mm; allowed: 0 < marker < square"
            )
        if self.dictionary not in _DICTIONARIES:
            raise UserError(
                f"there is no marker dictionary {self.dictionary!r}; allowed: "
                f"{', '.join(_DICTIONARIES)}"
            )
        held = len(_dictionary(self.dictionary).bytesList)
        if self.columns * self.rows // 2 > held:
            raise UserError(
                f"a board of {self.columns}×{self.rows} squares needs "
                f"{self.columns * self.rows // 2} markers, dictionary {self.dictionary} has {held}"
            )

    @property
    def size(self) -> tuple[float, float]:
        """Width and height [m]."""
        return self.columns * self.square, self.rows * self.square

    def opencv(self) -> cv2.aruco.CharucoBoard:
        """The board as OpenCV's object."""
        return cv2.aruco.CharucoBoard(
            (self.columns, self.rows), self.square, self.marker, _dictionary(self.dictionary)
        )


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(_DICTIONARIES[name])


def board_picture(board: Board, pixels_per_square: int) -> Picture:
    """Grey picture of the board to print, without a margin."""
    size = (board.columns * pixels_per_square, board.rows * pixels_per_square)
    return np.asarray(board.opencv().generateImage(size), dtype=np.uint8)


def photograph(
    board: Board,
    camera: Camera,
    rotation: Array,
    translation: Array,
    *,
    surroundings: int = 200,
    blur: float = 0.6,
    samples: int = 3,
) -> Picture:
    """RGB image (height, width, 3) of the board as a camera sees it.

    Made from the camera's rays alone, so that it puts a calibration to an honest test.

    Parameters
    ----------
    board: that is seen
    camera: that sees it
    rotation: matrix (3, 3) from the board's frame to the camera's
    translation: the board's origin in the camera's frame (3,) [m]
    surroundings: grey level of everything but the board
    blur: standard deviation of the lens's blur [px]
    samples: rays of a pixel along x and along y
    """
    rays = _rays(camera, samples)  # type: ignore[arg-type] # cameras are frozen values
    # A ray s·d meets the plane where the board's z vanishes: n·(s·d − t) = 0.
    normal = rotation[:, 2]
    facing = rays @ normal.astype(np.float32)
    ahead = float(normal @ translation)
    seen = (facing > 1e-6) & (ahead > 0.0)  # the board's back shows nothing
    with np.errstate(divide="ignore"):
        reach = np.where(seen, ahead / facing, np.nan)
    maps = []
    for axis in rotation[:, :2].T:
        place = reach * (rays @ axis.astype(np.float32)) - axis @ translation  # [m]
        # The picture's pixel centres lie at integers, its edge half a pixel before the first.
        pixel = place * (_PICTURE / board.square) - 0.5
        maps.append(np.nan_to_num(pixel, nan=-9.0).clip(-9.0, 1e4).astype(np.float32))
    fine = cv2.remap(
        board_picture(board, _PICTURE),
        maps[0],
        maps[1],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=surroundings,
    ).astype(np.float32)
    image = fine.reshape(camera.height, samples, camera.width, samples).mean(axis=(1, 3))
    if blur > 0.0:
        image = cv2.GaussianBlur(image, (0, 0), blur)
    grey = np.rint(image).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


@lru_cache(maxsize=1)  # many photographs are taken with one camera
def _rays(camera: Camera, samples: int) -> NDArray[np.float32]:
    """Directions (height·samples, width·samples, 3) spread evenly over the pixels."""
    x, y = (
        (np.arange(count * samples) + 0.5) / samples - 0.5
        for count in (camera.width, camera.height)
    )
    # By rows: the inverse of a distortion takes several arrays of this size.
    out = np.empty((y.size, x.size, 3), dtype=np.float32)
    for row, height in enumerate(y):
        out[row] = camera.rays(np.column_stack([x, np.full(x.size, height)]))
    return out
