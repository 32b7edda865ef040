"""Pictures of silicone in poses: truth against statics, symmetry, the markers and what was asked.

Those of the pad take long: they are in the part `loops`.
"""

import json
import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import pytest

from chromagrip import UserError, load_scene
from chromagrip.loop.poses.dome_poses import DOME_ARRAYS, DomePose, settle_dome
from chromagrip.loop.poses.folder import render_poses
from chromagrip.model.dome import lattice
from chromagrip.render import DomeMap, load_sensor, rest_membrane
from chromagrip.scene.scene import Scene

COMMON = {"body": "dome", "path": "truth", "camera.noise_levels": 0.0}
DOME = COMMON | {"dome.pitch_mm": 0.8, "object.shape": "ball", "object.radius_mm": 6.0}
PAD = COMMON | {
    "sensor": "flat-2019", "dome.pitch_mm": 1.0, "object.shape": "box",
    "object.size_mm": [16.0, 16.0, 6.0], "object.rounding_mm": 0.5,
    "object.radius_mm": float("inf"),
}  # fmt: skip
FLAT = load_sensor("flat-2019")
POSES = {
    "dome": (DomePose(press=0.4e-3, twist=math.radians(8.0)),),
    "pad": (
        DomePose(press=0.25e-3, shear=(0.2e-3, 0.1e-3)),
        DomePose(press=0.5e-3, tilt=(0.02, -0.03), twist=0.1, azimuth=0.5),
    ),
}


@dataclass(frozen=True)
class Posed:
    """What stands in the folder of the poses of a body."""

    name: str
    scene: Scene
    entries: list[dict[str, Any]]
    truths: list[dict[str, np.ndarray]]


@pytest.fixture(scope="module", params=["dome", pytest.param("pad", marks=pytest.mark.loops)])
def posed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Posed:
    name, out = request.param, tmp_path_factory.mktemp("posed") / "poses"
    scene = load_scene("camera-100hz", {"dome": DOME, "pad": PAD}[name])
    render_poses(scene, POSES[name], out)
    truths = []
    for number in range(len(POSES[name])):
        with np.load(out / f"truth-{number:03d}.npz") as file:
            assert list(file) == list(DOME_ARRAYS)
            truths.append(dict(file))
    entries = json.loads((out / "poses.json").read_text(encoding="utf-8"))["poses"]
    return Posed(name, scene, entries, truths)


def test_forces_of_the_nodes_are_the_force_and_the_torque(posed: Posed) -> None:
    for truth, entry in zip(posed.truths, posed.entries, strict=True):
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


def test_flow_is_what_the_markers_do(posed: Posed) -> None:
    """At its resting pixel the flow of a marker's layer is the motion of the marker.

    The lower layer of the pad is rigid and does nothing.
    """
    sensor = posed.scene.build_sensor()
    start = sensor.view.project(rest_membrane(sensor).centres)
    for truth in posed.truths:
        motion = truth["pixels_px"] - start
        largest = np.linalg.norm(motion, axis=-1).max()
        assert largest > 0.5
        for layer in range(2):
            places = np.ascontiguousarray(start[layer], np.float32)[None]
            flow = truth["flow_px"][layer]
            there = cv2.remap(flow, *np.moveaxis(places, -1, 0), cv2.INTER_LINEAR)[0]
            known = np.isfinite(there).all(axis=1)
            if posed.name == "pad" and layer == 1:
                assert max(abs(motion[1]).max(), np.nanmax(abs(flow))) < 1e-4
                continue
            known &= (there != 0.0).any(axis=1)
            assert known.sum() > 50
            apart = np.linalg.norm(there - motion[layer], axis=1)[known]
            assert apart.max() < (0.02 if posed.name == "dome" else 0.04) * largest


