"""A sensor in environments of other people: observations, resets, and what a pose cannot be."""

import pickle
import subprocess
import sys
import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from chromagrip import UserError, scene_names
from chromagrip.gym import TactileObservation, VectorTactileObservation
from chromagrip.model.shapes import ball
from chromagrip.render import load_sensor

RADIUS, BALL = load_sensor("dome-2020").dome.radius, 8e-3


class Pressed(gymnasium.Env[Any, Any]):
    """A ball above the dome that sinks by as much as the action says, and ends after 4 steps."""

    dt = 1 / 60
    observation_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
    action_space = spaces.Box(0.0, 1.0, (1,), np.float32)

    def __init__(self, deepest: float = 0.6e-3) -> None:
        self.deepest = deepest

    def reset(self, *, seed: Any = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.depth, self.steps = -1e-3, 0
        return np.zeros(1, np.float32), {}

    def step(self, action: Any) -> Any:
        self.depth, self.steps = self.deepest * float(action[0]), self.steps + 1
        return np.zeros(1, np.float32), 0.0, False, self.steps == 4, {}


def pose_of(env: Any) -> Any:
    return (0.0, 0.0, RADIUS + BALL - env.unwrapped.depth), (1.0, 0.0, 0.0, 0.0)


def poses_of(envs: Any) -> Any:
    each = [pose_of(env) for env in envs.unwrapped.envs]
    return tuple(np.array(part) for part in zip(*each, strict=True))


@pytest.mark.parametrize("shown", ["image", "markers", "forces"])
def test_gymnasium_finds_nothing_wrong_with_a_wrapped_environment(shown: Any) -> None:
    env = TactileObservation(Pressed(), "dome-2020", ball(BALL), pose_of, shown=shown, friction=0.5)
    # The checker wants an environment without wrappers, and the wrapped one's spaces.
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*is different from the unwrapped")
        check_env(env, skip_render_check=True)


def test_a_deeper_press_is_felt_and_a_reset_lifts_it() -> None:
    env = TactileObservation(Pressed(), "dome-2020", ball(BALL), pose_of, shown="forces")
    first, _ = env.reset(seed=0)
    assert not first["tactile"].any()
    felt = [env.step(np.array([share], np.float32))[0]["tactile"][2] for share in (0.3, 0.6, 1.0)]
    assert 0.0 > felt[0] > felt[1] > felt[2]
    assert env.step(np.array([1.0], np.float32))[0]["tactile"][2] == env.sensor.data.wrench[
        2
    ].astype(np.float32)
    assert not env.reset()[0]["tactile"].any()


def test_a_pose_that_is_too_deep_is_named_and_the_environment_goes_on() -> None:
    env = TactileObservation(Pressed(9e-3), "dome-2020", ball(BALL), pose_of, shown="forces")
    env.reset(seed=0)
    deep = env.step(np.ones(1, np.float32))
    assert "too deep" in deep[4]["tactile_failed"]
    again = env.step(np.array([0.05], np.float32))
    assert "tactile_failed" not in again[4]
    assert again[0]["tactile"][2] < -0.1


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED])
def test_a_vector_is_as_its_environments_alone(mode: AutoresetMode) -> None:
    """Also where one of them begins again."""
    options: dict[str, Any] = {"shown": "forces", "friction": 0.5, "dt": 1 / 60}
    vector = VectorTactileObservation(
        SyncVectorEnv([Pressed, lambda: Pressed(0.3e-3)], autoreset_mode=mode),
        "dome-2020",
        ball(BALL),
        poses_of,
        **options,
    )
    alone = [
        TactileObservation(Pressed(deepest), "dome-2020", ball(BALL), pose_of, **options)
        for deepest in (0.6e-3, 0.3e-3)
    ]
    shown, _ = vector.reset(seed=0)
    expected = [env.reset()[0]["tactile"] for env in alone]
    ended = np.zeros(2, np.bool_)
    for share in (0.2, 0.5, 0.8, 1.0, 0.4, 0.7):
        action = np.full((2, 1), share, np.float32)
        if mode == AutoresetMode.DISABLED and ended.any():
            shown, _ = vector.reset(options={"reset_mask": ended})
            expected = [env.reset()[0]["tactile"] for env in alone]
            np.testing.assert_array_equal(shown["tactile"], expected)
            ended[:] = False
        before = ended
        shown, _, _, ended, _ = vector.step(action)
        if mode == AutoresetMode.NEXT_STEP and before.any():
            expected = [env.reset()[0]["tactile"] for env in alone]
        else:
            expected = [env.step(action[0])[0]["tactile"] for env in alone]
        np.testing.assert_array_equal(shown["tactile"], expected)
        assert vector.observation_space.contains(shown)
    vector.close()


