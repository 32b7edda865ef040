"""The flat sensor with silicone: truth against statics, its markers and where they rest."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from chromagrip import UserError, load_scene
from chromagrip.loop.poses.dome_poses import DomePose
from chromagrip.loop.poses.folder import render_poses
from chromagrip.model.dome import lattice
from chromagrip.render import DomeMap, load_sensor, rest_membrane

pytestmark = pytest.mark.loops

FLAT = load_sensor("flat-2019")
BOX = {
    "sensor": "flat-2019", "body": "dome", "path": "truth", "camera.noise_levels": 0.0,
    "dome.pitch_mm": 1.0, "object.shape": "box", "object.size_mm": [16.0, 16.0, 6.0],
    "object.rounding_mm": 0.5, "object.radius_mm": float("inf"),
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("pad") / "poses"
    sheared = DomePose(press=0.25e-3, shear=(0.2e-3, 0.1e-3))
    tilted = DomePose(press=0.5e-3, tilt=(0.02, -0.03), twist=0.1, azimuth=0.5)
    render_poses(load_scene("camera-100hz", BOX), [sheared, tilted], out)
    return out


def _truth(folder: Path, number: int) -> dict[str, np.ndarray]:
    with np.load(folder / f"truth-{number:03d}.npz") as file:
        return dict(file)


def test_at_rest_the_markers_are_where_the_chain_has_them() -> None:
    """Squares along x and y, at their depths."""
    still = DomeMap(FLAT, FLAT.dome)(np.zeros_like(lattice(FLAT.dome).points))
    expected = rest_membrane(FLAT)
    assert still.centres == pytest.approx(expected.centres, abs=1e-12)
    assert still.axes == pytest.approx(expected.axes, abs=1e-12)


@pytest.mark.parametrize("number", [0, 1])
def test_forces_of_the_nodes_are_the_force_and_the_torque(folder: Path, number: int) -> None:
    truth = _truth(folder, number)
    entry = json.loads((folder / "poses.json").read_text(encoding="utf-8"))["poses"][number]
    forces = truth["force_normal_n"][:, None] * truth["force_direction"]
    forces = forces + truth["force_friction_n"]
    assert forces.sum(axis=0) == pytest.approx(entry["force_n"], abs=6e-6)
    torque = 1e3 * np.cross(truth["force_position_m"], forces).sum(axis=0)
    assert torque == pytest.approx(entry["torque_nmm"], abs=6e-5)


@pytest.mark.parametrize("number", [0, 1])
def test_flow_is_what_the_markers_do(folder: Path, number: int) -> None:
    """And the rigid layer does nothing."""
    truth = _truth(folder, number)
    start = FLAT.view.project(rest_membrane(FLAT).centres)
    motion = truth["pixels_px"] - start
    places = np.ascontiguousarray(start[0], np.float32)[None]
    there = cv2.remap(truth["flow_px"][0], *np.moveaxis(places, -1, 0), cv2.INTER_LINEAR)[0]
    largest = np.linalg.norm(motion[0], axis=-1).max()
    assert largest > 0.5
    assert np.linalg.norm(there - motion[0], axis=1).max() < 0.04 * largest
    assert abs(motion[1]).max() < 1e-4
    assert np.nanmax(abs(truth["flow_px"][1])) < 1e-4


def test_under_a_wide_object_a_marker_shears_in_proportion_to_its_height(folder: Path) -> None:
    """1.8 of 2.2 mm above the rigid layer: 0.82 of the motion of the skin above it."""
    truth, nodes = _truth(folder, 0), lattice(load_scene("camera-100hz", BOX).build_dome())
    skin = truth["seen_m"][np.linalg.norm(nodes.points, axis=1) < 2.5e-3, :2].mean(axis=0)
    moved = truth["centres_m"][0] - rest_membrane(FLAT).centres[0]
    four = np.linalg.norm(rest_membrane(FLAT).centres[0, :, :2], axis=1) < 2.5e-3
    assert four.sum() == 4
    assert moved[four, :2].mean(axis=0) == pytest.approx(1.8 / 2.2 * skin, rel=0.03)


def test_traction_in_the_image_carries_the_force(folder: Path) -> None:
    """The distance is to where the skin seems to be, through silicone; its middle gives a scale."""
    truth, entry = _truth(folder, 0), json.loads((folder / "poses.json").read_text())["poses"][0]
    middle = FLAT.view.project(np.array([[-1e-3, 0.0, 0.0], [1e-3, 0.0, 0.0]]))
    pixel = 2e-3 / np.linalg.norm(middle[1] - middle[0])
    total = np.nansum(truth["traction_pa"], axis=(0, 1)) * pixel**2
    assert truth["contact_mask"].any()
    assert total == pytest.approx(entry["force_n"], abs=0.06 * abs(entry["force_n"][2]))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"core_mm": 3.0, "thickness_mm": 0.0}, "of a pad has thickness_mm"),
        ({"core_mm": 3.0}, "of a pad has thickness_mm"),
        ({"thickness_mm": 30.0}, "thickness of the pad"),
        ({"pitch_mm": 9.0}, "pad pitch"),
    ],
)
def test_silicone_of_a_pad_that_cannot_be(
    tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    from importlib.resources import files

    text = (files("chromagrip.render") / "designs" / "flat-2019.toml").read_text(encoding="utf-8")
    wanted = {"thickness_mm": 2.2, "young_kpa": 400.0, **changes}
    lines = "".join(f"{name} = {value}\n" for name, value in wanted.items())
    head, _, tail = text.partition("[silicone]\n")
    (tmp_path / "own.toml").write_text(
        head + "[silicone]\n" + lines + tail[tail.index("poisson") :], encoding="utf-8"
    )
    with pytest.raises(UserError, match=words):
        load_sensor(str(tmp_path / "own.toml"))


def test_silicone_that_ends_above_a_layer_is_refused() -> None:
    shallow = load_scene("camera-100hz", BOX | {"dome.thickness_mm": 1.5})
    with pytest.raises(UserError, match=r"below the silicone of 1\.5 mm"):
        render_poses(shallow, [DomePose(press=0.1e-3)], None)
