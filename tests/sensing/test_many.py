"""Many sensors in step: the same bytes as one alone, and errors that stop no other sensor."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from chromagrip import Pose, TactileSensor, UserError, relative_poses, shapes, stacked, update_all
from chromagrip.model import ContactObject, Motion, Solid, dome_forces, simulate_contact
from chromagrip.render import load_sensor
from chromagrip.sensing.many import STACKED

DESIGN = load_sensor("dome-2020")
COARSE = replace(DESIGN.dome, pitch=0.6e-3)
BALL, RADIUS, FRICTION = 6e-3, 20e-3, 0.6


def places(count: int, frame: int) -> np.ndarray:
    """Places of balls that press the deeper the higher their sensor's number is [m]."""
    depth = 0.1e-3 * (1 + np.arange(count)) * frame / 5
    return np.column_stack([np.zeros((count, 2)), RADIUS + BALL - depth])


def opened(*seeds: int) -> list[TactileSensor]:
    """Sensors with a ball above their apex."""
    sensors = [TactileSensor(DESIGN, body=COARSE, noise=2.0, seed=seed) for seed in seeds]
    for sensor in sensors:
        sensor.attach(Solid(shape=shapes.ball(BALL), friction=FRICTION))
    return sensors


def test_a_stack_has_the_bytes_of_sensors_alone_in_threads_too() -> None:
    sensors, in_threads, alone = opened(4, 5, 6), opened(4, 5, 6), opened(4, 5, 6)
    with ThreadPoolExecutor(2) as pool:
        for frame in range(1, 6):
            assert not update_all(sensors, places(3, frame), dt=1 / 60)
            assert not update_all(in_threads, places(3, frame), dt=1 / 60, each=pool.map)
            for sensor, place in zip(alone, places(3, frame), strict=True):
                sensor.update(Pose(place=tuple(place)), dt=1 / 60, placed=frame == 1)
        for name in STACKED:
            expected = np.array([getattr(sensor.data, name) for sensor in alone])
            values = stacked(sensors, name)
            assert (values.shape, values.tobytes()) == (expected.shape, expected.tobytes()), name
            assert stacked(in_threads, name, pool.map).tobytes() == expected.tobytes(), name
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
    assert not update_all(sensors, places(3, 7), dt=1 / 60)
    assert (-stacked(sensors, "wrench")[:, 2] > -before[:, 2]).all()


def test_bad_input_is_one_sentence() -> None:
    sensors = opened(1, 2)
    with pytest.raises(UserError, match=r"must be .* shape \(2, 3\), got shape \(3, 3\)"):
        update_all(sensors, places(3, 1), dt=1 / 60)
    with pytest.raises(UserError, match="must be above 0 s"):
        update_all(sensors, places(2, 1), dt=0.0)
    with pytest.raises(UserError, match="no values 'picture' can be stacked; allowed are image"):
        stacked(sensors, "picture")
    empty = TactileSensor(DESIGN, body=COARSE)
    with pytest.raises(UserError, match=r"sensor 2: data is not available before attach\(\)"):
        update_all([*sensors, empty], places(3, 1), dt=1 / 60)
    with pytest.raises(UserError, match="sensor 2: data is not available"):
        stacked([*sensors, empty], "image")
    finer = TactileSensor(DESIGN, body=replace(DESIGN.dome, pitch=0.7e-3))
    finer.attach(Solid(shape=shapes.ball(BALL)))
    with pytest.raises(UserError, match=r"sensor 1: node_pos has shape \(.*\), not \("):
        stacked([sensors[0], finer], "node_pos")
    with pytest.raises(UserError, match="a quaternion has length 0"):
        relative_poses(np.zeros(3), np.zeros(4), np.zeros(3), [1, 0, 0, 0])
    with pytest.raises(UserError, match=r"object_pos must be numbers of shape \(3,\) or \(B, 3\)"):
        relative_poses(np.zeros(3), [1, 0, 0, 0], np.zeros(2), [1, 0, 0, 0])


