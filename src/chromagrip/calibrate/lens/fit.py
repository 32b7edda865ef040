"""The lens and the board's poses from corners, by OpenCV's two solvers, in one form."""

import re
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from ...errors import UserError
from ...render import FisheyeCamera, PinholeCamera
from .corners import MIN_CORNERS, MIN_IMAGES, Array, View, check_count, on_a_line

#: End of OpenCV's iterations: their number, and the relative change of the parameters.
_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-10)
#: Module with the flags of `cv2.fisheye.calibrate`: since OpenCV 5 all solvers share one set.
FLAGS: Any = cv2.fisheye if hasattr(cv2.fisheye, "CALIB_FIX_SKEW") else cv2


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Camera and poses as OpenCV's solvers find them.

    Attributes
    ----------
    camera: with the matrix and distortion found
    poses: of the board in each view, rotation vectors and translations [squares]
    views: that were used
    deviations: as in Calibration
    """

    camera: FisheyeCamera | PinholeCamera
    poses: list[tuple[Array, Array]]
    views: list[View]
    deviations: Array

    def corners(self) -> list[Array]:
        """Corners used of each view in the camera's frame [squares]."""
        return [
            view.points @ cv2.Rodrigues(turn)[0].T + shift
            for view, (turn, shift) in zip(self.views, self.poses, strict=True)
        ]

    def errors(self) -> list[Array]:
        """Distances of corners found from projected ones, in each view [px]."""
        return [
            np.linalg.norm(self.camera.project(corners) - view.pixels, axis=1)
            for view, corners in zip(self.views, self.corners(), strict=True)
        ]


def calibrate_pinhole(views: list[View], size: tuple[int, int], left_out: dict[str, str]) -> Fit:
    """Pinhole with Brown's distortion through the corners of images of `size`.

    It uses every view: nothing is added to `left_out`.
    """
    points = [v.points.astype(np.float32) for v in views]
    pixels = [v.pixels.astype(np.float32) for v in views]
    # Coefficients that the images do not determine may fold the image: hold the highest at zero.
    for flags in (0, cv2.CALIB_FIX_K3, cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_K2):
        try:
            _, matrix, bent, turns, shifts, deviations, _, _ = cv2.calibrateCameraExtended(
                points, pixels, size, np.eye(3), np.zeros(5), flags=flags, criteria=_STOP
            )
        except cv2.error as error:
            raise _unsolved(error) from None
        k1, k2, p1, p2, k3 = map(float, np.ravel(bent)[:5])
        try:
            camera = PinholeCamera(
                width=size[0],
                height=size[1],
                focal=(float(matrix[0, 0]), float(matrix[1, 1])),
                centre=(float(matrix[0, 2]), float(matrix[1, 2])),
                distortion=(k1, k2, p1, p2, k3),
            )
        except UserError:
            continue  # it folds the image
        return Fit(
            camera=camera,
            poses=_poses(turns, shifts),
            views=views,
            deviations=np.ravel(deviations)[:9].astype(float),
        )
    raise UserError(
        "the distortion found folds the image; show the board near the image's edges too, "
        "or try the model fisheye"
    )


def calibrate_fisheye(views: list[View], size: tuple[int, int], left_out: dict[str, str]) -> Fit:
    """Fisheye through the corners of images of `size`; adds to `left_out` the views not used."""
    first = _guess_fisheye(views, size)
    holds = (FLAGS.CALIB_FIX_K4, FLAGS.CALIB_FIX_K3, FLAGS.CALIB_FIX_K2, FLAGS.CALIB_FIX_K1)
    # Angles from the axis within which corners are used, in turn [rad]: OpenCV's fisheye divides by
    # a point's depth, which is zero at 90°.
    rims = (np.radians(70.0), np.radians(85.0))
    for held in range(len(holds) + 1):
        # Coefficients that the images do not determine may fold the image: hold the highest at 0.
        camera, flags = first, sum(holds[:held])
        for rim in rims:  # the guess is too coarse to tell which corners are close to 90°
            out: dict[str, str] = {}
            solved = _solve_fisheye(_within(views, camera, rim, out), camera, flags, out)
            if solved is None:
                break
            kept, camera, poses = solved
        else:
            left_out |= out
            deviations = _fisheye_deviations(camera, poses, kept, held)
            return Fit(camera=camera, poses=poses, views=kept, deviations=deviations)
    raise UserError("the distortion found folds the image; try the model pinhole")


def _within(
    views: list[View], camera: FisheyeCamera, rim: float, left_out: dict[str, str]
) -> list[View]:
    """Views of corners less than `rim` [rad] from the axis."""
    kept = []
    for view in views:
        inside = view.only(camera.rays(view.pixels)[:, 2] > np.cos(rim))
        if len(inside.points) < MIN_CORNERS or on_a_line(inside.points):
            left_out[view.name] = f"the board is too close to {np.degrees(rim):.0f}° from the axis"
        else:
            kept.append(inside)
    check_count(kept, left_out)
    return kept


