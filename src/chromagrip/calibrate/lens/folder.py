"""Calibrate a camera from pictures of a ChArUco board, with OpenCV's own models and solvers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from ...errors import UserError
from ...render import FisheyeCamera, PinholeCamera
from ...render.optics import Board
from ...stored_pictures import MEGAPIXELS
from .corners import MIN_CORNERS, View, check_count, find_corners, on_a_line, read_image
from .fit import Fit, calibrate_fisheye, calibrate_pinhole

ModelName = Literal["fisheye", "pinhole"]


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """A calibrated camera and how well it fits.

    Attributes
    ----------
    camera: calibrated camera
    error: RMS distance between found and projected corners [px]
    images: the same for each used image, by its name [px]
    corners: number of used corners
    left_out: reason for omitting an image, by its name
    deviations: standard deviations of focal x and y [px], centre x and y [px], and distortion,
        if the corners' errors are independent; 0 for a coefficient fixed at zero
    reach: largest angle of a used corner from the axis [rad]
    """

    camera: FisheyeCamera | PinholeCamera
    error: float
    images: dict[str, float]
    corners: int
    left_out: dict[str, str]
    deviations: tuple[float, ...]
    reach: float


def calibrate_camera(
    files: Sequence[Path],
    board: Board,
    model: ModelName,
    tell: Callable[[str], None] = lambda text: None,
    max_megapixels: float = MEGAPIXELS,
) -> Calibration:
    """Calibrate the camera that took the images.

    Parameters
    ----------
    files: images of the board in different poses, all of one size
    board: board in the images; the size of its squares does not matter
    model: model of the lens, `fisheye` or `pinhole`
    tell: function called with the current step, for a progress line
    max_megapixels: largest image that is decoded [10⁶ pixels]

    Raises
    ------
    UserError
        When an image cannot be read, sizes differ, or the images do not determine the camera.
    """
    views: list[View] = []
    left_out: dict[str, str] = {}
    size: tuple[int, int] | None = None
    places = np.rint(np.asarray(board.opencv().getChessboardCorners()) / board.square)
    for number, path in enumerate(files):
        tell(f"looking for the board in {path.name}, {number + 1} of {len(files)}")
        image = read_image(path, max_megapixels)
        height, width = image.shape
        if size is not None and size != (width, height):
            raise UserError(
                f"image {path} is {width}×{height}, {files[0]} is {size[0]}×{size[1]}; "
                f"all must be of one size"
            )
        size = (width, height)
        numbers, pixels = find_corners(image, board)
        if len(numbers) < MIN_CORNERS:
            left_out[str(path)] = _too_few(len(numbers))
        elif on_a_line(places[numbers]):
            left_out[str(path)] = "the corners found lie on one line"
        else:
            views.append(View(name=str(path), points=places[numbers], pixels=pixels))
    check_count(views, left_out)
    assert size is not None
    tell(f"calibrating from {len(views)} images")
    solve = calibrate_fisheye if model == "fisheye" else calibrate_pinhole
    # Repeat without outliers: at a glancing angle some corners are a pixel wrong.
    views = _without_outliers(solve(views, size, left_out), left_out)
    check_count(views, left_out)
    return _finish(solve(views, size, left_out), left_out)


def _too_few(count: int) -> str:
    if count == 0:
        return "no board found"
    return f"{count} corners found, at least {MIN_CORNERS} needed"


def _without_outliers(fit: Fit, left_out: dict[str, str]) -> list[View]:
    """Remove corners whose error is far above the median."""
    errors = fit.errors()
    # Corners whose error is more than this many times the median are wrong: 1 in 2000 is by chance.
    outlier = 3.3
    limit = outlier * float(np.median(np.concatenate(errors)))
    kept = []
    for view, error in zip(fit.views, errors, strict=True):
        rest = view.only(error < limit)
        if len(rest.points) < MIN_CORNERS or on_a_line(rest.points):
            left_out[view.name] = f"its corners miss by {np.median(error):.1f} px"
        else:
            kept.append(rest)
    return kept


def _finish(fit: Fit, left_out: dict[str, str]) -> Calibration:
    """Check a fit and make the result.

    Raises
    ------
    UserError
        When no lens fits, or the images do not determine the focal length.
    """
    camera, errors = fit.camera, fit.errors()
    error = float(np.sqrt((np.concatenate(errors) ** 2).mean()))
    # Largest RMS error of the corners at which the lens counts as found, as a share of the width.
    max_error = 1 / 300
    if not error < max_error * camera.width:
        raise UserError(
            f"no lens of this model fits: it misses the corners by {error:.1f} px RMS; allowed: "
            f"{max_error * camera.width:.1f} px. Try the other model, and check that the board is "
            f"flat and that columns, rows and marker are as printed"
        )
    normals = np.array([cv2.Rodrigues(turn)[0][:, 2] for turn, _ in fit.poses])
    tilt = np.arccos(np.clip(normals @ normals.T, -1.0, 1.0)).max()
    # Largest standard deviation of a focal length that counts as determined, as a share of it.
    vague_from = 0.05
    vague = fit.deviations[:2] > vague_from * np.array(camera.focal)
    # Smallest angle between two boards: parallel boards leave the focal length open, however well
    # they fit [rad].
    min_tilt = np.radians(10.0)
    if tilt < min_tilt or vague.any() or not np.isfinite(fit.deviations).all():
        raise UserError(
            "these images leave the focal length open; take images with the board tilted by "
            "20° to 50° in different directions, in all parts of the image"
        )
    corners = np.concatenate(fit.corners())
    return Calibration(
        camera=camera,
        error=error,
        images={
            view.name: float(np.sqrt((e**2).mean()))
            for view, e in zip(fit.views, errors, strict=True)
        },
        corners=len(corners),
        left_out=left_out,
        deviations=tuple(float(d) for d in fit.deviations),
        reach=float(np.arctan2(np.hypot(corners[:, 0], corners[:, 1]), corners[:, 2]).max()),
    )
