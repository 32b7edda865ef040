"""Calibration from boards drawn with a camera's rays: what comes out must be that camera."""

import json
from functools import lru_cache
from pathlib import Path

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
    board: Board,
    camera: FisheyeCamera | PinholeCamera,
    rotation: np.ndarray,
    translation: np.ndarray,
    *,
    surroundings: int = 200,
    blur: float = 0.6,
    samples: int = 3,
) -> np.ndarray:
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
    rays = camera_rays(camera, samples)
    # A ray s·d meets the plane where the board's z vanishes: n·(s·d − t) = 0.
    normal = rotation[:, 2]
    facing = rays @ normal.astype(np.float32)
    ahead = float(normal @ translation)
    visible = (facing > 1e-6) & (ahead > 0.0)  # the board's back shows nothing
    with np.errstate(divide="ignore"):
        reach = np.where(visible, ahead / facing, np.nan)
    maps = []
    for axis in rotation[:, :2].T:
        place = reach * (rays @ axis.astype(np.float32)) - axis @ translation  # [m]
        # The picture's pixel centres lie at integers, its edge half a pixel before the first.
        pixel = place * (PICTURE / board.square) - 0.5
        maps.append(np.nan_to_num(pixel, nan=-9.0).clip(-9.0, 1e4).astype(np.float32))
    fine = cv2.remap(
        board_picture(board, PICTURE),
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
def camera_rays(camera: FisheyeCamera | PinholeCamera, samples: int) -> np.ndarray:
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


def take(
    folder: Path,
    board: Board,
    camera: FisheyeCamera | PinholeCamera,
    off_axis: float,
    distance: float,
    tilt: float,
    seed: int = 1,
    count: int = 12,
) -> Path:
    """Photographs in a folder: boards all around at two distances from the axis, with noise."""
    rng = np.random.default_rng(seed)
    folder.mkdir()
    # Azimuths of the image's corners and of its edges in turn.
    corner = np.arctan2(camera.height, camera.width)
    azimuths = np.array([corner, np.pi + corner, -corner, np.pi - corner, 0.0, np.pi])
    for i in range(count):
        image = photograph(
            board,
            camera,
            *pose(
                board,
                off_axis * (1.0 if i < 6 else 0.6),
                azimuths[i % 6],
                rng.uniform(-tilt, tilt, 3),
                rng.uniform(0.0, 6.28),
                distance * rng.uniform(0.9, 1.2),
            ),
        )
        noisy = image + rng.normal(0.0, 2.0, image.shape[:2])[..., None]
        cv2.imwrite(str(folder / f"{i:02}.png"), noisy.clip(0, 255).astype(np.uint8))
    return folder


@pytest.fixture(scope="module")
def fisheye_images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return take(tmp_path_factory.mktemp("fisheye") / "images", BOARD, FISHEYE, 0.75, 11e-3, 0.45)


@pytest.fixture(scope="module")
def pinhole_images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pinhole") / "images"
    return take(folder, FINE_BOARD, PINHOLE, 0.45, 28e-3, 0.7, count=14)


def furthest(
    found: FisheyeCamera | PinholeCamera, true: FisheyeCamera | PinholeCamera, reach: float
) -> float:
    """Largest distance of projected points over the image, up to `reach` off the axis [px]."""
    x, y = np.meshgrid(np.arange(0, true.width, 8.0), np.arange(0, true.height, 8.0))
    rays = true.rays(np.stack([x, y], axis=-1))
    rays = rays[rays[..., 2] > np.cos(reach)]
    return float(np.linalg.norm(found.project(rays) - true.project(rays), axis=-1).max())


@pytest.mark.stages
def test_a_fisheye_is_found_again(
    fisheye_images: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "lens.yml"
    assert calibrate((fisheye_images,), out=out, json_only=True) == 0
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


def test_a_pinhole_is_found_again(
    pinhole_images: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "lens.yml"
    board = {"columns": 14, "rows": 10, "square_mm": 2.0, "marker_mm": 1.4}
    assert calibrate((pinhole_images,), model="pinhole", **board, out=out) == 0
    table = capsys.readouterr().out
    assert "pinhole, 640×480 px" in table
    assert "error, RMS" in table
    found = load_camera(out)
    assert isinstance(found, PinholeCamera)
    # Over six seeds: focal within 0.02 %, centre 0.13 px, points 0.25 px, standard deviations
    # of the centre 0.07 px.
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
    # The back of the board, and a board behind the camera, show nothing.
    turned = rotation @ np.diag([1.0, -1.0, -1.0])
    for unseen in (
        photograph(BOARD, FISHEYE, turned, translation),
        photograph(BOARD, FISHEYE, rotation, translation - 30e-3 * rotation[:, 2]),
    ):
        assert np.unique(unseen).tolist() == [200]


def test_an_image_without_a_board_is_left_out(fisheye_images: Path, tmp_path: Path) -> None:
    empty = tmp_path / "empty.png"
    cv2.imwrite(str(empty), np.full((480, 640), 128, np.uint8))
    found = calibrate_camera([*image_files([fisheye_images])[:6], empty], BOARD, "fisheye")
    assert found.left_out == {str(empty): "no board found"}
    assert len(found.images) == 6


def test_a_wrong_corner_does_no_harm(fisheye_images: Path, tmp_path: Path) -> None:
    """An image in which a crossing was painted over beside where it was."""
    files = image_files([fisheye_images])
    image = cv2.imread(str(files[6]), cv2.IMREAD_GRAYSCALE)
    _, pixels = find_corners(image, BOARD)
    x, y = np.rint(pixels[len(pixels) // 2]).astype(int)
    image[y - 3 : y + 4, x - 3 : x + 4] = image[y - 2 : y + 5, x - 3 : x + 4].copy()
    spoilt = tmp_path / "spoilt.png"
    cv2.imwrite(str(spoilt), image)
    found = calibrate_camera([spoilt, *files[:6], *files[7:]], BOARD, "fisheye")
    assert str(spoilt) in found.images
    assert found.error < 0.08
    np.testing.assert_allclose(found.camera.focal, FISHEYE.focal, rtol=1e-3)


def test_corners_on_one_line_are_too_few(fisheye_images: Path, tmp_path: Path) -> None:
    """Two rows of squares, the others hidden, hold one row of corners."""
    upper = pose(BOARD, 0.0, 0.0, np.zeros(3), 0.0, 12e-3)
    image = photograph(BOARD, FISHEYE, *upper)
    edge = FISHEYE.project(upper[0] @ [0.0, 2.3 * BOARD.square, 0.0] + upper[1])[1]
    image[int(edge) :] = 200
    path = tmp_path / "line.png"
    cv2.imwrite(str(path), image)
    found = calibrate_camera([*image_files([fisheye_images])[:5], path], BOARD, "fisheye")
    assert found.left_out == {str(path): "the corners found lie on one line"}


def test_parallel_boards_are_refused(tmp_path: Path) -> None:
    for i in range(4):
        place = pose(BOARD, 0.0, 0.0, np.zeros(3), 0.0, 12e-3 + i * 1e-3)
        cv2.imwrite(str(tmp_path / f"{i}.png"), photograph(BOARD, FISHEYE, *place))
    with pytest.raises(UserError, match=r"tilted"):
        calibrate_camera(image_files([tmp_path]), BOARD, "fisheye")


def test_the_wrong_model_is_refused(fisheye_images: Path) -> None:
    with pytest.raises(UserError, match=r"no lens of this model fits.*Try the other model"):
        calibrate_camera(image_files([fisheye_images]), BOARD, "pinhole")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "there are no images; give at least 4"),
        ({"images": (Path("nowhere"),)}, "image nowhere cannot be read: there is no such file"),
        ({"dictionary": "3X3_7"}, "no marker dictionary '3X3_7'; allowed: 4X4_100"),
        ({"dictionary": "4X4_50", "columns": 20}, "needs 60 markers, dictionary 4X4_50 has 50"),
        ({"marker_mm": 3.5}, "markers of 3.5 mm do not fit into squares of 3 mm"),
        ({"rows": 2}, "a board of 9×2 squares is too small"),
        ({"out": Path("lens.txt")}, "file lens.txt must end in .yaml or .yml"),
        ({"out": Path("nowhere/lens.yml")}, "there is no folder nowhere"),
    ],
)
def test_refused_before_any_work(
    options: dict[str, object], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError) as refused:
        calibrate(**options)  # type: ignore[arg-type]
    assert message in str(refused.value)
    assert list(tmp_path.iterdir()) == []


def test_images_that_will_not_do_are_refused(fisheye_images: Path, tmp_path: Path) -> None:
    files = image_files([fisheye_images])
    empty_folder = tmp_path / "folder"
    empty_folder.mkdir()
    text = tmp_path / "text.png"
    text.write_text("not a picture")
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), np.zeros((240, 320), np.uint8))
    out = tmp_path / "lens.yml"
    for images, message in [
        ((empty_folder,), f"there are no images in {empty_folder}"),
        ((files[0], text), f"image {text} cannot be read: it is not a whole png or jpg file"),
        ((files[0], small), "is 320×240, .* is 640×480; all must be of one size"),
        (files[:3], "can be used in 3 of 3 images; wanted: at least 4"),
    ]:
        with pytest.raises(UserError, match=message):
            calibrate(tuple(images), out=out)
    with pytest.raises(UserError, match=r"used in 0 of 4 images.*as printed \(.*no board found\)"):
        calibrate(tuple(files[:4]), dictionary="6X6_100", out=out)
    assert not out.exists()


def test_nothing_is_written_over_unless_asked(fisheye_images: Path, tmp_path: Path) -> None:
    out = tmp_path / "lens.yml"
    out.write_text("dear to somebody")
    with pytest.raises(UserError, match="exists; choose another or give --overwrite"):
        calibrate((fisheye_images,), out=out)
    assert out.read_text() == "dear to somebody"
    assert calibrate((fisheye_images,), out=out, overwrite=True) == 0
    assert load_camera(out).width == 640


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


def test_a_board_must_have_a_size() -> None:
    with pytest.raises(UserError, match="allowed: 0 < marker < square"):
        Board(columns=9, rows=6, square=float("nan"), marker=2e-3, dictionary="4X4_100")
