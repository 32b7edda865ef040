"""Camera files of others: each is read as OpenCV projects it, or asked about."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.render import FisheyeCamera, PinholeCamera, load_camera

WIDTH, HEIGHT = 720, 540
MATRIX = np.array([[511.0, 0.0, 352.5], [0.0, 507.5, 281.25], [0.0, 0.0, 1.0]])
FOUR = [-0.12, 0.03, 0.0007, -0.0011]
FIVE = [*FOUR, 0.004]
#: Coefficients that 8, 12 and 14 have in addition, so small that five come near.
MORE = {
    8: [0.02, -0.01, 0.005],
    12: [0.002, -0.001, 0.0005, 0.0002, -0.0001, 0.0001, 0.0001],
    14: [0.002, -0.001, 0.0005, 0.0002, -0.0001, 0.0001, 0.0001, 0.0003, -0.0004],
}


def opencv(suffix: str) -> Callable[[Path, list[float]], Path]:
    """Write as OpenCV's sample does."""

    def write(folder: Path, distortion: list[float], **more: Any) -> Path:
        path = folder / f"lens{suffix}"
        store = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
        store.write("image_width", WIDTH)
        store.write("image_height", HEIGHT)
        store.write("camera_matrix", MATRIX)
        store.write("distortion_coefficients", np.array(distortion)[:, None])
        for name, value in more.items():
            store.write(name, value)
        store.release()
        return path

    return write


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def ros(folder: Path, distortion: list[float], model: str = "plumb_bob") -> Path:
    """Write as ROS's `camera_calibration` does."""
    text = f"image_width: {WIDTH}\nimage_height: {HEIGHT}\ncamera_name: tip\n"
    for name, rows, cols, data in (
        ("camera_matrix", 3, 3, MATRIX.ravel().tolist()),
        ("distortion_coefficients", 1, len(distortion), distortion),
        ("rectification_matrix", 3, 3, np.eye(3, dtype=int).ravel().tolist()),
    ):
        text += f"{name}:\n  rows: {rows}\n  cols: {cols}\n  data: {data}\n"
        text += f"distortion_model: {model}\n" * (name == "camera_matrix")
    return written(folder / "ost.yaml", text)


def echoed(folder: Path, distortion: list[float], model: str = "plumb_bob") -> Path:
    """Write as `ros2 topic echo` prints it: lists at the depth of their keys, two messages."""
    text = f"header:\n  stamp:\n    sec: 17\n  frame_id: tip\nheight: {HEIGHT}\nwidth: {WIDTH}\n"
    text += f"distortion_model: {model}\n"
    for name, data in (("d", distortion), ("k", MATRIX.ravel().tolist())):
        text += f"{name}:\n" + "".join(f"- {value}\n" for value in data)
    return written(folder / "info.yaml", (text + "binning_x: 0\n---\n") * 2)


def kalibr(
    folder: Path, distortion: list[float], model: str = "radtan", camera: str = "pinhole"
) -> Path:
    intrinsics = [*np.diag(MATRIX)[:2].tolist(), *MATRIX[:2, 2].tolist()]
    text = f"""cam0:
  T_cam_imu:
  - [0.01, -0.99, 0.0, 1.0e-02]
  - [0.99, 0.01, 0.0, 2.0e-02]
  cam_overlaps: []
  camera_model: {camera}
  distortion_coeffs: {distortion}
  distortion_model: {model}
  intrinsics: {intrinsics}
  resolution: [{WIDTH}, {HEIGHT}]
  rostopic: /tip/image_raw
"""
    return written(folder / "chain-camchain.yaml", text)


def arrays(folder: Path, distortion: list[float]) -> Path:
    path = folder / "lens.npz"
    np.savez(path, mtx=MATRIX, dist=np.array([distortion]), rvecs=np.zeros((4, 3)))
    return path


def plain_json(folder: Path, distortion: list[float]) -> Path:
    values = {"K": MATRIX.tolist(), "D": [distortion], "image_size": [WIDTH, HEIGHT]}
    return written(folder / "lens.json", json.dumps(values, indent=1))


WRITERS = {
    **{suffix: opencv(suffix) for suffix in (".yml", ".xml", ".json")},
    **{each.__name__: each for each in (ros, echoed, kalibr, arrays, plain_json)},
}


