"""Calibration from boards drawn with a camera's rays: what comes out must be that camera."""

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from chromagrip.calibrate.lens.corners import find_corners, image_files
from chromagrip.calibrate.lens.folder import calibrate_camera
from chromagrip.cli.calibrate import calibrate_camera as calibrate
from chromagrip.errors import UserError
from chromagrip.render import FisheyeCamera, PinholeCamera, load_camera
from chromagrip.render.optics.board import Board, board_picture

BOARD = Board(columns=9, rows=6, square=3e-3, marker=2.2e-3, dictionary="4X4_100")
# Brown's tangential terms look much like a shift of the centre: more corners tell them apart.
FINE_BOARD = Board(columns=14, rows=10, square=2e-3, marker=1.4e-3, dictionary="4X4_100")
FISHEYE = FisheyeCamera(
    width=640,
    height=480,
    focal=(152.8, 152.4),
    centre=(318.2, 243.7),
    distortion=(0.03, -0.01, 0.004, -0.001),
)
PINHOLE = PinholeCamera(
    width=640,
    height=480,
    focal=(520.0, 518.0),
    centre=(322.7, 236.1),
    distortion=(-0.25, 0.09, 0.001, -0.0008, -0.01),
)

#: Pixels of a square in the picture that `photograph` samples: finer than most cameras see it.
PICTURE = 96
#: Rays of a pixel along x and along y.
SAMPLES = 3
Camera = FisheyeCamera | PinholeCamera


