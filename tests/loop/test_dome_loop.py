"""The closed loop around a dome, on the truth path."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from chromagrip import Result, UserError, load_scene, run
from chromagrip.loop import grasp
from chromagrip.model import Dome

#: A coarse dome, so that a run takes a second.
COARSE = {"path": "truth", "body": "dome", "dome.pitch_mm": 0.8, "camera.rate_hz": 100.0}
#: A constant grip of 1 N and a load that pulls from 50 ms on.
HELD = {"controller": "conservative", "conservative.force_n": 1.0, "load.times_s": [0.05]}
SHORT = {"duration_s": 0.4}


def ran(scene: str = "thesis", **changes: Any) -> Result:
    """Result of a scene on the coarse dome; `__` in a name is a dot."""
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    return run(load_scene(scene, {**COARSE, **keys}))


@pytest.fixture(scope="module")
def held() -> Result:
    return ran(**HELD, load__forces_n=[0.25], **SHORT)


@pytest.mark.loops
def test_safety_margin_settles_on_a_dome() -> None:
    done = ran(camera__rate_hz=1000.0, fingertip__step_ms=1.0, duration_s=0.9)
    trace = done.trace
    assert done.summary["mechanics"] == "dome"
    assert done.summary["final_margin_estimated"] == pytest.approx(0.30, abs=0.01)
    # µ is read low by what sticks at the rim, so that the grip is on the safe side.
    assert 0.30 < done.summary["final_margin_true"] < 0.38
    assert trace["normal_true_n"][-1] == pytest.approx(trace["grip_n"][-1], rel=0.01)
    assert trace["friction_true_n"][-1] == pytest.approx(0.25, rel=0.01)


def test_chain_and_dome_are_held_by_the_same_forces(held: Result) -> None:
    changes = {"path": "truth", "load.forces_n": [0.25], "fingertip.nodes": 101}
    chain = run(load_scene("camera-100hz", changes | HELD | {"duration_s": 0.8}))
    for name, off in (("normal_true_n", 0.01), ("friction_true_n", 0.01), ("margin_true", 0.02)):
        assert held.trace[name][-1] == pytest.approx(chain.trace[name][-1], abs=off)


def test_an_object_that_slides_is_slowed_by_its_drag() -> None:
    trace = ran(**HELD, load__forces_n=[0.65], object__friction=0.3, **SHORT).trace
    # Load less friction, over the drag of 120 N·s/m: 2.9 mm/s.
    speed = (0.65 - 0.3 * 1.0) / 120.0
    late = trace["time_s"] > 0.25
    for name in ("object_mm", "rigid_slip_mm", "lateral_displacement_mm"):
        slope = np.polyfit(trace["time_s"][late], trace[name][late], 1)[0]
        assert slope == pytest.approx(1e3 * speed, rel=0.02), name
    assert trace["margin_true"][-1] == pytest.approx(0.0, abs=2e-3)


def test_a_load_along_y_does_what_one_along_x_does(held: Result) -> None:
    sideways = ran(**HELD, load__forces_n=[0.0], load__sideways_n=[0.25], **SHORT).trace
    for name in ("margin_true", "normal_true_n", "rigid_part_mm"):
        np.testing.assert_allclose(sideways[name][1:], held.trace[name][1:], rtol=2e-3, atol=2e-4)
    np.testing.assert_allclose(sideways["object_y_mm"], held.trace["object_mm"], atol=2e-3)
    assert abs(sideways["object_mm"]).max() < 2e-3


def test_a_torque_that_the_grip_cannot_bear_turns_the_object() -> None:
    few = {**HELD, "load.forces_n": [0.0], **SHORT}
    weak = ran(**few, load__twists_nmm=[0.1]).trace
    strong = ran(**few, load__twists_nmm=[1.0]).trace
    # Friction that only turns adds up to no force: Γ does not see it, the other margin does.
    for trace in (weak, strong):
        assert trace["margin_true"][-1] > 0.97
    assert 0.1 < weak["limit_margin_true"][-1] < 0.9
    assert weak["object_turn_deg"][-1] - weak["object_turn_deg"][-10] < 0.1
    # Only the innermost nodes, which hardly move, still stick.
    assert -1e-6 < strong["limit_margin_true"][-1] < 0.25
    assert strong["object_turn_deg"][-1] - strong["object_turn_deg"][-10] > 1.0


def test_an_object_that_gets_slippery_slips() -> None:
    trace = ran(
        **HELD, load__forces_n=[0.25], object__friction_times_s=[0.15], object__frictions=[0.15],
        duration_s=0.3,
    ).trace  # fmt: skip
    before, after = trace["time_s"] < 0.15, trace["time_s"] > 0.28
    assert trace["rigid_slip_mm"][before].max() < 0.01
    assert abs(trace["margin_true"][after]).max() < 0.01
    assert set(trace["mu_true"]) == {0.5, 0.15}


def test_a_calm_grasp_takes_long_steps_on_the_same_way() -> None:
    """Silicone that gives way for a while does it as fast in a step a frame as in short ones."""
    creeping = {**HELD, "load__forces_n": [0.25], "duration_s": 0.3, "dome__relaxation_ms": 60.0}
    fine, calm = (ran(**creeping, fingertip__calm_um_per_s=speed).trace for speed in (0.0, 1e3))
    assert fine["object_mm"][-1] - fine["object_mm"][8] > 0.1
    assert calm["object_mm"] == pytest.approx(fine["object_mm"], abs=3e-3)
    assert calm["margin_true"][8:] == pytest.approx(fine["margin_true"][8:], abs=5e-3)


def test_an_object_beside_the_apex_is_touched_at_once() -> None:
    for changes in (
        {"object.radius_mm": 6.0, "object.beside_mm": [2.0, 0.0]},
        {"object.turned_deg": [0.0, 20.0, 0.0], "object.beside_mm": [1.0, 0.0]},
    ):
        scene = load_scene("thesis", {**COARSE, **HELD, "load.forces_n": [0.0], **changes})
        samples = grasp(scene, None)
        assert not next(samples).field.contact.any()
        assert next(samples).field.contact.any()


def test_a_mesh_is_found_beside_its_scene(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("igl")
    trimesh.creation.box((12.0, 12.0, 12.0)).export(tmp_path / "cube.stl")
    (tmp_path / "mine.toml").write_text(
        'path = "truth"\nbody = "dome"\nduration_s = 0.05\ncontroller = "conservative"\n'
        '[object]\nmesh = "cube.stl"\nmesh_cells = 32\n[dome]\npitch_mm = 0.8\n'
        "[load]\ntimes_s = []\nforces_n = []\n[conservative]\nforce_n = 1.0\n"
    )
    of_mesh = run(str(tmp_path / "mine.toml")).trace
    changes = {"object.mesh": "", "object.shape": "box", "object.size_mm": [12.0, 12.0, 12.0]}
    of_box = run(load_scene(str(tmp_path / "mine.toml"), changes)).trace
    assert of_mesh["rigid_part_mm"][-1] == pytest.approx(of_box["rigid_part_mm"][-1], rel=0.01)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"sensor": "flat-2019", "path": "camera"}, "no estimator reads the silicone of the flat"),
        ({"body": "chain"}, r"dome.pitch_mm = 0.8 is for body = \"dome\""),
        ({"object.surface": "stays"}, "object.surface = 'stays' is for body = \"chain\""),
        ({"object.radius_mm": -20.0}, "must be above 0 on a dome"),
        ({"object.shape": "cone", "object.size_mm": [1.0, 2.0], "object.radius_mm": 3.0}, "inf"),
        ({"object.mesh": "a.stl", "object.shape": "torus"}, "mesh takes the place of shape"),
    ],
)
def test_what_a_body_does_not_know_is_refused(changes: dict[str, Any], told: str) -> None:
    with pytest.raises(UserError, match=told):
        load_scene("thesis", {**COARSE, **changes})


@pytest.mark.parametrize(("force", "more"), [(60.0, {"object__radius_mm": 4.0}), (500.0, {})])
def test_too_strong_a_grip_is_one_sentence(force: float, more: dict[str, float]) -> None:
    """It does not leap through the dome in one step, as if nothing had ever touched."""
    with pytest.raises(UserError, match=r"the object is pressed to \d+% of the silicone"):
        ran(controller="conservative", conservative__force_n=force, duration_s=0.1, **more)


def test_a_scene_changes_the_silicone_of_the_design() -> None:
    changes = {"dome.young_kpa": 200.0, "dome.thickness_mm": 1.0, "dome.relaxation_ms": 20.0}
    dome = load_scene("thesis", {**COARSE, "sensor": "dome-2022", **changes}).build_dome()
    assert dome == Dome(radius=21e-3, core=20e-3, young=200e3, pitch=0.8e-3, relaxation=0.02)
    assert math.isclose(load_scene("thesis").build_sensor().dome.young, 0.4e6)
