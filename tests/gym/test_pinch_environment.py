"""Two fingers as an environment: what is seen, what ends it, and that a seed decides every byte."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from chromagrip import UserError, load_scene
from chromagrip.gym.environment import DROP_COST, GripEnv
from chromagrip.gym.observations import FORCES, MARGIN, observation_of, space_of

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


def rolled(env: GripEnv, forces: list[float]) -> list[Step]:
    return stepped(env, [action(force, 10.0) for force in forces])


def to_the_end(env: GripEnv, force: float) -> list[Step]:
    env.reset(seed=0)
    steps: list[Step] = []
    while not (steps and (steps[-1][2] or steps[-1][3])):
        steps += rolled(env, [force])
    return steps


@pytest.mark.parametrize(
    "observation",
    [
        pytest.param("forces", marks=pytest.mark.loops),  # also in test_environment.py
        "margin",
        "image",
        pytest.param("markers", marks=pytest.mark.loops),
    ],
)
def test_gymnasium_finds_nothing_wrong(observation: str) -> None:
    """Warnings are errors here."""
    check_env(made({"duration_s": 0.1}, observation=observation), skip_render_check=True)


def test_both_fingers_carry_half_the_weight() -> None:
    env = made(observation="forces")
    steps = to_the_end(env, 1.5)
    assert [step[2] for step in steps] == [False] * len(steps)
    shown = {name: steps[-1][0][:, k] for k, name in enumerate(FORCES)}
    assert steps[-1][0].shape == env.observation_space.shape == (2, len(FORCES))
    assert shown["friction_n"].sum() == pytest.approx(WEIGHT, rel=0.03)
    assert shown["force_x_n"] == pytest.approx([WEIGHT / 2] * 2, rel=0.03)
    assert shown["normal_n"] == pytest.approx([1.5] * 2, rel=0.03)
    assert shown["grip_n"] == pytest.approx([1.5] * 2)
    assert shown["known"].tolist() == [1.0, 1.0]
    rest = steps[0][0]
    assert np.abs(rest[:, list(FORCES).index("friction_n")]).max() < 0.2 * WEIGHT


def test_each_fingers_margin_has_its_own_noise() -> None:
    env = made({"truth.margin_noise": 0.02, "camera.latency_frames": 0})
    env.reset(seed=2)
    for shown, *_ in (rolled(env, [1.5])[0] for _ in range(12)):
        observed = [reading.observation for reading in env._rig.readings]
        limits = [each.limit_margin for each in observed if each is not None]
        assert shown.shape == env.observation_space.shape == (2, len(MARGIN))
        if np.isfinite(limits).all():  # of force and torsion together, as the scene says
            assert shown[:, 0].tolist() == np.float32(limits).tolist()
    assert np.isfinite(limits).all()
    assert shown[0, 0] != shown[1, 0]


def test_each_finger_shows_its_own_picture() -> None:
    env = made({"camera.latency_frames": 0}, observation="image", render_mode="rgb_array")
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
    assert made().render() is None
    env.close()


@pytest.mark.loops
def test_the_markers_of_both_skins_move_where_they_are_pressed() -> None:
    env = made({"camera.latency_frames": 0}, observation="markers")
    still, _ = env.reset(seed=0)
    pressed = rolled(env, [4.0] * 4)[-1][0]
    assert still.shape == pressed.shape == env.observation_space.shape
    assert still.shape[0] == 2
    for k in range(2):
        assert np.abs(still[k].reshape(-1, 3)[:, :2]).max() < 0.5
        assert np.abs(pressed[k].reshape(-1, 3)[:, :2]).max() > 1.0
    env.close()


def test_two_fingers_whose_arrays_differ_are_refused() -> None:
    scene = load_scene("pinch-lift")
    one, other = observation_of("margin", scene, None), observation_of("forces", scene, None)
    with pytest.raises(UserError, match="cannot be stacked"):
        space_of([one, other])


def test_no_grip_drops_the_object() -> None:
    steps = to_the_end(made(), 0.0)
    assert [step[1] for step in steps[:-1]] == [0.0] * (len(steps) - 1)
    _, reward, terminated, truncated, info = steps[-1]
    assert (reward, terminated, truncated) == (-DROP_COST, True, False)
    assert (info["dropped"], info["outcome"]) == (True, "dropped")
    assert info["time_s"] > 0.2


def test_holding_gently_pays_best() -> None:
    env = made()
    returns = {}
    for force in (0.3, 1.5, 5.0):
        steps = to_the_end(env, force)
        returns[force] = sum(step[1] for step in steps)
        assert steps[-1][4]["dropped"] == steps[-1][2] == (force == 0.3)
        assert steps[-1][3] == (force != 0.3)
    assert returns[1.5] > returns[5.0] > 0.0 > returns[0.3]
    held = steps[-1]
    assert held[1] == pytest.approx(1.0 - 5.0 / 10.0, abs=0.01)


@pytest.mark.parametrize(
    ("changes", "force", "outcome"),
    [
        ({"pinch.centre_mm": [0.0, 6.0, 0.0], "pinch.turned_deg": 10.0}, 1.0, "turned"),
        ({"pinch.crushed_kpa": 40.0}, 3.0, "crushed"),
    ],
)
def test_what_is_turned_or_crushed_has_failed(
    changes: dict[str, Any], force: float, outcome: str
) -> None:
    _, reward, terminated, _, info = to_the_end(made(changes), force)[-1]
    assert (reward, terminated) == (-DROP_COST, True)
    assert (info["outcome"], info["dropped"]) == (outcome, False)


@pytest.mark.parametrize("observation", ["forces", "image"])
def test_a_restored_environment_goes_on_with_the_same_bytes(observation: str) -> None:
    env = made(NOISY | {"camera.latency_frames": 2}, observation=observation)
    env.reset(seed=1)
    rolled(env, [1.0, 2.0, 1.5])
    state = env.save()
    forces = [1.2, 1.8, 1.0] + [1.5] * (9 if observation == "forces" else 0)
    straight = rolled(env, forces)
    rolled(env, [3.0, 0.2])
    env.restore(state)
    assert same(straight, rolled(env, forces))
    env.reset(seed=1)
    rolled(env, [1.0, 2.0, 1.5])
    assert same(straight, rolled(env, forces))
    env.reset(seed=2)
    rolled(env, [1.0, 2.0, 1.5])
    assert not same(straight, rolled(env, forces))
    with pytest.raises(UserError, match="another number of fingers"):
        gymnasium.make("chromagrip/Grasp-v0").unwrapped.restore(state)  # type: ignore[attr-defined]
    env.close()


def test_a_limit_of_one_finger_is_refused() -> None:
    with pytest.raises(UserError, match=r"change pinch\.dropped_mm"):
        made(dropped_mm=2.0)
