"""A sensor is moved or loaded; its truth obeys statics, and its pictures are those of a rig."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import chromagrip
from chromagrip import Pose, TactileSensor, UserError, load_scene
from chromagrip.loop.rig import Rig
from chromagrip.model import (
    ContactObject,
    Dome,
    Fingertip,
    Motion,
    Solid,
    simulate_contact,
)
from chromagrip.model.shapes import ball, plane
from chromagrip.render import Defects, load_sensor

DESIGN = load_sensor("dome-2020")
COARSE = replace(DESIGN.dome, pitch=0.6e-3)
RADIUS = COARSE.radius
BALL = Solid(shape=ball(10e-3), friction=0.5)
DT = 1.0 / 60.0


@pytest.fixture
def dome() -> Iterator[TactileSensor]:
    sensor = TactileSensor(DESIGN, body=COARSE, noise=2.0, seed=3)
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


def test_it_is_found_where_it_was_promised() -> None:
    assert {"TactileSensor", "Reader", "Pose"} <= set(chromagrip.__all__)


def test_the_wrench_is_the_sum_of_the_nodes_and_mirrors_the_press(dome: TactileSensor) -> None:
    press(dome)
    data = dome.data
    force = data.node_force.sum(axis=0)
    np.testing.assert_allclose(data.wrench[:3], force, atol=1e-12)
    torque = np.cross(data.node_pos, data.node_force).sum(axis=0)
    np.testing.assert_allclose(data.wrench[3:], torque, atol=1e-15)
    assert force[2] < -0.5
    assert abs(force[:2]).max() < 0.01 * abs(force[2])
    assert data.margin > 0.9


def test_a_path_gives_the_forces_of_the_model_that_is_told_the_path_beforehand() -> None:
    """The same motion, all of it known in advance, in the model's own simulation."""
    sensor = TactileSensor(DESIGN, body=COARSE)
    sensor.attach(BALL)
    press(sensor, 0.6e-3, 12)
    for k in range(1, 13):
        sensor.update(pressed(0.6e-3, x=0.3e-3 * k / 12), dt=DT)
    times = np.array([0.0, 12 * DT, 24 * DT])
    poses = np.zeros((3, 6))
    poses[1:, 2], poses[2, 0] = -0.6e-3, 0.3e-3
    run = simulate_contact(COARSE, BALL, Motion(times=times, poses=poses), dt=DT / 2)
    np.testing.assert_allclose(
        sensor.data.wrench[:3], run.total_forces[-1], atol=0.02 * abs(run.total_forces[-1]).max()
    )
    assert sensor.data.wrench[0] > 0.2


@pytest.mark.loops
def test_under_forces_it_comes_to_rest_with_them(dome: TactileSensor) -> None:
    for _ in range(60):
        dome.update(force=[0.2, -0.1, -2.0, 0.0, 0.0, 2e-4], dt=0.1)
    np.testing.assert_allclose(dome.data.wrench[:3], [0.2, -0.1, -2.0], atol=0.02)
    # The torque about the axis is about the object's place, which is beside it by the shear.
    field, place = dome.data.contact.field, dome.data.contact.state.place
    assert field.torque((0.0, 0.0, 1.0), place) == pytest.approx(2e-4, rel=0.1)
    total = dome.data.contact.field.total_friction
    assert dome.data.margin == pytest.approx(1.0 - total / (0.5 * 2.0), abs=0.03)


def test_a_turn_beyond_half_a_turn_goes_on() -> None:
    """A rotation vector jumps at π; torque and slip do not."""
    sensor = TactileSensor(DESIGN, body=COARSE)
    sensor.attach(BALL)
    press(sensor)
    torques = []
    for k in range(1, 66):
        sensor.update(pressed(0.5e-3, turn=math.radians(3.0 * k)), dt=DT)
        torques.append(sensor.data.wrench[5])
    assert torques[-1] > 0.0  # the skin is taken along
    assert np.ptp(torques[-15:]) < 0.02 * torques[-1]


def test_an_object_that_jumps_elsewhere_has_not_rubbed_on_its_way(dome: TactileSensor) -> None:
    press(dome)
    angle = math.radians(25.0)
    far = (RADIUS + 10e-3 - 0.5e-3) * np.array([math.sin(angle), 0.0, math.cos(angle)])
    dome.update(Pose(place=tuple(far)), dt=DT)
    data = dome.data
    inwards = -far / np.linalg.norm(far)
    assert data.wrench[:3] @ inwards > 0.5
    assert data.margin > 0.8


def test_rest_frames_are_of_the_untouched_sensor_at_any_time(dome: TactileSensor) -> None:
    before = dome.rest_frames(1)[0].image
    fresh = TactileSensor(DESIGN, body=COARSE, noise=2.0, seed=3)
    np.testing.assert_array_equal(fresh.rest_frames(1)[0].image, before)
    press(dome)
    np.testing.assert_array_equal(dome.rest_frames(1)[0].image, before)