def test_what_cannot_be_wrapped_is_refused() -> None:
    class Timeless(Pressed):
        dt = None  # type: ignore[assignment]

    with pytest.raises(UserError, match="does not tell the time of a step"):
        TactileObservation(Timeless(), "dome-2020", ball(BALL), pose_of)
    with pytest.raises(UserError, match="shown = 'sound'"):
        TactileObservation(Pressed(), "dome-2020", ball(BALL), pose_of, shown="sound")  # type: ignore[arg-type]
    same = SyncVectorEnv([Pressed], autoreset_mode=AutoresetMode.SAME_STEP)
    with pytest.raises(UserError, match="SAME_STEP would lose the last observation"):
        VectorTactileObservation(same, "dome-2020", ball(BALL), poses_of, dt=0.1)
    lost = TactileObservation(Pressed(), "dome-2020", ball(BALL), lambda _: None, shown="forces")
    with pytest.raises(UserError, match="pose_of returned None"):
        lost.reset()
    twice = TactileObservation(Pressed(), "dome-2020", ball(BALL), pose_of, shown="forces")
    with pytest.raises(UserError, match="already has the key 'tactile'"):
        TactileObservation(twice, "dome-2020", ball(BALL), pose_of)


@pytest.mark.parametrize(
    ("order", "name"),
    [
        ("gymnasium, chromagrip", "chromagrip/Grasp-v0"),
        ("chromagrip, gymnasium", "chromagrip.gym:chromagrip/Grasp-v0"),
    ],
)
def test_environments_are_registered_without_heavy_imports(order: str, name: str) -> None:
    first = order.split(", ")[0]
    script = (
        f"import {first}, sys\n"
        f"assert {first!r} == 'gymnasium' or 'gymnasium' not in sys.modules\n"
        f"import {order}\n"
        "assert 'cv2' not in sys.modules and 'numba' not in sys.modules\n"
        f"print(gymnasium.make({name!r}, changes={{'duration_s': 0.1}}).spec.id)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout.strip() == "chromagrip/Grasp-v0", done.stderr


@pytest.mark.parametrize("observation", ["forces", "image"])
def test_an_environment_is_pickled_and_goes_on_with_the_same_bytes(observation: str) -> None:
    changes = {"camera.rest_frames": 2, "duration_s": 0.3, "truth.margin_noise": 0.05}
    env = gymnasium.make("chromagrip/Grasp-v0", observation=observation, changes=changes)
    fresh = pickle.loads(pickle.dumps(env.unwrapped))
    assert fresh.reset(seed=3)[0].tobytes() == env.reset(seed=3)[0].tobytes()
    action = np.array([0.1], np.float32)
    env.step(action)
    other = pickle.loads(pickle.dumps(env.unwrapped))
    for _ in range(3):
        one, same = env.step(action), other.step(action)
        assert one[0].tobytes() == same[0].tobytes()
        assert one[1:] == same[1:]
    assert env.reset()[0].tobytes() == other.reset()[0].tobytes()


@pytest.mark.loops
@pytest.mark.parametrize("scene", scene_names())
@pytest.mark.parametrize("action", ["force", "rate"])
def test_gymnasium_finds_nothing_wrong_with_any_scene(scene: str, action: Any) -> None:
    env = gymnasium.make("chromagrip/Grasp-v0", scene=scene, action=action, observation="forces")
    check_env(env.unwrapped, skip_render_check=True)
