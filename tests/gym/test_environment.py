"""The environment for Gymnasium: what it promises, and that a seed decides every byte."""

import math
import subprocess
import sys
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv

import chromagrip.gym
from chromagrip import UserError, load_scene, scene_names
from chromagrip.gym.environment import DROP_COST, GripEnv, _most_n
from chromagrip.gym.observations import FORCES

NAME = "chromagrip/Grasp-v0"
QUICK = {"camera.rest_frames": 2, "duration_s": 0.3, "tracker": "quick"}
NOISY = QUICK | {"truth.margin_noise": 0.05, "camera.dropped": 0.2, "camera.late": 0.2}


def made(**options: Any) -> GripEnv:
    env = gymnasium.make(NAME, **({"changes": QUICK} | options)).unwrapped
    assert isinstance(env, GripEnv)
    return env


def action(force: float, most: float = 5.0) -> np.ndarray:
    return np.array([2.0 * force / most - 1.0], np.float32)


Step = tuple[np.ndarray, float, bool, bool, dict[str, Any]]


def rolled(env: GripEnv, actions: list[np.ndarray]) -> list[Step]:
    return [env.step(one) for one in actions]  # type: ignore[misc]


def same(one: list[Step], other: list[Step]) -> bool:
    return all(
        a[0].tobytes() == b[0].tobytes() and a[1:4] == b[1:4] and repr(a[4]) == repr(b[4])
        for a, b in zip(one, other, strict=True)
    )


def test_gymnasium_finds_nothing_wrong(capsys: pytest.CaptureFixture[str]) -> None:
    """Warnings are errors here; without a display the mode human says so."""
    check_env(gymnasium.make(NAME, changes=QUICK | {"duration_s": 0.05}).unwrapped)
    assert "no display" in capsys.readouterr().err


@pytest.mark.parametrize("scene", scene_names())
def test_gymnasium_finds_nothing_wrong_with_any_scene(scene: str) -> None:
    env = gymnasium.make(NAME, scene=scene, action="rate", observation="forces")
    check_env(env.unwrapped, skip_render_check=True)


def test_a_policy_is_told_what_a_controller_is_told() -> None:
    changes = NOISY | {"camera.latency_frames": 2}
    env = made(observation="forces", changes=changes)
    env.reset(seed=3)
    steps = rolled(env, [action(1.0)] * 20)
    scene = load_scene("camera-100hz", changes | {"path": "truth"})
    seed = int(np.random.Generator(np.random.PCG64(3)).integers(2**32))
    last: Any = None
    with chromagrip.open(scene) as rig:
        rig.reset(seed=seed)
        for shown, *_, info in steps:
            rig.step(info["grip_n"])
            if rig.arrived:
                last = rig.arrived[-1].observation
                fresh = dict(zip(FORCES, shown.tolist(), strict=True))
                assert fresh["normal_n"] == np.float32(last.field.total_normal)
                assert fresh["mu_high"] == np.nan_to_num(np.float32(last.friction_interval[1]))
                assert (fresh["grip_n"], fresh["known"]) == pytest.approx((1.0, 1.0))
                assert fresh["torque_nmm"] == 0.0  # not known of a chain
    assert last is not None


def test_the_image_arrives_with_the_latency_and_is_the_cameras() -> None:
    env = made(observation="image", changes=QUICK | {"camera.latency_frames": 2})
    first, _ = env.reset(seed=0)
    steps = rolled(env, [action(2.0)] * 3)
    assert (steps[0][0] == first).all()
    with chromagrip.open(env._rig.scene) as rig:
        rig.reset()
        for shown in (steps[1][0], steps[2][0]):
            np.testing.assert_array_equal(shown, rig.picture().image)
            rig.step(2.0)


@pytest.mark.loops
def test_markers_move_where_the_skin_moves() -> None:
    env = made(observation="markers")
    still, _ = env.reset(seed=0)
    pressed = rolled(env, [action(3.0)] * 3)[-1][0]
    assert still.shape == pressed.shape == env.observation_space.shape
    shifts = [np.abs(one.reshape(2, -1, 3)[..., :2]).max() for one in (still, pressed)]
    assert shifts[0] < 0.3
    assert shifts[1] > 1.0


@pytest.mark.loops
def test_worker_processes_give_the_same_bytes() -> None:
    made_by = f"chromagrip.gym:{NAME}"
    makers = [lambda: gymnasium.make(made_by, observation="forces", changes=NOISY)] * 2
    runs = []
    for vector in (SyncVectorEnv(makers), AsyncVectorEnv(makers, context="forkserver")):
        steps = [vector.reset(seed=[4, 5])[0]]
        rng = np.random.default_rng(0)
        for _ in range(40):  # beyond the end, where a new one begins
            steps.append(vector.step(rng.uniform(-0.5, 0.5, (2, 1)).astype(np.float32))[0])
        vector.close()
        runs.append(np.stack(steps))
    assert runs[0].tobytes() == runs[1].tobytes()
    assert (runs[0][:, 0] != runs[0][:, 1]).any()