def test_traction_in_the_image_carries_the_force(posed: Posed) -> None:
    """Summed over the skin that pixels show, nearly the force, though the mask is of pixels.

    On the pad, the distance is to where the skin seems to be, through silicone: its middle gives
    the scale.
    """
    truth, view = posed.truths[0], posed.scene.build_sensor().view
    traction, mask = truth["traction_pa"], truth["contact_mask"]
    assert mask.any()
    assert (np.nan_to_num(abs(traction)).max(axis=-1) > 0.0)[mask].all()
    if posed.name == "pad":
        middle = view.project(np.array([[-1e-3, 0.0, 0.0], [1e-3, 0.0, 0.0]]))
        area: Any = (2e-3 / np.linalg.norm(middle[1] - middle[0])) ** 2
    else:
        rows = np.meshgrid(np.arange(view.width), np.arange(view.height))
        origin, ray = view.trace(np.stack(rows, -1).astype(float))
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        points = origin + truth["depth_m"][..., None] * ray
        along, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
        area = np.linalg.norm(np.cross(along, down), axis=-1)[..., None]
    total, force = np.nansum(traction * area, axis=(0, 1)), posed.entries[0]["force_n"]
    if posed.name == "pad":
        assert total == pytest.approx(force, abs=0.06 * abs(force[2]))
    assert total[2] == pytest.approx(force[2], rel=0.12)


def test_each_body_moves_as_its_pose_says(posed: Posed) -> None:
    """A dome that is twisted swirls and does not drift.

    Under a wide object, a marker of the pad 1.8 of 2.2 mm above the rigid layer moves by 0.82 of
    the motion of the skin above it.
    """
    truth, rest = posed.truths[0], rest_membrane(posed.scene.build_sensor()).centres[0]
    moved = truth["centres_m"][0] - rest
    if posed.name == "pad":
        nodes = lattice(posed.scene.build_dome()).points
        skin = truth["seen_m"][np.linalg.norm(nodes, axis=1) < 2.5e-3, :2].mean(axis=0)
        four = np.linalg.norm(rest[:, :2], axis=1) < 2.5e-3
        assert four.sum() == 4
        assert moved[four, :2].mean(axis=0) == pytest.approx(1.8 / 2.2 * skin, rel=0.03)
        return
    x, y = truth["centres_m"][0, :, :2].T
    near = np.hypot(x, y) < 2e-3
    assert ((x * moved[:, 1] - y * moved[:, 0])[near] > 0.0).mean() > 0.95
    assert np.linalg.norm(moved[near, :2].mean(axis=0)) < 0.1 * abs(moved[near, :2]).max()


def test_a_dome_that_is_held_has_the_force_and_the_moment() -> None:
    pose = DomePose(force=(0.1, -0.05, 0.8), moment=2e-4)
    _, field = settle_dome(load_scene("camera-100hz", DOME), pose)
    forces = field.normal[:, None] * field.directions + field.friction
    assert forces.sum(axis=0) == pytest.approx([0.1, -0.05, -0.8], abs=2e-3)
    assert np.cross(field.position, forces).sum(axis=0)[2] == pytest.approx(2e-4, abs=2e-6)


@pytest.mark.loops
def test_at_rest_the_markers_are_where_the_chain_has_them() -> None:
    """Squares along x and y, at their depths."""
    still = DomeMap(FLAT, FLAT.dome)(np.zeros_like(lattice(FLAT.dome).points))
    expected = rest_membrane(FLAT)
    assert still.centres == pytest.approx(expected.centres, abs=1e-12)
    assert still.axes == pytest.approx(expected.axes, abs=1e-12)


def test_silicone_that_ends_above_a_layer_is_refused() -> None:
    for changes, thickness in ((DOME, 0.5), (PAD, 1.5)):
        shallow = load_scene("camera-100hz", changes | {"dome.thickness_mm": thickness})
        with pytest.raises(UserError, match=rf"below the silicone of {thickness} mm"):
            render_poses(shallow, [DomePose(press=0.1e-3)], None)
