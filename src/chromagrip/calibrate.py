"""Calibrate a camera from pictures of a ChArUco board, with OpenCV's own models and solvers."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from .errors import UserError
from .render import FisheyeCamera, PinholeCamera
from .render.board import Board

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
ModelName = Literal["fisheye", "pinhole"]

#: Fewer images do not tell the lens from the poses of the board.
MIN_IMAGES = 4
#: Fewer corners hardly tell the pose of the board from noise.
MIN_CORNERS = 6

_SUFFIXES = {".png", ".jpg", ".jpeg"}
#: OpenCV's fisheye divides by a point's depth: nothing at 90° from the axis, little close to it.
_RIMS = (np.radians(70.0), np.radians(85.0))
#: A focal length known no better than this is not known.
_VAGUE = 0.05
#: Boards that are all parallel leave the focal length open, however well they fit [rad].
_MIN_TILT = np.radians(10.0)
#: A lens that misses the corners by more of the image's width than this is another lens.
_MAX_ERROR = 1 / 300
#: Corners that miss by more than so many times the median are wrong; by chance, 1 in 2000 does.
_OUTLIER = 3.3
_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-10)


class CalibrateError(UserError):
    """Images that no camera can be calibrated from."""


class _FoldError(Exception):
    """A fisheye whose distortion folds its image."""


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """A calibrated camera and how well it fits.

    Attributes
    ----------
    camera: the result
    error: distance between corners found and projected, RMS over all corners [px]
    images: the same for each image used, by its name [px]
    corners: number of corners used
    left_out: why an image was not used, by its name
    deviations: standard deviations of focal x and y [px], centre x and y [px], and distortion,
        if the corners' errors are independent; 0 for a coefficient held at zero
    reach: largest angle from the axis that a corner used was seen at [rad]
    """

    camera: FisheyeCamera | PinholeCamera
    error: float
    images: dict[str, float]
    corners: int
    left_out: dict[str, str]
    deviations: tuple[float, ...]
    reach: float


@dataclass(frozen=True, kw_only=True)
class _View:
    """Corners found in one image: on the board (n, 3) [squares], and in the image (n, 2) [px]."""

    name: str
    points: Array
    pixels: Array

    def only(self, kept: NDArray[np.bool_]) -> "_View":
        return _View(name=self.name, points=self.points[kept], pixels=self.pixels[kept])


@dataclass(frozen=True, kw_only=True)
class _Fit:
    """What OpenCV's solvers found, in one form.

    Attributes
    ----------
    camera: with the matrix and distortion found
    poses: of the board in each view, rotation vectors and translations [squares]
    views: that were used
    deviations: as in Calibration
    """

    camera: FisheyeCamera | PinholeCamera
    poses: list[tuple[Array, Array]]
    views: list[_View]
    deviations: Array

    def seen(self) -> list[Array]:
        """Corners used of each view in the camera's frame [squares]."""
        return [
            view.points @ cv2.Rodrigues(turn)[0].T + shift
            for view, (turn, shift) in zip(self.views, self.poses, strict=True)
        ]

    def errors(self) -> list[Array]:
        """Distances of corners found from projected ones, in each view [px]."""
        return [
            np.linalg.norm(self.camera.project(seen) - view.pixels, axis=1)
            for view, seen in zip(self.views, self.seen(), strict=True)
        ]


def _poses(turns: Any, shifts: Any) -> list[tuple[Array, Array]]:
    return [
        (np.ravel(r).astype(float), np.ravel(t).astype(float))
        for r, t in zip(turns, shifts, strict=True)
    ]


def image_files(paths: Sequence[Path]) -> list[Path]:
    """Files among the paths, and the png and jpg files of folders among them, by name."""
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            found += sorted(p for p in path.iterdir() if p.suffix.lower() in _SUFFIXES)
        elif path.is_file():
            found.append(path)
        else:
            raise CalibrateError(f"image {path} cannot be read: there is no such file or folder")
    if not found:
        where = f" in {', '.join(map(str, paths))}" if paths else ""
        raise CalibrateError(
            f"there are no images{where}; give at least {MIN_IMAGES} png or jpg files, or a folder"
        )
    return list(dict.fromkeys(found))


def read_image(path: Path) -> Picture:
    """Grey image of a file, as the camera stored it."""
    try:
        # A turned camera notes so in the file; the lens knows nothing of it.
        flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), flags)
    except OSError as error:
        raise CalibrateError(f"image {path} cannot be read: {error.strerror}") from None
    except cv2.error:
        image = None
    if image is None:
        raise CalibrateError(f"image {path} cannot be read: it is not a whole png or jpg file")
    return np.asarray(image, dtype=np.uint8)


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


