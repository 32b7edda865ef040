"""A ChArUco board: chessboard with ArUco markers in its white squares, to calibrate cameras with.

Its frame is OpenCV's: origin at the upper left corner, x to the right, y down, z into the board,
away from the viewer.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import UserError

Picture = NDArray[np.uint8]

#: OpenCV's identifiers of its sets of ArUco markers, by name without DICT_.
_DICTIONARIES = {
    name.removeprefix("DICT_"): getattr(cv2.aruco, name)
    for name in dir(cv2.aruco)
    if name.startswith("DICT_") and name.isupper()
}


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
        if not 0.1 * self.square < self.marker < self.square < 10.0:
            raise UserError(
                f"markers of {1e3 * self.marker:g} mm do not fit into squares of "
                f"{1e3 * self.square:g} mm; allowed: 0 < marker < square, more "
                "than a tenth of it, below 10 m"
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
        """Convert the board to OpenCV's class."""
        return cv2.aruco.CharucoBoard(
            (self.columns, self.rows), self.square, self.marker, _dictionary(self.dictionary)
        )


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(_DICTIONARIES[name])


def board_picture(board: Board, pixels_per_square: int) -> Picture:
    """Grey picture of the board to print, without a margin.

    Parameters
    ----------
    board: board to print
    pixels_per_square: side of a square in the picture [px]
    """
    size = (board.columns * pixels_per_square, board.rows * pixels_per_square)
    return np.asarray(board.opencv().generateImage(size), dtype=np.uint8)
