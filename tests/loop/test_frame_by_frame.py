"""A grasp frame by frame: what `run` does, in steps of one's own, saved and restored."""

import math
from collections.abc import Sequence
from contextlib import closing

import numpy as np
import pytest

import chromagrip
from chromagrip import Rig, Scene, UserError, load_scene
from chromagrip.control import GripObservation
from chromagrip.loop import Sample, grasp, open_camera
from chromagrip.loop.columns import Rows

TRUTH = {"path": "truth", "duration_s": 0.4, "truth.margin_noise": 0.05}
CAMERA = {"duration_s": 0.06, "camera.rest_frames": 2}
#: A scene of each body and path, with what is lost, late and blurred.
SCENES = {
    "truth": load_scene("camera-100hz", TRUTH | {"camera.dropped": 0.3, "camera.late": 0.3}),
    "camera": load_scene("camera-100hz", CAMERA | {"defects.motion_blur": 0.5}),
    "dome": load_scene(
        "dome-1",
        {"duration_s": 0.1, "path": "truth", "camera.rate_hz": 60.0, "fingertip.step_ms": 8.0},
    ),
}


def grips(count: int) -> list[float]:
    return [1.0 + 0.5 * math.sin(0.7 * k) for k in range(count)]


def followed(rig: Rig, forces: Sequence[float]) -> list[Sample]:
    """Samples after each of these steps."""
    out = []
    for force in forces:
        rig.step(force)
        out.append(rig.sample(force))
    return out


def same(one: Sequence[Sample], other: Sequence[Sample]) -> bool:
    """Whether traces and pictures have the same bytes."""
    lines = Rows(SCENES["dome"]).line  # has all columns of one finger
    for a, b in zip(one, other, strict=True):
        if np.array(lines(a)).tobytes() != np.array(lines(b)).tobytes():
            return False
        if a.frame is not None and a.frame.image.tobytes() != b.frame.image.tobytes():
            return False
    return True


@pytest.mark.parametrize("name", SCENES)
def test_a_restored_grasp_goes_on_with_the_same_bytes(name: str) -> None:
    scene = SCENES[name]
    forces = grips(scene.frames - 1)
    half = len(forces) // 2
    with chromagrip.open(scene) as rig:
        rig.reset()
        followed(rig, forces[:half])
        middle = rig.sample(1.0)
        state = rig.save()
        straight = followed(rig, forces[half:])
        assert rig.done
        rig.restore(state)
        assert same([middle], [rig.sample(1.0)])
        followed(rig, [3.0 * force for force in forces[half:]])  # leaves nothing behind
        rig.restore(state)
        assert same(straight, followed(rig, forces[half:]))
    with chromagrip.open(scene) as another:
        another.reset(seed=77)
        another.restore(state)
        assert same(straight, followed(another, forces[half:]))
        assert another.scene.seed == scene.seed


@pytest.mark.parametrize("name", SCENES)
def test_a_seed_and_grips_decide_every_byte(name: str) -> None:
    scene = SCENES[name]
    forces = grips(3)
    with chromagrip.open(scene) as rig:
        rig.reset(seed=5)
        first = followed(rig, forces)
        rig.reset()
        assert same(first, followed(rig, forces))
        rig.reset(seed=6)
        other = followed(rig, forces)
        rig.reset(seed=5)
        assert same(first, followed(rig, forces))
    assert same(first, other) == (name == "dome")  # which has no noise
    fives = load_scene("camera-100hz", TRUTH | {"seed": 5, "camera.dropped": 0.3})
    with chromagrip.open(fives) as rig:
        assert rig.reset().time == 0.0


