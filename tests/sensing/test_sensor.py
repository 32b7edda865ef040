"""A sensor is moved or loaded, against the model; what each body does is in test_contract.py."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from chromagrip import Pose, TactileSensor, UserError
from chromagrip.model import (
    ContactObject,
    Fingertip,
    Motion,
    Solid,
    contact_forces,
    dome_forces,
    equilibrium,
    simulate_contact,
)
from chromagrip.model.shapes import ball, plane
from chromagrip.render import Defects, load_sensor

DESIGN = load_sensor("dome-2020")
RADIUS = DESIGN.shape.radius
BALL = Solid(shape=ball(10e-3), friction=0.5)
DT = 1.0 / 60.0


@pytest.fixture
def dome() -> Iterator[TactileSensor]:
    sensor = TactileSensor(DESIGN, noise=2.0, seed=3)
    sensor.attach(BALL)
    yield sensor
    sensor.close()


def pressed(depth: float, x: float = 0.0, turn: float = 0.0) -> Pose:
    """Pose of the ball that deep in the dome, shifted along x and turned about z."""
    w, _, _, z = np.roll(Rotation.from_rotvec([0.0, 0.0, turn]).as_quat(), 1)
    return Pose(place=(x, 0.0, RADIUS + 10e-3 - depth), turn=(w, 0.0, 0.0, z))


def press(sensor: TactileSensor, depth: float = 0.5e-3, frames: int = 10) -> None:
    for k in range(1, frames + 1):
        sensor.update(pressed(depth * k / frames), dt=DT)


def test_a_path_gives_the_forces_of_the_model_that_is_told_the_path_beforehand() -> None:
    """Where each step of the sensor is a step of the model, to all digits."""
    sensor = TactileSensor(DESIGN)
    sensor.attach(BALL)
    poses = np.zeros((13, 6))
    poses[:, 2] = -0.08e-3 * np.minimum(np.arange(13), 8)
    poses[:, 0] = 0.05e-3 * np.maximum(np.arange(13) - 8, 0)
    motion = Motion(times=np.arange(13) * DT, poses=poses)
    expected = dome_forces(DESIGN.dome, simulate_contact(DESIGN.dome, BALL, motion, dt=DT).end)
    for x, _, z in poses[1:, :3]:
        sensor.update(pressed(-z, x), dt=DT)
    np.testing.assert_allclose(sensor.data.wrench[:3], expected.wrench[:3], atol=1e-9)
    assert expected.wrench[0] > 0.1


def test_a_torque_is_borne_by_the_skin_and_the_damper_about_the_place_of_the_object(
    dome: TactileSensor,
) -> None:
    """That place is beside the axis by the shear; the damper bears 120 N·s/m · (R/2)² · dφ/dt."""
    for k in range(20):
        before = dome.data.contact.turn
        x, y = dome.update(force=[0.2, -0.1, -2.0, 0.0, 0.0, 2e-4], dt=DT).contact.place
        assert y == pytest.approx(-0.5 * x, rel=0.1) or k > 5  # it moves alike both ways
    np.testing.assert_allclose(dome.data.wrench[:3], [0.2, -0.1, -2.0], atol=0.02)
    contact = dome.data.contact
    skin = contact.field.torque((0.0, 0.0, 1.0), contact.state.place)
    damper = 120.0 * (0.5 * RADIUS) ** 2 * (contact.turn - before) / DT
    assert skin + damper == pytest.approx(2e-4, rel=0.03)
    assert 2e-5 < skin < 1.5e-4


def test_a_turn_beyond_half_a_turn_goes_on() -> None:
    """A rotation vector jumps at π; torque and slip do not."""
    sensor = TactileSensor(DESIGN)
    sensor.attach(BALL)
    press(sensor)
    torques = []
    for k in range(1, 23):
        sensor.update(pressed(0.5e-3, turn=math.radians(9.0 * k)), dt=DT)
        torques.append(sensor.data.wrench[5])
    assert torques[-1] > 0.0  # the skin is taken along
    assert np.ptp(torques[-6:]) < 0.02 * torques[-1]


def test_an_object_that_jumps_elsewhere_has_not_rubbed_on_its_way(dome: TactileSensor) -> None:
    press(dome)
    angle = math.radians(25.0)
    far = (RADIUS + 10e-3 - 0.5e-3) * np.array([math.sin(angle), 0.0, math.cos(angle)])
    dome.update(Pose(place=tuple(far)), dt=DT)
    data = dome.data
    inwards = -far / np.linalg.norm(far)
    assert data.wrench[:3] @ inwards > 0.5
    assert data.margin > 0.8


def test_noise_is_of_the_frame_and_none_is_none(dome: TactileSensor) -> None:
    press(dome, frames=2)
    still = pressed(0.5e-3)
    one = dome.update(still, dt=DT).image.astype(int)
    other = dome.update(still, dt=DT).image.astype(int)
    # A picture of what does not move is not drawn again, and is the same as drawn anew.
    state = dome.data.contact.state
    drawn = TactileSensor(DESIGN, noise=2.0, seed=3).camera.expose(state, 4, state.carried)
    np.testing.assert_array_equal(drawn.image, other)
    assert (one - other).std() == pytest.approx(2.0 * math.sqrt(2.0), rel=0.1)
    clean = TactileSensor(DESIGN)
    clean.attach(BALL)
    first = clean.update(pressed(0.0), dt=DT).image
    np.testing.assert_array_equal(clean.update(pressed(0.0), dt=DT).image, first)


def test_markers_move_with_the_skin(dome: TactileSensor) -> None:
    rest = dome.data
    press(dome)
    moved = dome.data.marker_pos - rest.marker_pos
    beside = np.linalg.norm(rest.marker_pos[0, :, :2], axis=1)
    near, far = moved[0, np.nanargmin(beside), 2], moved[0, np.nanargmax(beside)]
    # None is pressed deeper than the object has come, and what is far away stays.
    assert -0.5e-3 < near < -0.05e-3
    assert np.linalg.norm(far) < 0.1 * abs(near)


def test_the_picture_between_two_frames_hangs_on_no_picture_before() -> None:
    """With a shutter that stays open; a sensor whose frames are drawn, and one that skips some."""
    images = []
    for every in (1, 4):
        sensor = TactileSensor(DESIGN, defects=Defects(motion_blur=0.5), noise=2.0)
        sensor.attach(BALL)
        for k in range(1, 9):
            data = sensor.update(pressed(0.05e-3 * k), dt=DT)
            image = data.image if k % every == 0 else None
        images.append(image)
        sensor.close()
    np.testing.assert_array_equal(*images)


def test_a_chain_under_forces_is_that_of_a_grasp() -> None:
    """A grip and a load that stay: the settled field is the model's equilibrium."""
    tip, obj = Fingertip(nodes=101), ContactObject(friction=0.6)
    sensor = TactileSensor("thesis", body=tip)
    sensor.attach(obj)
    for _ in range(60):
        sensor.update(force=[0.4, 0.0, -2.0], dt=DT)
    np.testing.assert_allclose(sensor.data.wrench[:3], [0.4, 0.0, -2.0], atol=0.01)
    settled = contact_forces(tip, obj, equilibrium(tip, obj, 2.0, 0.4))
    assert sensor.data.contact.field.total_normal == pytest.approx(settled.total_normal, rel=0.01)
    assert sensor.data.margin == pytest.approx(settled.safety_margin(0.6), abs=0.01)


def test_what_is_no_sensor_is_refused() -> None:
    asked: list[tuple[Any, dict[str, Any], str]] = [
        ("flat-2019", {"body": "dome"}, 'its silicone is a pad; body = "dome"'),
        ("dome-2020", {"body": "balloon"}, "allowed are chain, dome, pad"),
        ("dome-2020", {"noise": -1.0}, "must be a finite number of at least 0"),
        (7, {}, "a design is a name, a file or a SensorDesign"),
    ]
    for design, options, words in asked:
        with pytest.raises(UserError, match=words):
            TactileSensor(design, **options)
    with pytest.raises(UserError, match="does not describe a flat pad"):
        TactileSensor("flat-2019", body="chain").attach(ContactObject())


def test_a_plane_lies_where_its_pose_says() -> None:
    """Depth counts from the apex, in the sensor's frame."""
    sensor = TactileSensor(DESIGN)
    sensor.attach(Solid(shape=plane(), friction=0.5))
    sensor.update(Pose(place=(0.0, 0.0, RADIUS + 1e-4)), dt=DT)
    assert not sensor.data.wrench.any()
    sensor.update(Pose(place=(0.0, 0.0, RADIUS - 2e-4)), dt=DT)
    assert sensor.data.wrench[2] < -0.02