def _guess_fisheye(views: list[View], size: tuple[int, int]) -> FisheyeCamera:
    """Equidistant lens through whose rays the boards look most like planes.

    OpenCV starts from max(width, height)/π, from where lenses of 180° may not converge.
    """
    best, result = np.inf, None
    for focal in np.geomspace(0.25, 4.0, 60) * max(size) / np.pi:
        camera = FisheyeCamera(
            width=size[0],
            height=size[1],
            focal=(focal, focal),
            centre=((size[0] - 1) / 2, (size[1] - 1) / 2),
        )
        # The median forgives an image with a wrong corner.
        error = focal * float(np.median([_bend(v, camera) for v in views]))
        if error < best:
            best, result = error, camera
    assert result is not None
    return result


def _bend(view: View, camera: FisheyeCamera) -> float:
    """Smallest RMS angle between the rays of corners and those of any plane [rad]."""
    rays = camera.rays(view.pixels)
    flat = np.column_stack(
        [view.points[:, :2] - view.points[:, :2].mean(axis=0), np.ones(len(rays))]
    )
    # ray × (H·flat) = 0, linear in H; unlike OpenCV's homography it takes rays of 90° and more.
    skew = np.cross(rays[:, None], np.eye(3)[None])  # rows: ray × unit vector
    system = np.einsum("nai,nj->niaj", skew, flat).reshape(-1, 9)
    plane = np.linalg.svd(system, full_matrices=False)[2][-1].reshape(3, 3)
    mapped = flat @ plane.T
    mapped /= np.linalg.norm(mapped, axis=1, keepdims=True)
    return float(np.sqrt((np.cross(rays, mapped) ** 2).sum(axis=1).mean()))


def _solve_fisheye(
    views: list[View], start: FisheyeCamera, flags: int, left_out: dict[str, str]
) -> tuple[list[View], FisheyeCamera, list[tuple[Array, Array]]] | None:
    """Views used, camera and poses; None where the distortion found folds the image.

    Views that OpenCV calls ill-conditioned are left out one by one.
    """
    flags |= (
        FLAGS.CALIB_RECOMPUTE_EXTRINSIC | FLAGS.CALIB_FIX_SKEW | FLAGS.CALIB_USE_INTRINSIC_GUESS
    )
    check = FLAGS.CALIB_CHECK_COND
    while True:
        (fx, fy), (cx, cy) = start.focal, start.centre
        try:
            _, matrix, bent, turns, shifts = cv2.fisheye.calibrate(
                [v.points[None] for v in views],  # of one row: OpenCV 5 takes no column
                [v.pixels[None] for v in views],
                (start.width, start.height),
                np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
                np.array(start.distortion),
                flags=flags | check,
                criteria=_STOP,
            )
        except cv2.error as error:
            named = re.search(r"Ill-conditioned matrix for input array (\d+)", str(error))
            if len(views) > MIN_IMAGES:
                # Other complaints name no image; the likeliest has a wrong corner.
                bad = (
                    views[int(named[1])]
                    if named
                    else max(views, key=lambda view: _bend(view, start))
                )
                left_out[bad.name] = "its corners are ill-conditioned, OpenCV says"
                views = [v for v in views if v is not bad]
            elif named:
                check = 0  # no image to spare; the deviations say what the result is worth
            else:
                raise _unsolved(error) from None
            continue
        break
    k1, k2, k3, k4 = map(float, np.ravel(bent))
    try:
        camera = FisheyeCamera(
            width=start.width,
            height=start.height,
            focal=(float(matrix[0, 0]), float(matrix[1, 1])),
            centre=(float(matrix[0, 2]), float(matrix[1, 2])),
            distortion=(k1, k2, k3, k4),
        )
    except UserError:
        return None
    return views, camera, _poses(turns, shifts)


def _fisheye_deviations(
    camera: FisheyeCamera, poses: list[tuple[Array, Array]], views: list[View], held: int
) -> Array:
    """Standard deviations of focal, centre and distortion; `held` coefficients are not fitted."""
    (fx, fy), (cx, cy) = camera.focal, camera.centre
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    free = 8 - held
    known = np.zeros((free, free))
    squares, count = 0.0, 0
    for view, (turn, shift) in zip(views, poses, strict=True):
        pixels, slopes = cv2.fisheye.projectPoints(
            view.points[:, None], turn, shift, matrix, np.array(camera.distortion)
        )
        lens, pose = slopes[:, :free], slopes[:, 8:14]
        # The lens's columns without their projection on those of the board's pose.
        rest = lens - pose @ np.linalg.lstsq(pose, lens, rcond=None)[0]
        known += rest.T @ rest
        squares += float(((pixels[:, 0] - view.pixels) ** 2).sum())
        count += 2 * len(view.points) - 6
    variance = squares / max(count - free, 1)
    out = np.zeros(8)
    out[:free] = np.sqrt(variance * np.diag(np.linalg.pinv(known, hermitian=True)))
    return out


def _poses(turns: Any, shifts: Any) -> list[tuple[Array, Array]]:
    return [
        (np.ravel(r).astype(float), np.ravel(t).astype(float))
        for r, t in zip(turns, shifts, strict=True)
    ]


def _unsolved(error: cv2.error) -> UserError:
    reason = str(error).strip().splitlines()[0].rsplit("error: ", 1)[-1]
    return UserError(
        f"OpenCV finds no camera through these corners ({reason}); try the other model, or images "
        f"with the board tilted more and in more places"
    )