def test_chains_are_pressed_by_poses() -> None:
    chains = [TactileSensor("thesis", body="chain", seed=k) for k in range(2)]
    for chain in chains:
        chain.attach(ContactObject(friction=0.5))
    for step in range(1, 4):
        shifts = [[0.0, 0.0, -1e-4 * step], [0.0, 0.0, -2e-4 * step]]
        assert not update_all(chains, shifts, dt=1 / 60)
    force = stacked(chains, "wrench")[:, 2]
    assert force[1] < force[0] < 0.0


def test_a_box_of_a_file_with_its_origin_in_a_corner_is_the_same_box() -> None:
    """Turned by 170° about y, it presses the dome with a face that leans by 10°.

    Its distances are those of a grid: forces are the primitive's within 0.3 %.
    """
    trimesh = pytest.importorskip("trimesh")
    edges = np.array([40e-3, 30e-3, 20e-3])
    mesh = trimesh.creation.box(edges)
    mesh.apply_translation(0.5 * edges)  # its origin is a corner
    turn = Rotation.from_euler("y", 170.0, degrees=True)
    outwards = turn.apply([0.0, 0.0, 1.0])  # of the face that presses, towards the dome
    middle = -outwards * (RADIUS + 0.5 * edges[2] - 0.5e-3)
    corner = middle - turn.apply(0.5 * edges)
    felt = []
    for shape, place in (
        (shapes.mesh(mesh), corner),
        (shapes.mesh(mesh, centred=True), middle),
        (shapes.box(tuple(edges)), middle),
    ):
        sensor = TactileSensor(DESIGN, body=COARSE, noise=2.0)
        sensor.attach(Solid(shape=shape, friction=FRICTION))
        for shear in (0.0, 0.1e-3):
            at = place + turn.apply([shear, 0.0, 0.0])
            assert not update_all([sensor], [at], [turn.as_quat(scalar_first=True)], dt=1 / 60)
        felt.append((sensor.data.wrench, sensor.data.image.tobytes()))
    (of_mesh, picture), (centred, same), (of_box, _) = felt
    assert of_box[2] < -0.3
    np.testing.assert_allclose(of_mesh, centred, atol=1e-6)
    assert picture == same
    np.testing.assert_allclose(of_mesh[:3], of_box[:3], rtol=3e-3, atol=1e-3)


def test_poses_through_the_door_are_the_motion_of_a_simulation() -> None:
    """The same steps give the same forces."""
    solid = Solid(shape=shapes.ball(BALL), friction=FRICTION)
    down, side = 0.08e-3, 0.05e-3  # each step is a step of the sensor
    poses = np.zeros((13, 6))
    poses[:, 2] = -down * np.minimum(np.arange(13), 8)
    poses[:, 0] = side * np.maximum(np.arange(13) - 8, 0)
    motion = Motion(times=np.arange(13) / 60, poses=poses)
    run = simulate_contact(COARSE, solid, motion, dt=1 / 60)
    expected = dome_forces(COARSE, run.end).wrench
    sensor = TactileSensor(DESIGN, body=COARSE)
    sensor.attach(solid)
    start = RADIUS + BALL
    for x, _, z in poses[1:, :3]:
        sensor.update(Pose(place=(x, 0.0, start + z)), dt=1 / 60)
    np.testing.assert_allclose(sensor.data.wrench[:3], expected[:3], atol=1e-9)
    assert abs(expected[0]) > 0.1


def test_poses_in_the_world_become_poses_in_the_sensors_frame() -> None:
    half = np.sqrt(0.5)
    tip, straight = (half, 0.0, half, 0.0), (1.0, 0.0, 0.0, 0.0)  # z of the tip is the world's x
    place, turn = relative_poses((1.0, 0.0, 0.0), tip, (1.5, 0.0, 0.0), straight)
    np.testing.assert_allclose(place, [0.0, 0.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(turn, [half, 0.0, -half, 0.0], atol=1e-12)
    places, turns = relative_poses(np.ones((2, 3)), [tip] * 2, np.ones((2, 3)), [tip] * 2)
    np.testing.assert_allclose(places, np.zeros((2, 3)), atol=1e-12)
    np.testing.assert_allclose(turns, [straight] * 2, atol=1e-12)
