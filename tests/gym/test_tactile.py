"""A sensor in environments of other people: observations, resets, and what a pose cannot be."""

import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from chromagrip import UserError
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


def test_gymnasium_finds_nothing_wrong_with_a_wrapped_environment() -> None:
    env = TactileObservation(Pressed(), "dome-2020", ball(BALL), pose_of, shown="markers")
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
    assert felt[2] == env.sensor.data.wrench[2].astype(np.float32)
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

    def wrapped(env: Any = None, pose: Any = pose_of, **options: Any) -> TactileObservation:
        return TactileObservation(
            env or Pressed(), "dome-2020", ball(BALL), pose, **{"shown": "forces"} | options
        )

    same = SyncVectorEnv([Pressed], autoreset_mode=AutoresetMode.SAME_STEP)
    for call, words in (
        (lambda: wrapped(Timeless()), "does not tell the time of a step"),
        (
            lambda: VectorTactileObservation(same, "dome-2020", ball(BALL), poses_of, dt=0.1),
            "SAME_STEP would lose the last observation",
        ),
        (lambda: wrapped(pose=lambda _: None).reset(), "pose_of returned None"),
        (lambda: wrapped(wrapped()), "already has the key 'tactile'"),
    ):
        with pytest.raises(UserError, match=words):
            call()