def pose(
    board: Board, off_axis: float, azimuth: float, tilt: np.ndarray, spin: float, distance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and translation of a board whose middle is seen `off_axis` [rad]."""
    turn = off_axis * np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    parts = [cv2.Rodrigues(v)[0] for v in (turn, tilt, np.array([0.0, 0.0, spin]))]
    rotation = parts[0] @ parts[1] @ parts[2]
    middle = distance * parts[0][:, 2]
    return rotation, middle - rotation @ np.array([*board.size, 0.0]) / 2


def photograph(
    board: Board, camera: Camera, rotation: np.ndarray, translation: np.ndarray
) -> np.ndarray:
    """RGB image of the board, made from the camera's rays alone, SAMPLES² in each pixel."""
    rays = camera_rays(camera)
    # A ray s·d meets the plane where the board's z vanishes: n·(s·d − t) = 0.
    normal = rotation[:, 2]
    facing, ahead = rays @ normal.astype(np.float32), float(normal @ translation)
    visible = (facing > 1e-6) & (ahead > 0.0)  # the board's back shows nothing
    with np.errstate(divide="ignore"):
        reach = np.where(visible, ahead / facing, np.nan)
    maps = []
    for axis in rotation[:, :2].T:
        place = reach * (rays @ axis.astype(np.float32)) - axis @ translation  # [m]
        # The picture's pixel centres lie at integers, its edge half a pixel before the first.
        pixel = place * (PICTURE / board.square) - 0.5
        maps.append(np.nan_to_num(pixel, nan=-9.0).clip(-9.0, 1e4).astype(np.float32))
    grey = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": 200}
    fine = cv2.remap(board_picture(board, PICTURE), *maps, cv2.INTER_LINEAR, **grey)
    shape = (camera.height, SAMPLES, camera.width, SAMPLES)
    image = cv2.GaussianBlur(fine.astype(np.float32).reshape(shape).mean(axis=(1, 3)), (0, 0), 0.6)
    return np.repeat(np.rint(image).astype(np.uint8)[..., None], 3, axis=2)


@lru_cache(maxsize=1)  # many photographs are taken with one camera
def camera_rays(camera: Camera) -> np.ndarray:
    """Directions (height·samples, width·samples, 3) spread evenly over the pixels."""
    x, y = (
        (np.arange(count * SAMPLES) + 0.5) / SAMPLES - 0.5
        for count in (camera.width, camera.height)
    )
    # By rows: the inverse of a distortion takes several arrays of this size.
    rows = (camera.rays(np.column_stack([x, np.full(x.size, height)])) for height in y)
    return np.stack([row.astype(np.float32) for row in rows])


def take(
    folder: Path, board: Board, camera: Camera, off_axis: float, distance: float, tilt: float,
    count: int = 12,
) -> Path:  # fmt: skip
    """Photographs in a folder: boards all around at two distances from the axis, with noise."""
    rng = np.random.default_rng(1)
    folder.mkdir()
    # Azimuths of the image's corners and of its edges in turn.
    corner = np.arctan2(camera.height, camera.width)
    azimuths = np.array([corner, np.pi + corner, -corner, np.pi - corner, 0.0, np.pi])
    for i in range(count):
        angles = off_axis * (1.0 if i < 6 else 0.6), azimuths[i % 6]
        turns = rng.uniform(-tilt, tilt, 3), rng.uniform(0.0, 6.28)
        place = pose(board, *angles, *turns, distance * rng.uniform(0.9, 1.2))
        image = photograph(board, camera, *place)
        noisy = image + rng.normal(0.0, 2.0, image.shape[:2])[..., None]
        cv2.imwrite(str(folder / f"{i:02}.png"), noisy.clip(0, 255).astype(np.uint8))
    return folder


@pytest.fixture(scope="module")
def fisheye_images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return take(tmp_path_factory.mktemp("fisheye") / "images", BOARD, FISHEYE, 0.75, 11e-3, 0.45)


def furthest(found: Camera, true: Camera, reach: float) -> float:
    """Largest distance of projected points over the image, up to `reach` off the axis [px]."""
    x, y = np.meshgrid(np.arange(0, true.width, 8.0), np.arange(0, true.height, 8.0))
    rays = true.rays(np.stack([x, y], axis=-1))
    rays = rays[rays[..., 2] > np.cos(reach)]
    return float(np.linalg.norm(found.project(rays) - true.project(rays), axis=-1).max())


def test_a_fisheye_is_found_again(
    fisheye_images: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "lens.yml"
    out.write_text("dear to somebody")
    with pytest.raises(UserError, match="exists; choose another or give --overwrite"):
        calibrate((fisheye_images,), out=out)
    assert out.read_text() == "dear to somebody"
    assert calibrate((fisheye_images,), out=out, overwrite=True, json_only=True) == 0
    report = json.loads(capsys.readouterr().out)
    # Over ten seeds: focal within 0.06 %, centre 0.04 px, RMS 0.05 px, points 0.12 px.
    np.testing.assert_allclose(report["focal_px"], FISHEYE.focal, rtol=1e-3)
    np.testing.assert_allclose(report["centre_px"], FISHEYE.centre, atol=0.1)
    assert report["rms_error_px"] < 0.08
    assert report["reach_deg"] > 80
    assert (len(report["used"]), report["left_out"]) == (12, [])
    found = load_camera(out, (640, 480))
    assert isinstance(found, FisheyeCamera)
    assert [*found.focal, *found.centre] == [*report["focal_px"], *report["centre_px"]]
    assert list(found.distortion) == report["distortion"]
    assert furthest(found, FISHEYE, np.radians(80)) < 0.2
    with pytest.raises(UserError, match="is for 640×480 images, these are 320×240"):
        load_camera(out, (320, 240))


@pytest.mark.stages
def test_a_pinhole_is_found_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    images, out = tmp_path / "images", tmp_path / "lens.yml"
    take(images, FINE_BOARD, PINHOLE, 0.45, 28e-3, 0.7, count=14)
    board = {"columns": 14, "rows": 10, "square_mm": 2.0, "marker_mm": 1.4}
    assert calibrate((images,), model="pinhole", **board, out=out) == 0
    assert "pinhole, 640×480 px" in capsys.readouterr().out
    found = load_camera(out)
    assert isinstance(found, PinholeCamera)
    # Over six seeds: focal within 0.02 %, centre 0.13 px, points 0.25 px.
    np.testing.assert_allclose(found.focal, PINHOLE.focal, rtol=5e-4)
    np.testing.assert_allclose(found.centre, PINHOLE.centre, atol=0.2)
    assert furthest(found, PINHOLE, np.pi) < 0.3


@pytest.mark.stages
def test_standard_deviations_tell_the_scatter(fisheye_images: Path) -> None:
    """Halves of the images disagree by about what each half says of itself."""
    files = image_files([fisheye_images])
    halves = [calibrate_camera(files[k::2], BOARD, "fisheye") for k in (0, 1)]
    centres = np.array([half.camera.centre for half in halves])
    spread = np.hypot(*(np.array(half.deviations[2:4]) for half in halves))
    assert (np.abs(centres[0] - centres[1]) < 4.0 * spread).all()
    assert (spread < 0.1).all()


def test_corners_are_found_where_they_are() -> None:
    rotation, translation = pose(BOARD, 0.5, 1.0, np.array([0.3, -0.2, 0.0]), 0.4, 12e-3)
    image = photograph(BOARD, FISHEYE, rotation, translation)[..., 0]
    numbers, pixels = find_corners(image, BOARD)
    assert len(numbers) > 35
    places = np.array(BOARD.opencv().getChessboardCorners())[numbers]
    miss = np.linalg.norm(pixels - FISHEYE.project(places @ rotation.T + translation), axis=1)
    assert np.median(miss) < 0.05


def test_images_without_corners_are_left_out_and_a_wrong_one_does_no_harm(
    fisheye_images: Path, tmp_path: Path
) -> None:
    files = image_files([fisheye_images])
    empty, line, spoilt = (tmp_path / f"{name}.png" for name in ("empty", "line", "spoilt"))
    cv2.imwrite(str(empty), np.full((480, 640), 128, np.uint8))
    # Two rows of squares, the others hidden, hold one row of corners.
    upper = pose(BOARD, 0.0, 0.0, np.zeros(3), 0.0, 12e-3)
    image = photograph(BOARD, FISHEYE, *upper)
    edge = FISHEYE.project(upper[0] @ [0.0, 2.3 * BOARD.square, 0.0] + upper[1])[1]
    image[int(edge) :] = 200
    cv2.imwrite(str(line), image)
    # A crossing is painted over beside where it was.
    image = cv2.imread(str(files[6]), cv2.IMREAD_GRAYSCALE)
    _, pixels = find_corners(image, BOARD)
    x, y = np.rint(pixels[len(pixels) // 2]).astype(int)
    image[y - 3 : y + 4, x - 3 : x + 4] = image[y - 2 : y + 5, x - 3 : x + 4].copy()
    cv2.imwrite(str(spoilt), image)
    found = calibrate_camera([spoilt, *files[:6], *files[7:], empty, line], BOARD, "fisheye")
    assert found.left_out == {
        str(empty): "no board found",
        str(line): "the corners found lie on one line",
    }
    assert str(spoilt) in found.images
    assert found.error < 0.08
    np.testing.assert_allclose(found.camera.focal, FISHEYE.focal, rtol=1e-3)


@pytest.mark.stages
def test_parallel_boards_and_the_wrong_model_are_refused(
    fisheye_images: Path, tmp_path: Path
) -> None:
    for i in range(4):
        place = pose(BOARD, 0.0, 0.0, np.zeros(3), 0.0, 12e-3 + i * 1e-3)
        cv2.imwrite(str(tmp_path / f"{i}.png"), photograph(BOARD, FISHEYE, *place))
    with pytest.raises(UserError, match=r"tilted"):
        calibrate_camera(image_files([tmp_path]), BOARD, "fisheye")
    with pytest.raises(UserError, match=r"no lens of this model fits.*Try the other model"):
        calibrate_camera(image_files([fisheye_images]), BOARD, "pinhole")


def test_what_cannot_be_used_is_refused_and_nothing_is_written(
    fisheye_images: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pictures = tmp_path / "pictures"
    (pictures / "empty").mkdir(parents=True)
    (text := pictures / "text.png").write_text("not a picture")
    cv2.imwrite(str(small := pictures / "small.png"), np.zeros((240, 320), np.uint8))
    (work := tmp_path / "work").mkdir()
    monkeypatch.chdir(work)
    files = image_files([fisheye_images])
    told: list[tuple[dict[str, Any], str]] = [
        ({}, "there are no images; give at least 4"),
        ({"images": (Path("nowhere"),)}, "nowhere cannot be read: there is no such file"),
        ({"images": (pictures / "empty",)}, "there are no images in"),
        ({"images": (files[0], text)}, "it is not a whole png or jpg file"),
        ({"images": (files[0], small)}, "is 320×240, .* is 640×480; all must be of one size"),
        ({"images": tuple(files[:3])}, "can be used in 3 of 3 images; wanted: at least 4"),
        ({"images": tuple(files[:4]), "dictionary": "6X6_100"}, "in 0 of 4 images.*no board"),
        ({"dictionary": "3X3_7"}, "no marker dictionary '3X3_7'; allowed: 4X4_100"),
        ({"dictionary": "4X4_50", "columns": 20}, "needs 60 markers, dictionary 4X4_50 has 50"),
        ({"square_mm": float("nan")}, "nan"),
        ({"rows": 2}, "a board of 9×2 squares is too small"),
        ({"out": Path("lens.txt")}, "file lens.txt must end in .yaml or .yml"),
    ]
    for options, message in told:
        with pytest.raises(UserError, match=message):
            calibrate(**{"out": Path("lens.yml"), **options})
    assert list(work.iterdir()) == []


def test_the_board_to_print(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "board.png"
    assert calibrate(print_board=path) == 0
    assert "27 × 18 mm" in capsys.readouterr().out
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    np.testing.assert_array_equal(picture, board_picture(BOARD, 300))
    numbers, pixels = find_corners(cv2.copyMakeBorder(picture, *4 * [50], 0, value=255), BOARD)
    assert len(numbers) == 40
    # Crossings lie between pixels, whose centres lie at integers.
    np.testing.assert_allclose(pixels[0], [349.5, 349.5], atol=0.1)
    with pytest.raises(UserError, match="exists"):
        calibrate(print_board=path)
