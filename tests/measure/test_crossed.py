"""A chain's grasp drawn by the dome, and the other way round."""

import numpy as np
import pytest

from chromagrip import UserError
from chromagrip.loop.grasp import grasp
from chromagrip.measure.worlds.crossed import crossed, solid_of, watch_dome
from chromagrip.measure.worlds.force_scenes import Grasp, Specimen
from chromagrip.measure.worlds.grasps import calibration
from chromagrip.model import ContactObject, Drive
from chromagrip.render import Defects, load_sensor
from chromagrip.scene.scene import parse_scene

SCENE = {
    "duration_s": 0.6, "path": "truth", "controller": "conservative",
    "conservative": {"force_n": 2.0}, "camera": {"rate_hz": 30.0},
    "object": {"radius_mm": 20.0, "friction": 0.6},
    "load": {"times_s": [0.05, 0.15], "forces_n": [0.0, 0.5], "interpolation": "linear"},
}  # fmt: skip


@pytest.mark.parametrize("body", ["chain", "dome"])
def test_the_same_scene_runs_on_both_bodies(body: str) -> None:
    scene = parse_scene(SCENE | {"body": body}, "test")
    other = crossed(scene)
    assert {scene.body, other.body} == {"chain", "dome"}
    assert crossed(other) == scene
    ends = [list(grasp(each, None))[-1] for each in (scene, other)]
    # Grip and load are borne by either; on a ball ΣFn is a little more than the grip.
    for end in ends:
        assert end.field.total_normal == pytest.approx(2.0, rel=0.06)
        assert end.field.total_friction == pytest.approx(0.5, rel=0.15)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"object": {"surface": "stays"}}, "object.surface cannot be drawn"),
        ({"body": "dome", "object": {"shape": "torus", "size_mm": [6.0, 2.0]}}, "object.shape"),
        (
            {"body": "dome", "load": {"times_s": [0.0], "forces_n": [0.0], "sideways_n": [0.1]}},
            "load.sideways_n cannot be drawn",
        ),
    ],
)
def test_what_one_body_alone_holds_is_said(values: dict[str, object], said: str) -> None:
    with pytest.raises(UserError, match=said):
        crossed(parse_scene(SCENE | values, "test"))
    with pytest.raises(UserError, match="one µ"):
        solid_of(ContactObject(curvature=-20.0))


def test_a_chains_grasp_is_drawn_by_the_dome() -> None:
    known = calibration()
    specimen = Specimen(
        fingertip=known.fingertip, sensor=known.sensor, defects=Defects(), renderer="painter"
    )
    grasped = Grasp(
        obj=ContactObject(stiffness=500.0, friction=0.6),
        drive=Drive(
            times=np.array([0.0, 0.1, 0.3, 0.6]),
            normal=np.array([0.02, 2.0, 2.0, 2.0]),
            lateral=np.array([0.0, 0.0, 0.4, 0.4]),
        ),
        ends=(0.6,),
    )
    (scene,) = watch_dome(known, specimen, load_sensor("thesis").dome, grasped, 1)
    # The forces are the grip and the load, of a flat object on a dome.
    assert scene.field.total_force == pytest.approx([0.4, 0.0, -2.0], abs=0.02)
    assert scene.margin == pytest.approx(1.0 - 0.4 / (0.6 * 2.0), abs=0.02)
    # The markers have moved with the load near the apex, and outwards around it.
    moved = scene.tracks[-1].position - scene.rest.position
    both = scene.rest.visible.all(axis=0) & scene.tracks[-1].visible.all(axis=0)
    middle = scene.rest.position[0] - scene.rest.position[0, both].mean(axis=0)
    near = both & (np.linalg.norm(middle, axis=1) < 60.0)
    assert moved[0, near, 0].mean() > 3.0 * abs(moved[0, near, 1].mean())
    outwards = (moved[0] * middle).sum(axis=1) / np.linalg.norm(middle, axis=1)
    assert outwards[near].mean() > 0.2
