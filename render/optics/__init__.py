"""Cameras in OpenCV's parameters, refraction at the silicone's surface, calibration files, boards.

Points of the sensor frame [m] become pixels (x right, y down, pixel centres at integers).
"""

from .board import Board, board_picture

__all__ = ["Board", "board_picture"]