def calibrate_camera(
    files: Sequence[Path],
    board: Board,
    model: ModelName,
    tell: Callable[[str], None] = lambda text: None,
) -> Calibration:
    """Camera that took the images.

    Parameters
    ----------
    files: images of the board in different poses, all of one size
    board: that they show; the size of its squares does not matter
    model: of the lens
    tell: is called with what is being done

    Raises
    ------
    CalibrateError
        When an image cannot be read, sizes differ, or the images are too few or do not suffice.
    """
    views: list[_View] = []
    left_out: dict[str, str] = {}
    size: tuple[int, int] | None = None
    places = np.rint(np.asarray(board.opencv().getChessboardCorners()) / board.square)
    for number, path in enumerate(files):
        tell(f"looking for the board in {path.name}, {number + 1} of {len(files)}")
        image = read_image(path)
        height, width = image.shape
        if size is not None and size != (width, height):
            raise CalibrateError(
                f"image {path} is {width}×{height}, {files[0]} is {size[0]}×{size[1]}; "
                f"all must be of one size"
            )
        size = (width, height)
        numbers, pixels = find_corners(image, board)
        if len(numbers) < MIN_CORNERS:
            left_out[str(path)] = _too_few(len(numbers))
        elif _on_a_line(places[numbers]):
            left_out[str(path)] = "the corners found lie on one line"
        else:
            views.append(_View(name=str(path), points=places[numbers], pixels=pixels))
    _check_count(views, left_out)
    assert size is not None
    tell(f"calibrating from {len(views)} images")
    solve = _calibrate_fisheye if model == "fisheye" else _calibrate_pinhole
    # Once more without the corners that stick out: at a glancing angle some are a pixel wrong.
    views = _without_outliers(solve(views, size, left_out), left_out)
    _check_count(views, left_out)
    return _finish(solve(views, size, left_out), left_out)


def _on_a_line(points: Array) -> bool:
    return bool(np.linalg.matrix_rank(points - points[0]) < 2)


def _too_few(count: int) -> str:
    if count == 0:
        return "no board found"
    return f"{count} corners found, at least {MIN_CORNERS} wanted"


def _check_count(views: list[_View], left_out: dict[str, str]) -> None:
    if len(views) < MIN_IMAGES:
        hint = ""
        if left_out:
            name, reason = next(iter(left_out.items()))
            hint = f", and columns, rows and dictionary as printed ({name}: {reason})"
        raise CalibrateError(
            f"the board can be used in {len(views)} of {len(views) + len(left_out)} images; "
            f"wanted: at least {MIN_IMAGES}{hint}"
        )


def _without_outliers(fit: _Fit, left_out: dict[str, str]) -> list[_View]:
    """Views without the corners that miss by far more than most do."""
    errors = fit.errors()
    limit = _OUTLIER * float(np.median(np.concatenate(errors)))
    kept = []
    for view, error in zip(fit.views, errors, strict=True):
        rest = view.only(error < limit)
        if len(rest.points) < MIN_CORNERS or _on_a_line(rest.points):
            left_out[view.name] = f"its corners miss by {np.median(error):.1f} px"
        else:
            kept.append(rest)
    return kept


def _calibrate_pinhole(views: list[_View], size: tuple[int, int], left_out: dict[str, str]) -> _Fit:
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
        except ValueError:
            continue  # it folds the image
        return _Fit(
            camera=camera,
            poses=_poses(turns, shifts),
            views=views,
            deviations=np.ravel(deviations)[:9].astype(float),
        )
    raise CalibrateError(
        "the distortion found folds the image; show the board near the image's edges too, "
        "or try the model fisheye"
    )


def _calibrate_fisheye(views: list[_View], size: tuple[int, int], left_out: dict[str, str]) -> _Fit:
    first = _guess_fisheye(views, size)
    fix = cv2.fisheye
    holds = (fix.CALIB_FIX_K4, fix.CALIB_FIX_K3, fix.CALIB_FIX_K2, fix.CALIB_FIX_K1)
    for held in range(len(holds) + 1):
        # Coefficients that the images do not determine may fold the image: hold the highest at 0.
        camera, flags = first, sum(holds[:held])
        try:
            for rim in _RIMS:  # the guess is too coarse to tell what is close to 90°
                out: dict[str, str] = {}
                inside = _within(views, camera, rim, out)
                kept, camera, poses = _solve_fisheye(inside, camera, flags, out)
        except _FoldError:
            continue
        left_out |= out
        deviations = _fisheye_deviations(camera, poses, kept, held)
        return _Fit(camera=camera, poses=poses, views=kept, deviations=deviations)
    raise CalibrateError("the distortion found folds the image; try the model pinhole")


def _within(
    views: list[_View], camera: FisheyeCamera, rim: float, left_out: dict[str, str]
) -> list[_View]:
    """Views of corners less than `rim` [rad] from the axis."""
    kept = []
    for view in views:
        inside = view.only(camera.rays(view.pixels)[:, 2] > np.cos(rim))
        if len(inside.points) < MIN_CORNERS or _on_a_line(inside.points):
            left_out[view.name] = f"the board is too close to {np.degrees(rim):.0f}° from the axis"
        else:
            kept.append(inside)
    _check_count(kept, left_out)
    return kept