@pytest.mark.loops
def test_environments_are_registered_without_heavy_imports() -> None:
    for first, name in (("gymnasium", NAME), ("chromagrip", f"chromagrip.gym:{NAME}")):
        script = (
            f"import {first}, sys\n"
            f"assert ('gymnasium' in sys.modules) == ('gymnasium' == {first!r})\n"
            "import chromagrip, gymnasium\n"
            "assert 'cv2' not in sys.modules and 'numba' not in sys.modules\n"
            f"print(gymnasium.make({name!r}, changes={{'duration_s': 0.1}}).spec.id)"
        )
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
        assert done.stdout.strip() == NAME, done.stderr


def test_holding_gently_pays_best_and_dropping_ends_it() -> None:
    env, returns = made(changes={"duration_s": 0.5, "load.forces_n": [0.8, 0.8]}), {}
    for force in (0.2, 2.0, 4.0):
        env.reset(seed=0)
        total, terminated, truncated = 0.0, False, False
        while not (terminated or truncated):
            _, reward, terminated, truncated, info = env.step(action(force))
            total += reward
        returns[force] = total
        assert terminated == info["dropped"] == (force == 0.2)
        if force == 2.0:
            paid = 50 * (1.0 - 2.0 / 5.0) - DROP_COST * info["rigid_slip_mm"]
            assert total == pytest.approx(paid)
    assert returns[2.0] > returns[4.0] > returns[0.2]


def test_what_slides_pays_for_it() -> None:
    changes = {"duration_s": 2.0, "load.times_s": [0.04, 0.2]}
    env, slid, total, held, terminated = made(changes=changes, dropped_mm=0.5), 0.0, 0.0, 0.0, False
    env.reset(seed=0)
    while not terminated:
        _, reward, terminated, _, info = env.step(action(0.6 if slid == 0.0 else 0.4))
        if info["rigid_slip_mm"] - slid < 1e-3:
            held += 1.0 - info["applied_n"] / 5.0
        slid, total = info["rigid_slip_mm"], total + reward
    assert 0.5 <= slid < 0.6
    assert info["dropped"]
    with pytest.raises(UserError, match=r"after the end; call reset\(\)"):
        env.step(action(2.0))
    assert total == pytest.approx(held - DROP_COST * slid / 0.5)


def test_an_action_may_be_a_rate() -> None:
    env = made(action="rate", rate_n_per_s=50.0, most_n=2.0)
    env.reset(seed=0)
    one, half = np.ones(1, np.float32), np.full(1, 0.5, np.float32)
    grips = [step[4]["grip_n"] for step in rolled(env, [one, half, -half, *[one] * 5])]
    assert grips == pytest.approx([0.5, 0.75, 0.5, 1.0, 1.5, 2.0, 2.0, 2.0])


def test_a_reset_may_change_the_scene_for_one_grasp() -> None:
    env = made()
    for changes, mu in (({"object.friction": np.float64(0.9)}, 0.9), ({}, 0.5)):
        env.reset(seed=0, options={"changes": changes})
        rolled(env, [action(2.0)] * 5)
        assert env._rig.truth.friction == pytest.approx(mu, abs=1e-9)
    with pytest.raises(UserError, match=r"object\.friction"):
        env.reset(options={"changes": {"object.friction": -1.0}})


def test_pictures_are_drawn_on_request() -> None:
    env = made(render_mode="rgb_array")
    assert env.metadata["render_fps"] == 100.0
    env.reset(seed=0)
    before = env.render()
    rolled(env, [action(3.0)] * 2)
    assert before.shape == (480, 640, 3)
    assert (env.render() != before).any()
    assert made().render() is None
    for _ in range(2):
        env.close()


def test_what_cannot_be_made_is_refused() -> None:
    for options, words in (
        ({"observation": "sound"}, "observation = 'sound': allowed are image, markers"),
        ({"observation": "markers", "path": "truth"}, "comes from the camera"),
        ({"most_n": 0.0}, r"most_n = 0\.0 must be finite and above 0"),
    ):
        with pytest.raises(UserError, match=words):
            made(**options)


def test_an_action_that_is_no_number_is_refused() -> None:
    """The policy grips: a controller that the scene names is not run, and need not be there."""
    env = made(changes={"controller": "nowhere:Absent"})
    with pytest.raises(UserError, match=r"step\(\) is not possible before reset\(\)"):
        env.step(action(1.0))
    env.reset(seed=0)
    with pytest.raises(UserError, match="action nan is not finite; allowed is -1 to 1"):
        env.step(np.array([math.nan], np.float32))
    assert env.step(action(0.4))[4]["time_s"] > 0.0


def test_the_largest_grip_holds_the_load_with_room_to_spare() -> None:
    """Γ = 1 − load/(µ·grip) is at least the usual target of 0.3 on a slippery object."""
    for name in ("camera-100hz", "pinch-lift"):
        scene, rough = (load_scene(name, {"object.friction": mu}) for mu in (0.5, 0.9))
        carried = {1: max(scene.load.forces_n), 2: 0.5e-3 * 9.81 * scene.pinch.mass_g}
        assert _most_n(scene) >= max(5.0, carried[scene.fingers] / (0.3 * 0.7) - 1e-9)
        assert _most_n(rough) == _most_n(scene)  # the scale does not tell the friction
