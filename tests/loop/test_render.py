"""`chromagrip render`: what it leaves in its folder, and how it fails."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from chromagrip import UserError, load_scene
from chromagrip.loop.poses.folder import render_poses
from chromagrip.loop.poses.poses import ARRAYS, Pose, settle
from chromagrip.model import State
from chromagrip.render import load_camera, load_sensor
from chromagrip.sensing.sensor import open_camera


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Poses of a sensor whose file stands beside the scene."""
    folder = tmp_path_factory.mktemp("sweep")
    design = Path(__file__).parents[2] / "render" / "designs" / "thesis.toml"
    text = design.read_text(encoding="utf-8").replace("size_mm = 0.5", "size_mm = 0.48")
    (folder / "sensor.toml").write_text(text, encoding="utf-8")
    (folder / "scene.toml").write_text('sensor = "sensor.toml"', encoding="utf-8")
    scene = load_scene(str(folder / "scene.toml"), {"defects.dust": 5})
    render_poses(scene, [Pose(grip=1.0), Pose(grip=3.0, load=0.9)], folder / "poses")
    return folder / "poses"


def read(path: Path) -> np.ndarray:
    image = cv2.imread(str(path))
    assert image is not None
    return image[..., ::-1]


def test_a_folder_holds_all_that_it_lists(sweep: Path) -> None:
    report = json.loads((sweep / "poses.json").read_text(encoding="utf-8"))
    listed = {*report["files"], "poses.json"}
    for entry in report["poses"]:
        listed |= {entry["image"], entry["truth"], entry["preview"]}
        with np.load(sweep / entry["truth"]) as truth:
            assert list(truth) == list(report["arrays"]) == list(ARRAYS)
    files = {path for path in sweep.rglob("*") if path.is_file()}
    assert {path.relative_to(sweep).as_posix() for path in files} == listed
    assert report["poses"][1]["grip_n"] == 3.0
    # In balance: what is gripped and pulled is what the contact carries.
    assert report["poses"][1]["normal_n"] == pytest.approx(3.0, rel=0.01)
    assert report["poses"][1]["friction_n"] == pytest.approx(0.9, rel=0.01)


def test_the_truth_fits_the_picture(sweep: Path) -> None:
    """Pixels that both layers cover have the overlap's colour, bare ones the ground's."""
    image = read(sweep / "image-001.png").astype(int)
    with np.load(sweep / "truth-001.npz") as truth:
        magenta, yellow = truth["masks"]
        depth, seen = truth["depth_m"], truth["visible"]
        centres, pixels = truth["centres_m"], truth["pixels_px"]
        forces = truth["force_normal_n"]
    red, green, _ = np.median(image[(magenta > 250) & (yellow > 250)], axis=0)
    assert red - green > 80
    bare = np.isfinite(depth) & (magenta == 0) & (yellow == 0)
    assert np.ptp(np.median(image[bare], axis=0)) < 15
    assert seen.all()
    camera = load_camera(sweep / "camera.yml")
    np.testing.assert_allclose(camera.project(centres), pixels, atol=1e-6)
    assert forces.sum() == pytest.approx(3.0, rel=0.01)


def test_a_scene_beside_its_sensor_can_be_run_from_its_folder(
    sweep: Path,
) -> None:
    again = load_scene(str(sweep / "scene.toml"))
    assert again.build_sensor().half_sizes[0] == pytest.approx(0.24e-3)


@pytest.mark.loops
def test_an_interrupted_sweep_does_not_look_whole(tmp_path: Path) -> None:
    def stop(done: int, total: int) -> None:
        if done == 1:
            raise KeyboardInterrupt

    out = tmp_path / "cut"
    with pytest.raises(KeyboardInterrupt):
        render_poses(load_scene("camera-100hz"), [Pose(grip=1.0)] * 2, out, False, stop)
    assert (out / "image-000.png").exists()
    assert not (out / "poses.json").exists()


def test_a_pad_is_displaced_as_told() -> None:
    scene = load_scene("camera-100hz", {"sensor": "flat-2019", "object.radius_mm": 30.0})
    state, field = settle(scene, Pose(depth=1e-3, shear=0.5e-3))
    nodes = state.deformation.nodes
    half = load_sensor("flat-2019").shape.radius
    x = np.linspace(-half, half, len(nodes))
    assert field is None
    np.testing.assert_allclose(nodes[:, 1], np.minimum(x**2 / 60e-3 - 1e-3, 0.0), atol=1e-12)
    assert nodes[len(nodes) // 2, 0] == 0.5e-3


@pytest.mark.parametrize(
    ("sensor", "pose", "words"),
    [
        ("thesis", Pose(grip=1.0, load=2.0), r"cannot hold a load of 2 N: a friction of 0.5 holds"),
        ("thesis", Pose(depth=1e-3), "is a dome: give --grip and --load"),
        ("flat-2019", Pose(grip=1.0), "is a flat pad.*give --press-mm and --shear-mm"),
    ],
)
def test_poses_that_cannot_be_are_refused(sensor: str, pose: Pose, words: str) -> None:
    with pytest.raises(UserError, match=words):
        settle(load_scene("camera-100hz", {"sensor": sensor}), pose)


def test_motion_blur_is_seen_in_a_grasp_and_not_at_rest() -> None:
    """Frames of a moving skin are means over the open shutter; a still one is as sharp as ever."""
    scene = load_scene("camera-100hz", {"defects.motion_blur": 1.0, "camera.noise_levels": 0.0})
    sharp = load_scene("camera-100hz", {"camera.noise_levels": 0.0})
    states: list[State] = [settle(scene, Pose(grip=3.0, load=f))[0] for f in (0.0, 1.2)]
    cameras = [open_camera(s) for s in (scene, sharp)]
    frames = [
        [camera.expose(state, k).image for k, state in enumerate((states[0], states[1], states[1]))]
        for camera in cameras
    ]
    assert (frames[0][0] == frames[1][0]).all()
    assert (frames[0][1] != frames[1][1]).any()
    assert (frames[0][2] == frames[1][2]).all()