def test_a_state_goes_on_with_the_same_bytes(dome: TactileSensor) -> None:
    press(dome)
    kept = dome.state()

    def on() -> tuple[bytes, bytes]:
        dome.update(pressed(0.5e-3, x=0.1e-3), dt=DT)
        return dome.data.image.tobytes(), dome.data.wrench.tobytes()

    first = on()
    press(dome, 0.2e-3)
    dome.restore(kept)
    assert on() == first


def test_noise_is_of_seed_and_frame_and_none_is_none(dome: TactileSensor) -> None:
    press(dome, frames=2)
    still = pressed(0.5e-3)
    one = dome.update(still, dt=DT).image.astype(int)
    other = dome.update(still, dt=DT).image.astype(int)
    assert (one - other).std() == pytest.approx(2.0 * math.sqrt(2.0), rel=0.1)
    clean = TactileSensor(DESIGN, body=COARSE)
    clean.attach(BALL)
    press(clean, frames=2)
    first = clean.update(still, dt=DT).image
    np.testing.assert_array_equal(clean.update(still, dt=DT).image, first)


def test_markers_move_with_the_skin_and_lie_in_the_picture(dome: TactileSensor) -> None:
    rest = dome.data
    press(dome)
    moved = dome.data.marker_pos - rest.marker_pos
    beside = np.linalg.norm(rest.marker_pos[0, :, :2], axis=1)
    near, far = moved[0, np.nanargmin(beside), 2], moved[0, np.nanargmax(beside)]
    # None is pressed deeper than the object has come, and what is far away stays.
    assert -0.5e-3 < near < -0.05e-3
    assert np.linalg.norm(far) < 0.1 * abs(near)
    height, width = dome.data.image.shape[:2]
    seen = dome.data.marker_px[dome.data.marker_visible]
    assert (seen > -1.0).all()
    assert (seen < [width, height]).all()


def test_the_picture_between_two_frames_hangs_on_no_picture_before() -> None:
    """With a shutter that stays open; a sensor whose frames are drawn, and one that skips some."""
    images = []
    for every in (1, 4):
        sensor = TactileSensor(DESIGN, body=COARSE, defects=Defects(motion_blur=0.5), noise=2.0)
        sensor.attach(BALL)
        for k in range(1, 9):
            data = sensor.update(pressed(0.05e-3 * k), dt=DT)
            image = data.image if k % every == 0 else None
        images.append(image)
        sensor.close()
    np.testing.assert_array_equal(*images)


def test_a_chain_under_forces_is_that_of_a_grasp() -> None:
    """A grip and a load that stay: the settled field is the model's equilibrium."""
    from chromagrip.model import contact_forces, equilibrium

    tip, obj = Fingertip(nodes=101), ContactObject(friction=0.6)
    sensor = TactileSensor("thesis", body=tip)
    sensor.attach(obj)
    for _ in range(120):
        sensor.update(force=[0.4, 0.0, -2.0], dt=DT)
    np.testing.assert_allclose(sensor.data.wrench[:3], [0.4, 0.0, -2.0], atol=0.01)
    settled = contact_forces(tip, obj, equilibrium(tip, obj, 2.0, 0.4))
    assert sensor.data.contact.field.total_normal == pytest.approx(settled.total_normal, rel=0.01)
    assert sensor.data.margin == pytest.approx(settled.safety_margin(0.6), abs=0.01)
    assert math.isnan(sensor.data.limit_margin)


def test_a_chain_in_a_pose_is_that_of_the_force_that_holds_it() -> None:
    tip, obj = Fingertip(nodes=101), ContactObject(friction=0.6)
    sensor = TactileSensor("thesis", body=tip)
    sensor.attach(obj)
    for k in range(1, 31):
        depth, shear = 0.8e-3 * min(k / 15, 1.0), 0.2e-3 * max(k / 15 - 1.0, 0.0)
        sensor.update(Pose(place=(shear, 0.0, tip.radius - depth)), dt=DT)
    for _ in range(60):
        sensor.update(Pose(place=(shear, 0.0, tip.radius - depth)), dt=DT)
    held = sensor.data.wrench
    other = TactileSensor("thesis", body=tip)
    other.attach(obj)
    for _ in range(180):
        other.update(force=held[:3], dt=DT)
    assert other.data.contact.indentation == pytest.approx(0.8e-3, rel=0.02)
    assert other.data.contact.place[0] == pytest.approx(0.2e-3, rel=0.1)


def test_millimetres_are_not_taken_for_metres() -> None:
    with pytest.raises(UserError, match="is 15 m away, allowed is 1 m: are these"):
        Pose(place=(0.0, 0.0, 15.0))