def _guess_fisheye(views: list[_View], size: tuple[int, int]) -> FisheyeCamera:
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


def _bend(view: _View, camera: FisheyeCamera) -> float:
    """How far the rays of corners are from those of any plane, RMS [rad]."""
    rays = camera.rays(view.pixels)
    flat = np.column_stack(
        [view.points[:, :2] - view.points[:, :2].mean(axis=0), np.ones(len(rays))]
    )
    # ray × (H·flat) = 0, linear in H; unlike OpenCV's homography it takes rays of 90° and more.
    skew = np.cross(rays[:, None], np.eye(3)[None])  # rows: ray × unit vector
    system = np.einsum("nai,nj->niaj", skew, flat).reshape(-1, 9)
    plane = np.linalg.svd(system, full_matrices=False)[2][-1].reshape(3, 3)
    seen = flat @ plane.T
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    return float(np.sqrt((np.cross(rays, seen) ** 2).sum(axis=1).mean()))


def _solve_fisheye(
    views: list[_View], start: FisheyeCamera, flags: int, left_out: dict[str, str]
) -> tuple[list[_View], FisheyeCamera, list[tuple[Array, Array]]]:
    """Views used, camera and poses; views OpenCV calls ill-conditioned are left out one by one."""
    flags |= (
        cv2.fisheye.CALIB_RECOMPUTE_EXTRINSIC
        | cv2.fisheye.CALIB_FIX_SKEW
        | cv2.fisheye.CALIB_USE_INTRINSIC_GUESS
    )
    check = cv2.fisheye.CALIB_CHECK_COND
    while True:
        (fx, fy), (cx, cy) = start.focal, start.centre
        try:
            _, matrix, bent, turns, shifts = cv2.fisheye.calibrate(
                [v.points[:, None] for v in views],
                [v.pixels[:, None] for v in views],
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
                check = 0  # no image to spare: the deviations will tell what they are worth
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
    except ValueError as error:
        raise _FoldError from error
    return views, camera, _poses(turns, shifts)


def _unsolved(error: cv2.error) -> CalibrateError:
    told = str(error).strip().splitlines()[0].rsplit("error: ", 1)[-1]
    return CalibrateError(
        f"OpenCV finds no camera through these corners ({told}); try the other model, or images "
        f"with the board tilted more and in more places"
    )


def _fisheye_deviations(
    camera: FisheyeCamera, poses: list[tuple[Array, Array]], views: list[_View], held: int
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
        # What is left of the lens's columns once the board's pose has taken its share.
        rest = lens - pose @ np.linalg.lstsq(pose, lens, rcond=None)[0]
        known += rest.T @ rest
        squares += float(((pixels[:, 0] - view.pixels) ** 2).sum())
        count += 2 * len(view.points) - 6
    variance = squares / max(count - free, 1)
    out = np.zeros(8)
    out[:free] = np.sqrt(variance * np.diag(np.linalg.pinv(known, hermitian=True)))
    return out


def _finish(fit: _Fit, left_out: dict[str, str]) -> Calibration:
    """The result, if it is worth something."""
    camera, errors = fit.camera, fit.errors()
    error = float(np.sqrt((np.concatenate(errors) ** 2).mean()))
    if not error < _MAX_ERROR * camera.width:
        raise CalibrateError(
            f"no lens of this model fits: it misses the corners by {error:.1f} px RMS; allowed: "
            f"{_MAX_ERROR * camera.width:.1f} px. Try the other model, and check that the board is "
            f"flat and that columns, rows and marker are as printed"
        )
    normals = np.array([cv2.Rodrigues(turn)[0][:, 2] for turn, _ in fit.poses])
    tilt = np.arccos(np.clip(normals @ normals.T, -1.0, 1.0)).max()
    vague = fit.deviations[:2] > _VAGUE * np.array(camera.focal)
    if tilt < _MIN_TILT or vague.any() or not np.isfinite(fit.deviations).all():
        raise CalibrateError(
            "these images leave the focal length open; take images with the board tilted by "
            "20° to 50° in different directions, in all parts of the image"
        )
    seen = np.concatenate(fit.seen())
    return Calibration(
        camera=camera,
        error=error,
        images={
            view.name: float(np.sqrt((e**2).mean()))
            for view, e in zip(fit.views, errors, strict=True)
        },
        corners=len(seen),
        left_out=left_out,
        deviations=tuple(float(d) for d in fit.deviations),
        reach=float(np.arctan2(np.hypot(seen[:, 0], seen[:, 1]), seen[:, 2]).max()),
    )