@pytest.mark.parametrize("latency", [0, 2])
def test_a_controller_of_ones_own_does_what_run_does(latency: int) -> None:
    scene = load_scene("camera-100hz", TRUTH | {"camera.latency_frames": latency})
    controller, line = scene.build_controller(), Rows(scene).line
    with chromagrip.open(scene) as rig:
        grip = controller.command(rig.reset()).force
        controller.reset()
        lines = []
        while True:
            for one in rig.arrived:
                grip = controller.command(one.observation).force
            lines.append(line(rig.sample(grip)))
            if rig.done:
                break
            rig.step(grip)
    with closing(open_camera(scene)) as camera:
        expected = [line(sample) for sample in grasp(scene, camera)]
    np.testing.assert_array_equal(lines, expected)


def test_observations_come_after_the_latency() -> None:
    scene = load_scene("camera-100hz", TRUTH | {"camera.latency_frames": 2})
    with chromagrip.open(scene) as rig:
        seen: list[GripObservation | None] = [rig.reset(), *(rig.step(1.0) for _ in range(4))]
        assert rig.time == pytest.approx(0.04)
        assert rig.index == 4
    times = [None if one is None else one.time for one in seen]
    assert times == [0.0, None, 0.0, pytest.approx(0.01), pytest.approx(0.02)]


def test_late_frames_arrive_together() -> None:
    scene = load_scene("camera-100hz", TRUTH | {"camera.late": 0.5, "camera.dropped": 0.2})
    arrived = []
    with chromagrip.open(scene) as rig:
        rig.reset()
        arrived += [rig.arrived]
        while not rig.done:
            newest = rig.step(1.0)
            arrived += [rig.arrived]
            assert newest is (rig.arrived[-1].observation if rig.arrived else None)
    assert {0, 1, 2} <= {len(some) for some in arrived}
    indices = [one.index for some in arrived for one in some]
    assert indices == sorted(set(indices))


def test_a_picture_of_the_truth_path_is_the_cameras() -> None:
    changes = CAMERA | {"camera.latency_frames": 0}
    pictures = []
    for path in ("camera", "truth"):
        with chromagrip.open(load_scene("camera-100hz", changes | {"path": path})) as rig:
            rig.reset()
            rig.step(2.0)
            pictures.append(rig.picture())
            assert rig.picture().image is pictures[-1].image
    assert pictures[0].time == pictures[1].time
    np.testing.assert_array_equal(pictures[0].image, pictures[1].image)


def begun(scene: Scene) -> Rig:
    rig = Rig(scene)
    rig.reset()
    return rig


@pytest.mark.parametrize("ask", ["step", "sample", "picture", "save"])
def test_nothing_is_told_before_a_reset(ask: str) -> None:
    with chromagrip.open(SCENES["truth"]) as rig:
        with pytest.raises(UserError, match=rf"^{ask}\(\) is not possible before reset\(\); call"):
            getattr(rig, ask)(*[1.0][: ask == "step"])
        with pytest.raises(UserError, match=r"^arrived is not possible before"):
            rig.arrived  # noqa: B018


@pytest.mark.parametrize("grip", [math.nan, math.inf, -0.1])
def test_a_grip_that_is_none_is_refused_and_changes_nothing(grip: float) -> None:
    rig = begun(SCENES["truth"])
    before = rig.sample(1.0)
    words = r"step\(\) at frame 0 was given .* N; a grip force is finite and not negative"
    with pytest.raises(UserError, match=words):
        rig.step(grip)
    assert same([before], [rig.sample(1.0)])


def test_a_grasp_that_is_over_must_be_reset() -> None:
    rig = begun(load_scene("camera-100hz", TRUTH | {"duration_s": 0.02}))
    rig.step(1.0)
    rig.step(1.0)
    with pytest.raises(UserError, match=r"ended with frame 2 at t = 0.02 s; call reset\(\)"):
        rig.step(1.0)
    rig.reset()
    assert not rig.done


def test_a_state_of_another_scene_is_refused() -> None:
    state = begun(SCENES["truth"]).save()
    other = begun(load_scene("camera-100hz", TRUTH))
    with pytest.raises(UserError, match="belongs to another scene"):
        other.restore(state)
    with pytest.raises(UserError, match="seed = -1 must be from 0 to"):
        other.reset(seed=-1)
