"""A grasp frame by frame: what `run` does, in steps of one's own, saved and restored."""

import math
from collections.abc import Sequence
from contextlib import closing

import numpy as np
import pytest

import chromagrip
from chromagrip import Rig, Scene, UserError, load_scene
from chromagrip.loop import Sample, grasp, open_camera
from chromagrip.loop.columns import Rows
from chromagrip.sensing import reader

TRUTH = {"path": "truth", "duration_s": 0.2, "truth.margin_noise": 0.05}
CAMERA = {"duration_s": 0.02, "camera.rest_frames": 2, "tracker": "quick"}
#: A scene of each body and path, with what is lost, late and blurred.
SCENES = {
    "truth": load_scene("camera-100hz", TRUTH | {"camera.dropped": 0.3, "camera.late": 0.3}),
    "camera": load_scene("camera-100hz", CAMERA | {"defects.motion_blur": 0.5}),
    "dome": load_scene(
        "dome-1",
        {
            "duration_s": 0.1,
            "path": "truth",
            "camera.rate_hz": 60.0,
            "fingertip.step_ms": 8.0,
            "dome.pitch_mm": 0.8,
        },
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


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.loops] * (name == "camera")) for name in SCENES]
)
def test_a_grasp_that_is_restored_or_reset_has_the_same_bytes(name: str) -> None:
    scene = SCENES[name]
    forces = grips(scene.frames - 1)
    half = len(forces) // 2
    with chromagrip.open(scene) as rig:
        rig.reset()
        first, middle = followed(rig, forces[:half]), rig.sample(1.0)
        state = rig.save()
        straight = followed(rig, forces[half:])
        assert rig.done
        rig.restore(state)
        assert same([middle], [rig.sample(1.0)])
        followed(rig, [3.0 * force for force in forces[half:]])  # leaves nothing behind
        rig.restore(state)
        assert same(straight, followed(rig, forces[half:]))
        for seed in (None,) if name == "camera" else (scene.seed + 1, scene.seed, None):
            rig.reset(seed=seed)
            # A dome has no noise.
            assert same(first, followed(rig, forces[:half])) == (
                seed != scene.seed + 1 or name == "dome"
            )
    with chromagrip.open(scene) as another:
        another.reset(seed=None if name == "camera" else 77)  # another seed is read anew
        another.restore(state)
        assert same(straight, followed(another, forces[half:]))
        assert another.scene.seed == scene.seed


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
    # Observations come after the latency.
    with chromagrip.open(scene) as rig:
        seen = [rig.reset(), *(rig.step(1.0) for _ in range(4))]
        assert (rig.index, rig.time) == (4, pytest.approx(0.04))
    times = [None if one is None else round(one.time, 9) for one in seen]
    assert times == ([0.0, None, 0.0, 0.01, 0.02] if latency else [0.0, 0.01, 0.02, 0.03, 0.04])


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


def test_nothing_is_told_before_a_reset() -> None:
    with chromagrip.open(SCENES["truth"]) as rig:
        for call in (lambda: rig.step(1.0), rig.sample, rig.picture, rig.save, lambda: rig.arrived):
            with pytest.raises(UserError, match=r"is not possible before reset\(\); call"):
                call()


def test_what_no_grasp_takes_is_refused_and_changes_nothing() -> None:
    state = begun(SCENES["truth"]).save()
    rig = begun(load_scene("camera-100hz", TRUTH | {"duration_s": 0.02}))
    before = rig.sample(1.0)
    words = r"step\(\) at frame 0 was given .* N; a grip force is finite and not negative"
    for call, said in (
        (lambda: rig.step(math.nan), words),
        (lambda: rig.step(-0.1), words),
        (lambda: rig.restore(state), "belongs to another scene"),
        (lambda: rig.reset(seed=-1), "seed = -1 must be from 0 to"),
    ):
        with pytest.raises(UserError, match=said):
            call()
        assert same([before], [rig.sample(1.0)])
    rig.step(1.0)
    rig.step(1.0)
    with pytest.raises(UserError, match=r"ended with frame 2 at t = 0.02 s; call reset\(\)"):
        rig.step(1.0)
    rig.reset()
    assert not rig.done


@pytest.mark.loops
def test_what_is_read_of_the_rest_frames_is_kept_and_no_run_changes_it() -> None:
    def read(friction: float) -> np.ndarray:
        """Γ and places of the markers in the first frames of a grasp."""
        with chromagrip.open(
            load_scene("margin-60hz", CAMERA | {"duration_s": 0.04, "object.friction": friction})
        ) as rig:
            rig.reset()
            samples = followed(rig, [2.0, 2.0])
        return np.array([[s.observation.margin, *s.tracks.position.ravel()] for s in samples])

    reader._resting.cache_clear()
    first, other = read(0.5), read(0.3)
    np.testing.assert_array_equal(read(0.5), first)
    assert reader._resting.cache_info().hits == 2
    reader._resting.cache_clear()
    np.testing.assert_array_equal(read(0.3), other)
