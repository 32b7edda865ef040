"""Two fingers as an environment: what is seen, what ends it, and that a seed decides every byte."""

import pickle
from functools import cache
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from chromagrip import UserError
from chromagrip.gym.environment import DROP_COST, GripEnv
from chromagrip.gym.observations import FORCES, MARGIN

from .test_environment import Step, action, same
from .test_environment import rolled as stepped

NAME = "chromagrip/Pinch-v0"
WEIGHT = 0.05 * 9.81
#: A light box and coarse domes, which are lifted at once.
COARSE = {
    "sensor": "thesis",
    "dome.pitch_mm": 0.8,
    "duration_s": 0.8,
    "camera.rest_frames": 2,
    "pinch.mass_g": 50.0,
    "pinch.hand_times_s": [0.0, 0.2, 0.6],
    "object.size_mm": [20.0, 20.0, 16.0],
}
NOISY = {"truth.margin_noise": 0.02, "camera.dropped": 0.2, "camera.late": 0.2}


def made(changes: dict[str, Any] | None = None, **options: Any) -> GripEnv:
    env = gymnasium.make(NAME, changes=COARSE | (changes or {}), **options).unwrapped
    assert isinstance(env, GripEnv)
    return env


def test_the_largest_grip_holds_half_the_weight_with_a_margin() -> None:
    """1.2·(m·g/2)/(µ·(1 − Γ)) with µ = 0.3 and Γ = 0.3, and at least 5 N."""
    heavy = made({"pinch.mass_g": 800.0}, most_n=None)
    assert heavy.most_n == pytest.approx(1.2 * 0.4 * 9.81 / (0.3 * 0.7))
    assert made(most_n=None).most_n == 5.0


def rolled(env: GripEnv, forces: list[float]) -> list[Step]:
    return stepped(env, [action(force, 10.0) for force in forces])


@cache
def to_the_end(force: float, **changes: Any) -> list[Step]:
    """Steps under a constant grip, until the grasp ends."""
    env = made({f"pinch.{key}": value for key, value in changes.items()}, observation="forces")
    env.reset(seed=0)
    steps: list[Step] = []
    while not (steps and (steps[-1][2] or steps[-1][3])):
        steps += rolled(env, [force])
    return steps


def test_gymnasium_finds_nothing_wrong() -> None:
    check_env(made({"duration_s": 0.05}), skip_render_check=True)


def test_both_fingers_carry_half_the_weight() -> None:
    steps = to_the_end(1.5)
    assert not any(step[2] for step in steps)
    shown = {name: steps[-1][0][:, k] for k, name in enumerate(FORCES)}
    assert steps[-1][0].shape == (2, len(FORCES))
    assert shown["friction_n"].sum() == pytest.approx(WEIGHT, rel=0.03)
    assert shown["force_x_n"] == pytest.approx([WEIGHT / 2] * 2, rel=0.03)
    assert shown["normal_n"] == pytest.approx([1.5] * 2, rel=0.03)
    assert shown["grip_n"] == pytest.approx([1.5] * 2)
    assert shown["known"].tolist() == [1.0, 1.0]
    rest = steps[0][0]
    assert np.abs(rest[:, list(FORCES).index("friction_n")]).max() < 0.2 * WEIGHT


def test_each_finger_shows_its_own_margin_of_force_and_torsion_together() -> None:
    env = made({"truth.margin_noise": 0.02, "camera.latency_frames": 0})
    env.reset(seed=2)
    shown = rolled(env, [1.5] * 8)[-1][0]
    limits = [each.observation.limit_margin for each in env._rig.readings if each.observation]
    assert shown.shape == env.observation_space.shape == (2, len(MARGIN))
    assert shown[:, 0].tolist() == np.float32(limits).tolist()
    assert shown[0, 0] != shown[1, 0]


def test_each_finger_shows_its_own_picture() -> None:
    options = {"observation": "image", "render_mode": "rgb_array"}
    env = made({"camera.latency_frames": 0}, **options)
    first, _ = env.reset(seed=0)
    ((pressed, *_),) = rolled(env, [3.0])[-1:]
    view = env._rig.scene.build_sensor().view
    assert first.shape == (2, view.height, view.width, 3) == env.observation_space.shape
    for k, frame in enumerate(env._rig.pictures()):
        np.testing.assert_array_equal(pressed[k], frame.image)
    assert (pressed[0] != pressed[1]).any()
    drawn = env.render()
    assert drawn.shape == (480, 640, 3)
    assert len(np.unique(drawn.reshape(-1, 3), axis=0)) > 20
    env.close()


def test_holding_gently_pays_best_and_what_is_lost_ends_it() -> None:
    returns = {force: sum(step[1] for step in to_the_end(force)) for force in (0.0, 1.5, 5.0)}
    assert returns[1.5] > returns[5.0] > 0.0 > returns[0.0] == -DROP_COST
    for force in (1.5, 5.0):
        _, reward, terminated, truncated, info = to_the_end(force)[-1]
        assert (terminated, truncated, info["dropped"]) == (False, True, False)
    assert reward == pytest.approx(1.0 - 5.0 / 10.0, abs=0.01)
    off_centre = (("centre_mm", (0.0, 6.0, 0.0)), ("turned_deg", 10.0))
    for force, outcome, changes in (
        (0.0, "dropped", ()),
        (1.0, "turned", off_centre),
        (3.0, "crushed", (("crushed_kpa", 40.0),)),
    ):
        _, reward, terminated, truncated, info = to_the_end(force, **dict(changes))[-1]
        assert (reward, terminated, truncated) == (-DROP_COST, True, False)
        assert (info["outcome"], info["dropped"]) == (outcome, outcome == "dropped")
        assert info["time_s"] > 0.2 or outcome == "crushed"


@pytest.mark.parametrize(
    ("name", "observation"), [("chromagrip/Grasp-v0", "image"), (NAME, "forces")]
)
def test_a_restored_environment_goes_on_with_the_same_bytes(name: str, observation: str) -> None:
    """So does one that was pickled, and one that is reset with the seed."""
    changes = NOISY | {"camera.rest_frames": 2, "camera.latency_frames": 2, "duration_s": 0.3}
    changes |= COARSE if name == NAME else {}
    env: Any = gymnasium.make(name, observation=observation, changes=changes).unwrapped
    first, then = [[action(f, 8.0) for f in fs] for fs in ((1.0, 2.0, 1.5), (1.2, 1.8, 1.0, 1.5))]
    env.reset(seed=1)
    stepped(env, first)
    state, other = env.save(), pickle.loads(pickle.dumps(env))
    straight = stepped(env, then)
    assert same(straight, stepped(other, then))
    stepped(env, first)
    env.restore(state)
    assert same(straight, stepped(env, then))
    again, _ = env.reset()
    env.restore(state)
    assert (env.reset()[0] == again).all()  # the next seed is drawn as it would have been
    for seed in (1, 2):
        env.reset(seed=seed)
        stepped(env, first)
        assert same(straight, stepped(env, then)) == (seed == 1)
    fewer: Any = gymnasium.make("chromagrip/Grasp-v0").unwrapped
    if name == NAME:
        with pytest.raises(UserError, match="another number of fingers"):
            fewer.restore(state)
    env.close()
