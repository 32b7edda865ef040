"""Pictures of a dome: truth against statics, symmetry, the markers and what was asked."""

import json
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from chromagrip import UserError, load_scene
from chromagrip.loop.poses.dome_poses import DOME_ARRAYS, DomePose
from chromagrip.loop.poses.folder import render_poses
from chromagrip.render import rest_membrane
from chromagrip.scene.scene import Scene

SMALL = {
    "body": "dome", "path": "truth", "dome.pitch_mm": 0.8, "camera.noise_levels": 0.0,
    "object.shape": "ball", "object.radius_mm": 6.0,
}  # fmt: skip
TWISTED = DomePose(press=0.4e-3, twist=math.radians(8.0))
SHEARED = DomePose(press=0.4e-3, shear=(0.1e-3, 0.05e-3), tilt=(0.05, -0.1))
HELD = DomePose(force=(0.1, -0.05, 0.8), moment=2e-4)


def _scene(**changes: Any) -> Scene:
    return load_scene("camera-100hz", SMALL | changes)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("dome") / "poses"
    render_poses(_scene(), [TWISTED, SHEARED, HELD], out)
    return out


@pytest.fixture(scope="module")
def entries(folder: Path) -> list[dict[str, Any]]:
    return list(json.loads((folder / "poses.json").read_text(encoding="utf-8"))["poses"])


def _truth(folder: Path, number: int) -> dict[str, np.ndarray]:
    with np.load(folder / f"truth-{number:03d}.npz") as file:
        assert list(file) == list(DOME_ARRAYS)
        return dict(file)


@pytest.mark.parametrize("number", [0, 1, 2])
def test_forces_of_the_nodes_are_the_force_and_the_torque(
    folder: Path, entries: list[dict[str, Any]], number: int
) -> None:
    truth, entry = _truth(folder, number), entries[number]
    forces = truth["force_normal_n"][:, None] * truth["force_direction"]
    forces = forces + truth["force_friction_n"]
    assert forces.sum(axis=0) == pytest.approx(entry["force_n"], abs=6e-6)
    torque = 1e3 * np.cross(truth["force_position_m"], forces).sum(axis=0)
    assert torque == pytest.approx(entry["torque_nmm"], abs=6e-5)
    sizes = np.linalg.norm(truth["force_friction_n"], axis=1)
    limits = entry["mu"] * truth["force_normal_n"]
    assert (sizes <= limits * (1.0 + 1e-6) + 1e-12).all()
    slips = truth["force_slips"]
    assert (sizes[slips] > 0.99 * limits[slips]).all()
    along = (truth["force_friction_n"] * truth["force_direction"]).sum(axis=1)
    assert abs(along).max() < 1e-9


def test_an_object_that_is_held_has_the_force_and_the_moment(
    entries: list[dict[str, Any]],
) -> None:
    assert entries[2]["force_n"] == pytest.approx([0.1, -0.05, -0.8], abs=2e-3)
    assert entries[2]["torque_nmm"][2] == pytest.approx(0.2, abs=2e-3)


@pytest.mark.parametrize("number", [0, 1, 2])
def test_flow_is_what_the_markers_do(folder: Path, number: int) -> None:
    """At its resting pixel the flow of a marker's layer is the motion of the marker."""
    truth, sensor = _truth(folder, number), _scene().build_sensor()
    start = sensor.view.project(rest_membrane(sensor).centres)
    flow, motion = truth["flow_px"], truth["pixels_px"] - start
    largest = np.linalg.norm(motion, axis=-1).max()
    assert largest > 0.5
    for layer in range(2):
        places = np.ascontiguousarray(start[layer], np.float32)[None]
        there = cv2.remap(flow[layer], *np.moveaxis(places, -1, 0), cv2.INTER_LINEAR)[0]
        known = np.isfinite(there).all(axis=1) & (there != 0.0).any(axis=1)
        assert known.sum() > 50
        apart = np.linalg.norm(there - motion[layer], axis=1)[known]
        assert apart.max() < 0.02 * largest


def test_a_twist_is_a_swirl_and_no_drift(folder: Path) -> None:
    truth = _truth(folder, 0)
    x, y = truth["centres_m"][0, :, :2].T
    sensor = _scene().build_sensor()
    moved = truth["centres_m"][0] - rest_membrane(sensor).centres[0]
    around = x * moved[:, 1] - y * moved[:, 0]
    near = np.hypot(x, y) < 2e-3
    assert (around[near] > 0.0).mean() > 0.95
    assert np.linalg.norm(moved[near, :2].mean(axis=0)) < 0.1 * abs(moved[near, :2]).max()


def test_traction_in_the_image_carries_the_normal_force(folder: Path) -> None:
    """Summed over the skin that pixels show, nearly the force, though the mask is of pixels."""
    truth, view = _truth(folder, 0), _scene().build_sensor().view
    traction, depth = truth["traction_pa"], truth["depth_m"]
    mask = truth["contact_mask"]
    assert mask.any()
    assert (np.nan_to_num(abs(traction)).max(axis=-1) > 0.0)[mask].all()
    grid = np.stack(np.meshgrid(np.arange(view.width), np.arange(view.height)), -1).astype(float)
    origin, ray = view.trace(grid)
    points = origin + depth[..., None] * ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    along, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
    area = np.linalg.norm(np.cross(along, down), axis=-1)
    total = np.nansum(traction * area[..., None], axis=(0, 1))
    forces = truth["force_normal_n"][:, None] * truth["force_direction"]
    forces = (forces + truth["force_friction_n"]).sum(axis=0)
    assert total[2] == pytest.approx(forces[2], rel=0.12)


def test_a_layer_below_the_silicone_is_refused() -> None:
    with pytest.raises(UserError, match="below the silicone"):
        render_poses(_scene(**{"dome.thickness_mm": 0.5}), [DomePose(press=0.1e-3)], None)
