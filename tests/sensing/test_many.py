"""Many sensors in step: the same bytes as one alone, and errors that stop no other environment."""

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from chromagrip import Pose, TactileSensor, TactileSensors, UserError, relative_poses, shapes
from chromagrip.model import ContactObject, Motion, Solid, dome_forces, simulate_contact
from chromagrip.render import load_sensor

DESIGN = load_sensor("dome-2020")
COARSE = replace(DESIGN.dome, pitch=0.6e-3)
BALL, RADIUS, FRICTION = 6e-3, 20e-3, 0.6


def places(count: int, frame: int) -> np.ndarray:
    """Places of balls that press the deeper the higher their environment's number is [m]."""
    depth = 0.1e-3 * (1 + np.arange(count)) * frame / 5
    return np.column_stack([np.zeros((count, 2)), RADIUS + BALL - depth])


def pressed(count: int, frames: int = 5, **options: object) -> TactileSensors:
    """Sensors that balls have pressed."""
    sensors = TactileSensor(DESIGN, num_envs=count, body=COARSE, noise=2.0, seed=4, **options)
    sensors.attach(shapes.ball(BALL), friction=FRICTION)
    for frame in range(1, frames + 1):
        sensors.update(places(count, frame), dt=1 / 60)
    return sensors


@pytest.fixture
def three() -> Iterator[TactileSensors]:
    sensors = pressed(3)
    yield sensors
    sensors.close()


def test_an_environment_has_the_bytes_of_a_sensor_alone(three: TactileSensors) -> None:
    alone = TactileSensor(DESIGN, body=COARSE, noise=2.0, seed=6)
    alone.attach(Solid(shape=shapes.ball(BALL), friction=FRICTION))
    for frame in range(1, 6):
        alone.update(Pose(place=tuple(places(3, frame)[2])), dt=1 / 60, placed=frame == 1)
    data = three.data
    names = (
        "image", "marker_px", "marker_visible", "marker_pos", "wrench", "node_pos", "node_force",
        "slipping", "margin", "limit_margin",
    )  # fmt: skip
    for name in names:
        values, own = getattr(data, name), np.asarray(getattr(alone.data, name))
        assert values.shape == (3, *own.shape)
        assert values[2].tobytes() == own.tobytes(), name


def test_threads_and_numbers_of_environments_change_no_byte(three: TactileSensors) -> None:
    other = pressed(2, threads=2)
    assert other.data.image.tobytes() == three.data.image[:2].tobytes()
    assert other.data.wrench.tobytes() == three.data.wrench[:2].tobytes()
    other.close()


def test_a_deeper_press_is_harder_and_balances(three: TactileSensors) -> None:
    force = -three.data.wrench[:, 2]
    assert (np.diff(force) > 0.0).all()
    np.testing.assert_allclose(three.data.node_force.sum(axis=1), three.data.wrench[:, :3])


def test_what_is_no_pose_is_a_flag_and_the_others_go_on(three: TactileSensors) -> None:
    before = three.data.wrench.copy()
    now, turns = places(3, 6), np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    now[0, 2], turns[1] = RADIUS - 2 * BALL, 0.0
    data = three.update(now, turns, dt=1 / 60)
    assert data.failed.tolist() == [True, True, False]
    assert "too deep" in data.reasons[0]
    assert "has length 0" in data.reasons[1]
    np.testing.assert_array_equal(data.wrench[:2], before[:2])
    assert -data.wrench[2, 2] > -before[2, 2]
    again = three.update(places(3, 7), dt=1 / 60)
    assert not again.failed.any()
    assert (-again.wrench[:, 2] > -before[:, 2]).all()


def test_some_begin_again_and_states_are_taken_up(three: TactileSensors) -> None:
    state = three.state()
    ahead = three.update(places(3, 6), dt=1 / 60).wrench.copy()
    three.restore(state)
    assert three.update(places(3, 6), dt=1 / 60).wrench.tobytes() == ahead.tobytes()
    three.reset([0, 2])
    assert np.flatnonzero(three.data.wrench[:, 2] < -1e-3).tolist() == [1]
    assert three.data.time.tolist() == [0.0, pytest.approx(0.1), 0.0]


