"""Many sensors in step: the same bytes as one alone, and errors that stop no other sensor."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from chromagrip import Pose, TactileSensor, UserError, relative_poses, shapes, stacked, update_all
from chromagrip.model import ContactObject, Solid
from chromagrip.render import load_sensor
from chromagrip.sensing.many import STACKED

DESIGN = load_sensor("dome-2020")
BALL, RADIUS, FRICTION = 6e-3, 20e-3, 0.6


def places(count: int, frame: int) -> np.ndarray:
    """Places of balls that press the deeper the higher their sensor's number is [m]."""
    depth = 0.1e-3 * (1 + np.arange(count)) * frame / 5
    return np.column_stack([np.zeros((count, 2)), RADIUS + BALL - depth])


def opened(*seeds: int) -> list[TactileSensor]:
    """Sensors with a ball above their apex."""
    sensors = [TactileSensor(DESIGN, noise=2.0, seed=seed) for seed in seeds]
    for sensor in sensors:
        sensor.attach(Solid(shape=shapes.ball(BALL), friction=FRICTION))
    return sensors


def test_a_stack_has_the_bytes_of_sensors_alone_in_threads_too() -> None:
    sensors, alone = opened(4, 5), opened(4, 5)
    with ThreadPoolExecutor(2) as pool:
        for frame in (3, 4):
            assert not update_all(sensors, places(2, frame), dt=1 / 60, each=pool.map)
            for sensor, place in zip(alone, places(2, frame), strict=True):
                sensor.update(Pose(place=tuple(place)), dt=1 / 60, placed=frame == 3)
        for name in STACKED:
            expected = np.array([getattr(sensor.data, name) for sensor in alone])
            values = stacked(sensors, name, pool.map)
            assert (values.shape, values.tobytes()) == (expected.shape, expected.tobytes()), name
    assert (np.diff(stacked(sensors, "wrench")[:, 2]) < 0.0).all()  # a deeper press is harder


def test_what_is_no_pose_is_named_by_its_number_and_the_others_go_on() -> None:
    sensors = opened(1, 2, 3)
    assert not update_all(sensors, places(3, 5), dt=1 / 60)
    before = stacked(sensors, "wrench")
    now, turns = places(3, 6), np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    now[0, 2], turns[1] = RADIUS - 2 * BALL, 0.0
    failed = update_all(sensors, now, turns, dt=1 / 60)
    assert failed.keys() == {0, 1}
    assert "too deep" in failed[0]
    assert "must be a quaternion of length 1" in failed[1]
    after = stacked(sensors, "wrench")
    np.testing.assert_array_equal(after[:2], before[:2])
    assert -after[2, 2] > -before[2, 2]


def test_bad_input_is_one_sentence() -> None:
    sensors, chain = opened(1), TactileSensor("thesis", body="chain")
    with pytest.raises(UserError, match=r"sensor 1: data is not available before attach\(\)"):
        update_all([*sensors, chain], places(2, 1), dt=1.0)
    chain.attach(ContactObject())
    at, still = np.zeros(3), [1, 0, 0, 0]
    for call, words in (
        (lambda: update_all(sensors, places(3, 1), dt=1.0), r"shape \(1, 3\), got shape \(3, 3\)"),
        (lambda: update_all(sensors, places(1, 1), dt=0.0), "must be above 0 s"),
        (lambda: stacked(sensors, "picture"), "no values 'picture' can be stacked; allowed are im"),
        (lambda: stacked([*sensors, chain], "node_pos"), r"sensor 1: node_pos has shape \(.*, not"),
        (lambda: relative_poses(at, np.zeros(4), at, still), "a quaternion has length 0"),
    ):
        with pytest.raises(UserError, match=words):
            call()


def test_poses_in_the_world_become_poses_in_the_sensors_frame() -> None:
    half = np.sqrt(0.5)
    tip, straight = (half, 0.0, half, 0.0), (1.0, 0.0, 0.0, 0.0)  # z of the tip is the world's x
    place, turn = relative_poses((1.0, 0.0, 0.0), tip, (1.5, 0.1, 0.2), straight)
    np.testing.assert_allclose(place, [-0.2, 0.1, 0.5], atol=1e-12)
    np.testing.assert_allclose(turn, [half, 0.0, -half, 0.0], atol=1e-12)
    both = relative_poses(np.ones((2, 3)), [tip] * 2, np.ones((2, 3)), [tip] * 2)
    np.testing.assert_allclose(both[0], np.zeros((2, 3)), atol=1e-12)
    np.testing.assert_allclose(both[1], [straight] * 2, atol=1e-12)