def directions(pixels: int = 60) -> np.ndarray:
    """Rays over the image, and little beyond its undistorted edge."""
    x, y = np.meshgrid(np.arange(0, WIDTH, pixels), np.arange(0, HEIGHT, pixels))
    flat = (np.stack([x, y], axis=-1).reshape(-1, 2) - MATRIX[:2, 2]) / np.diag(MATRIX)[:2]
    return np.column_stack([flat, np.ones(len(flat))])


def off(camera: Any, distortion: list[float], *, fisheye: bool = False) -> float:
    """Largest distance from where OpenCV projects points that lie in the image [px]."""
    rays, zero, own = directions(), np.zeros(3), np.array(distortion)
    if fisheye:
        true, _ = cv2.fisheye.projectPoints(rays[:, None], zero, zero, MATRIX, own)
    else:
        true, _ = cv2.projectPoints(rays, zero, zero, MATRIX, own)
    true = true.reshape(-1, 2)
    inside = ((true >= 0) & (true <= [WIDTH - 1, HEIGHT - 1])).all(axis=1)
    assert inside.sum() > 60
    return float(np.linalg.norm(camera.project(rays) - true, axis=1)[inside].max())


@pytest.mark.parametrize("kind", WRITERS)
def test_five_coefficients_are_a_pinhole_and_four_are_asked_about(
    tmp_path: Path, kind: str
) -> None:
    path = WRITERS[kind](tmp_path, FIVE)
    camera = load_camera(path, (WIDTH, HEIGHT))
    assert isinstance(camera, PinholeCamera)
    assert (camera.width, camera.height) == (WIDTH, HEIGHT)
    assert off(camera, FIVE) < 1e-9
    if kind != "arrays":
        with pytest.raises(UserError, match=f"it is for {WIDTH}×{HEIGHT} images, these are 64×48"):
            load_camera(path, (64, 48))
        assert load_camera(path) == camera
    if kind in (ros.__name__, echoed.__name__, kalibr.__name__):  # which name their model
        return
    path = WRITERS[kind](tmp_path, FOUR)
    with pytest.raises(UserError, match=r"does not say whether its four .* give model in"):
        load_camera(path, (WIDTH, HEIGHT))
    for model, form in (("pinhole", PinholeCamera), ("fisheye", FisheyeCamera)):
        camera = load_camera(path, (WIDTH, HEIGHT), model)
        assert isinstance(camera, form)
        assert off(camera, FOUR, fisheye=model == "fisheye") < 1e-9


def test_a_model_that_the_file_names_is_not_asked_for(tmp_path: Path) -> None:
    for path, fisheye in (
        (ros(tmp_path, FOUR, "equidistant"), True),
        (kalibr(tmp_path, FOUR, "equidistant"), True),
        (echoed(tmp_path, FOUR), False),
        (opencv(".yml")(tmp_path, FOUR, fisheye_model=1), True),  # type: ignore[call-arg]
        (opencv(".xml")(tmp_path, FOUR, fisheye_model=0), False),  # type: ignore[call-arg]
    ):
        camera = load_camera(path)
        assert isinstance(camera, FisheyeCamera) == fisheye
        assert off(camera, FOUR, fisheye=fisheye) < 1e-9
        own, other = ("fisheye", "pinhole") if fisheye else ("pinhole", "fisheye")
        with pytest.raises(UserError, match=f"its lens is a {own}, not a {other}"):
            load_camera(path, model=other)
    assert off(load_camera(kalibr(tmp_path, FOUR)), FOUR) < 1e-9
    assert off(load_camera(kalibr(tmp_path, [], "none")), [0.0] * 4) < 1e-9


@pytest.mark.parametrize("count", MORE)
def test_more_coefficients_are_read_if_five_come_near(
    tmp_path: Path, count: int, capsys: pytest.CaptureFixture[str]
) -> None:
    zeros = [*FIVE, *[0.0] * (count - 5)]
    assert off(load_camera(opencv(".yml")(tmp_path, zeros)), FIVE) < 1e-9
    assert capsys.readouterr().err == ""
    given = [*FIVE, *MORE[count]]
    camera = load_camera(ros(tmp_path, given, "rational_polynomial"))
    told = capsys.readouterr().err
    found = re.search(rf"ost.yaml: its {count} coeff.* nearest five, at most (\S+) px off\n", told)
    assert found, told
    assert off(camera, given) <= 1.05 * float(found[1]) <= 0.105
    cut = load_camera(ros(tmp_path, FIVE))  # the first five of them are far
    assert off(camera, given) < 0.5 * off(cut, given)