def test_pictures_come_at_their_rate() -> None:
    sensors = TactileSensor(DESIGN, num_envs=1, body=COARSE, noise=2.0, rate_hz=30.0)
    sensors.attach(shapes.ball(BALL), friction=FRICTION)
    seen = [sensors.data.image.tobytes()]
    for frame in range(1, 7):
        seen.append(sensors.update(places(1, frame), dt=1 / 60).image.tobytes())
    assert [a != b for a, b in itertools.pairwise(seen)] == [False, True] * 3


def test_bad_input_is_one_sentence(three: TactileSensors) -> None:
    with pytest.raises(UserError, match=r"object_pos has shape \(2, 3\), expected \(3, 3\)"):
        three.update(places(2, 1), dt=1 / 60)
    with pytest.raises(UserError, match="must be above 0 s"):
        three.update(places(3, 1), dt=0.0)
    with pytest.raises(UserError, match="whole numbers from 0 to 2"):
        three.reset([3])
    with pytest.raises(UserError, match="2 objects are given for 3 environments"):
        three.attach([shapes.ball(BALL)] * 2)
    with pytest.raises(UserError, match="'mug' is no object"):
        three.attach("mug")  # type: ignore[arg-type]
    with pytest.raises(UserError, match="a quaternion has length 0"):
        relative_poses(np.zeros(3), np.zeros(4), np.zeros(3), [1, 0, 0, 0])
    with pytest.raises(UserError, match=r"object_pos must be finite numbers of shape \(3,\)"):
        relative_poses(np.zeros(3), [1, 0, 0, 0], np.zeros(2), [1, 0, 0, 0])
    three.reset([])  # of none
    assert (three.data.time > 0.0).all()
    with pytest.raises(UserError, match="num_envs = 0"):
        TactileSensor(DESIGN, num_envs=0)
    with pytest.raises(UserError, match="call attach"):
        _ = TactileSensor(DESIGN, num_envs=2, body=COARSE).data


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
        sensors = TactileSensor(DESIGN, num_envs=1, body=COARSE, noise=2.0)
        sensors.attach(shape, friction=FRICTION)
        for shear in (0.0, 0.1e-3):
            at = place + turn.apply([shear, 0.0, 0.0])
            data = sensors.update([at], [turn.as_quat(scalar_first=True)], dt=1 / 60)
        felt.append((data.wrench[0].copy(), data.image.tobytes()))
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


def test_a_chain_is_loaded_by_forces() -> None:
    sensors = TactileSensor("thesis", body="chain", num_envs=2)
    sensors.attach(ContactObject(friction=0.5))
    for _ in range(10):
        data = sensors.update(force=[[0.0, 0.0, -0.5], [0.0, 0.0, -1.0]], dt=1 / 60)
    assert data.wrench[1, 2] < data.wrench[0, 2] < -0.2
    with pytest.raises(UserError, match="object_pos or force, and not both"):
        sensors.update(dt=1 / 60)
    with pytest.raises(UserError, match=r"force has shape \(1, 3\), expected \(2, 3\)"):
        sensors.update(force=[[0.0, 0.0, -1.0]], dt=1 / 60)


def test_poses_in_the_world_become_poses_in_the_sensors_frame() -> None:
    half = np.sqrt(0.5)
    tip, straight = (half, 0.0, half, 0.0), (1.0, 0.0, 0.0, 0.0)  # z of the tip is the world's x
    place, turn = relative_poses((1.0, 0.0, 0.0), tip, (1.5, 0.0, 0.0), straight)
    np.testing.assert_allclose(place, [0.0, 0.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(turn, [half, 0.0, -half, 0.0], atol=1e-12)
    places, turns = relative_poses(np.ones((2, 3)), [tip] * 2, np.ones((2, 3)), [tip] * 2)
    np.testing.assert_allclose(places, np.zeros((2, 3)), atol=1e-12)
    np.testing.assert_allclose(turns, [straight] * 2, atol=1e-12)