def test_a_pad_is_a_body_too() -> None:
    sensor = TactileSensor("flat-2019", body="pad")
    assert sensor.body.name == "pad"
    sensor.attach(Solid(shape=ball(5e-3), friction=0.5))
    for _ in range(10):
        top = float(sensor.data.contact.state.place[2]) - 30e-6
        sensor.update(Pose(place=(0.0, 0.0, top)), dt=DT)
    assert sensor.data.wrench[2] < -0.05
    assert sensor.data.image.shape[2] == 3
    sensor.close()


def test_the_pictures_of_a_rig_are_those_of_its_sensors() -> None:
    scene = load_scene("margin-60hz", {"duration_s": 0.2})
    rig = Rig(scene)
    rig.reset()
    for _ in range(3):
        rig.step(1.5)
    sensor = TactileSensor.of_scene(scene)
    contact = rig.truth
    sensor.show(contact, contact, rig.index)
    moved = rig.sensors[0].data.image
    np.testing.assert_array_equal(sensor.data.image, moved)
    rig.close()
    sensor.close()


@pytest.mark.parametrize(
    ("design", "body", "obj", "sentence"),
    [
        ("thesis", "chain", BALL, "a chain touches a ContactObject"),
        ("dome-2020", "dome", ContactObject(), "a dome of silicone touches a Solid"),
        ("flat-2019", "chain", ContactObject(), "does not describe a flat pad"),
    ],
)
def test_what_a_body_cannot_touch_is_one_sentence(
    design: str, body: str, obj: object, sentence: str
) -> None:
    sensor = TactileSensor(design, body=body)  # type: ignore[arg-type]
    assert not isinstance(obj, sensor.ability.objects) or design == "flat-2019"
    with pytest.raises(UserError, match=sentence):
        sensor.attach(obj)  # type: ignore[arg-type]


def test_what_a_body_cannot_do_is_one_sentence_and_leaves_it_as_it_is(dome: TactileSensor) -> None:
    press(dome)
    before = dome.state()
    for words, sentence in (
        ({"pose": Pose(place=(0.0, 0.0, 0.0)), "dt": DT}, "too deep"),
        ({"pose": pressed(0.1e-3), "dt": 0.0}, "must be above 0 s"),
        ({"pose": pressed(0.1e-3), "force": [0, 0, 1], "dt": DT}, "not both"),
        ({"dt": DT}, "a pose or a force"),
        ({"force": [0.0, 0.0, -1.0, 1e-3, 0.0, 0.0], "dt": DT}, "torques about x and y"),
        ({"force": [math.nan, 0.0, 0.0], "dt": DT}, "finite"),
        ({"force": [0.0, 0.0, -1e6], "dt": DT}, "needs less force"),
        ({"force": "much", "dt": DT}, "3 or 6 finite numbers"),
        ({"pose": (0.0, 0.0, 0.0), "dt": DT}, "needs a Pose"),
    ):
        with pytest.raises(UserError, match=sentence):
            dome.update(**words)  # type: ignore[arg-type]
        assert dome.state() is before
    chain = TactileSensor("thesis", body="chain")
    chain.attach(ContactObject())
    with pytest.raises(UserError, match="moves along x and z alone"):
        chain.update(Pose(place=(0.0, 1e-3, 10e-3)), dt=DT)
    with pytest.raises(UserError, match="loaded along x and z alone"):
        chain.update(force=[0.0, 1.0, -1.0], dt=DT)
    with pytest.raises(UserError, match="whole fingertip flat"):
        chain.update(force=[0.0, 0.0, -1e6], dt=DT)
    assert chain.ability.moves == ("x", "z")


def test_what_is_no_sensor_is_refused() -> None:
    with pytest.raises(UserError, match='its silicone is a pad; body = "dome"'):
        TactileSensor("flat-2019", body="dome")
    with pytest.raises(UserError, match="allowed are chain, dome, pad"):
        TactileSensor("dome-2020", body="balloon")  # type: ignore[arg-type]
    with pytest.raises(UserError, match="must be a finite number of at least 0"):
        TactileSensor("dome-2020", noise=-1.0)
    with pytest.raises(UserError, match="length 1"):
        Pose(place=(0.0, 0.0, 0.0), turn=(1.0, 1.0, 0.0, 0.0))
    sensor = TactileSensor("dome-2020")
    asked = (lambda: sensor.update(pressed(0.0), dt=DT), sensor.reset, sensor.state)
    for ask in (*asked, lambda: sensor.data):
        with pytest.raises(UserError, match="attach"):
            ask()


def test_a_plane_lies_where_its_pose_says() -> None:
    """Depth counts from the apex, in the sensor's frame."""
    assert isinstance(COARSE, Dome)
    sensor = TactileSensor(DESIGN, body=COARSE)
    sensor.attach(Solid(shape=plane(), friction=0.5))
    sensor.update(Pose(place=(0.0, 0.0, RADIUS + 1e-4)), dt=DT)
    assert not sensor.data.wrench.any()
    sensor.update(Pose(place=(0.0, 0.0, RADIUS - 2e-4)), dt=DT)
    assert sensor.data.wrench[2] < -0.02
