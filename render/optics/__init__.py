"""Cameras in OpenCV's parameters, refraction at the silicone's surface, calibration files, boards.

The cameras project points of the sensor frame [m] to pixels (x right, y down, pixel centres at
integers).
"""

from .board import Board, board_picture

__all__ = ["Board", "board_picture"]
