"""What every body of a sensor does: statics, symmetry, poses and forces both ways, and refusals."""

import math
from dataclasses import dataclass
from functools import cache
from typing import Any, get_args

import numpy as np
import pytest

from chromagrip import Pose, TactileSensor, UserError
from chromagrip.model import ContactObject, Fingertip, Solid
from chromagrip.model.shapes import ball
from chromagrip.sensing.bodies import BodyName, ChainBody
from chromagrip.sensing.sensor import SensorData

DT = 1.0 / 60.0
MU = 0.6
SOLID = Solid(shape=ball(20e-3), friction=MU)


@dataclass(frozen=True)
class Kind:
    """A body with what it touches, a press [m] and a shear [m] that is held by friction."""

    design: str
    body: Any
    obj: ContactObject | Solid
    press: float = 0.6e-3
    shear: float = 0.08e-3


KINDS = {
    "chain": Kind("thesis", Fingertip(nodes=101), ContactObject(friction=MU), shear=0.2e-3),
    "dome": Kind("dome-2020", "dome", SOLID),
    "pad": Kind("flat-2019", "pad", SOLID, press=0.3e-3, shear=0.05e-3),
}
EACH = pytest.mark.parametrize("name", get_args(BodyName))


def opened(name: str, **options: Any) -> TactileSensor:
    kind = KINDS[name]
    sensor = TactileSensor(kind.design, body=kind.body, seed=3, **options)
    sensor.attach(kind.obj)
    return sensor


@cache
def untouched(name: str) -> TactileSensor:
    """A sensor that no test changes."""
    return opened(name)


def pose(sensor: TactileSensor, press: float, x: float = 0.0) -> Pose:
    """Pose of the object that deep, shifted along x."""
    contact, body = sensor.data.contact, sensor.body
    if isinstance(body, ChainBody):
        return Pose(place=(x, 0.0, body.fingertip.radius - press))
    top = contact.state.place[2] + contact.indentation
    return Pose(place=(x, 0.0, float(top) - press))


def move(sensor: TactileSensor, press: float, x: float, frames: int = 8) -> SensorData:
    """Press the object down, then shift it."""
    for k in range(1, frames + 1):
        sensor.update(pose(sensor, press * k / frames), dt=DT)
    for k in range(1, frames + 1 if x else 1):
        sensor.update(pose(sensor, press, x * k / frames), dt=DT)
    return sensor.data


@cache
def moved(name: str, side: float = 0.0) -> SensorData:
    """After a press, and a shear to that side."""
    return move(opened(name, noise=2.0), KINDS[name].press, side * KINDS[name].shear)


@EACH
def test_at_rest_there_is_no_force(name: str) -> None:
    data = untouched(name).data
    assert not data.wrench.any()
    assert not data.node_force.any()
    assert not data.slipping.any()
    assert math.isnan(data.margin)
    assert (data.index, data.time) == (0, 0.0)


@EACH
def test_a_press_is_opposed_and_the_wrench_is_the_sum_of_the_nodes(name: str) -> None:
    for data in (moved(name), moved(name, 1.0)):
        field, force = data.contact.field, data.node_force.sum(axis=0)
        np.testing.assert_allclose(data.wrench[:3], force, atol=1e-12)
        torque = np.cross(data.node_pos, data.node_force).sum(axis=0)
        np.testing.assert_allclose(data.wrench[3:], torque, atol=1e-12)
        assert -data.wrench[2] == pytest.approx(field.total_normal, rel=0.03)
        assert -data.wrench[2] > 0.1
        assert data.margin == pytest.approx(1.0 - field.total_friction / (MU * field.total_normal))
    assert abs(moved(name).wrench[:2]).max() < 0.02 * -moved(name).wrench[2]
    assert data.wrench[0] > 0.05 * -data.wrench[2]  # what is pushed along x pushes along x
    assert math.isnan(data.limit_margin) != data._sensor.ability.torsion


@EACH
def test_a_mirrored_push_gives_the_mirrored_wrench(name: str) -> None:
    one, other = (moved(name, side) for side in (1.0, -1.0))
    mirror = np.array([-1.0, 1.0, 1.0, 1.0, -1.0, -1.0])  # of the plane x = 0
    size = np.repeat([abs(one.wrench[2]), abs(one.wrench[4])], 3)
    np.testing.assert_allclose(one.wrench / size, mirror * other.wrench / size, atol=0.02)
    assert one.margin == pytest.approx(other.margin, abs=0.02)


@EACH
def test_equal_sensors_have_equal_bytes_and_a_state_goes_on_as_it_did(name: str) -> None:
    kind, sensor = KINDS[name], opened(name, noise=2.0)
    data = move(sensor, kind.press, kind.shear)
    assert data.wrench.tobytes() == moved(name, 1.0).wrench.tobytes()
    assert data.image.tobytes() == moved(name, 1.0).image.tobytes()
    kept, ends = sensor.state(), []
    for _ in range(2):
        sensor.restore(kept)
        after = sensor.update(pose(sensor, 0.9 * kind.press), dt=DT)
        ends.append((after.wrench.tobytes(), after.image.tobytes()))
        sensor.update(pose(sensor, 0.5 * kind.press, 0.05e-3), dt=2 * DT)  # leaves nothing behind
    assert ends[0] == ends[1]
    sensor.reset()
    assert not sensor.data.wrench.any()


@EACH
def test_a_pose_is_held_by_the_force_that_it_gives(name: str) -> None:
    kind, sensor = KINDS[name], opened(name)
    move(sensor, kind.press, kind.shear)
    for _ in range(20):  # what flows has come to rest
        held = sensor.update(pose(sensor, kind.press, kind.shear), dt=DT)
    other = opened(name)
    for _ in range(40):
        loaded = other.update(force=held.wrench[:3], dt=DT)
    np.testing.assert_allclose(loaded.wrench[:3], held.wrench[:3], atol=0.01 * -held.wrench[2])
    assert loaded.contact.indentation == pytest.approx(kind.press, rel=0.02)
    assert loaded.contact.place == pytest.approx((kind.shear, 0.0), abs=0.1 * kind.shear)
    assert loaded.margin == pytest.approx(held.margin, abs=0.03)


@EACH
def test_a_picture_has_the_size_of_the_camera_and_the_time_of_its_frame(name: str) -> None:
    data, view = moved(name, 1.0), moved(name)._sensor.design.view
    assert (data.image.shape, data.image.dtype) == ((view.height, view.width, 3), np.uint8)
    assert (data.index, data.frame.time) == (16, pytest.approx(16 * DT))
    rest_px = untouched(name).data.marker_px
    fresh = TactileSensor(KINDS[name].design, body=KINDS[name].body, seed=3, noise=2.0)
    rest = [frame.image for frame in fresh.rest_frames(2)]
    assert (rest[0] != rest[1]).any()  # noise is of each frame
    again = data._sensor.rest_frames(1)[0]  # of the untouched sensor, at any time
    np.testing.assert_array_equal(again.image, rest[0])
    shift = np.nan_to_num(data.marker_px - rest_px)
    assert np.linalg.norm(shift, axis=-1).max() > 0.4
    seen = data.marker_px[data.marker_visible]
    assert ((seen > -1.0) & (seen < [view.width, view.height])).all()
    fresh.close()


@EACH
def test_an_object_moves_and_is_loaded_along_the_axes_of_the_ability_alone(name: str) -> None:
    sensor = opened(name)
    move(sensor, KINDS[name].press, 0.0)
    start, before = sensor.state(), sensor.data.wrench
    for k, axis in enumerate(("x", "y", "z", "rx", "ry", "rz")):
        moves = np.array([*pose(sensor, KINDS[name].press).place, 0.0, 0.0, 0.0])
        moves[k] -= 0.03e-3 if k < 3 else 5e-3
        at = Pose(place=tuple(moves[:3]), turn=(1.0, *moves[3:]))
        wrench = np.array([0.0, 0.0, before[2], 0.0, 0.0, 0.0])
        wrench[k] -= 0.1 if k < 3 else 1e-4
        for asked, allowed in (
            ({"pose": at}, sensor.ability.moves),
            ({"force": wrench}, sensor.ability.loads),
        ):
            if axis in allowed:
                assert (sensor.update(**asked, dt=DT).wrench != before).any()
                sensor.restore(start)
                continue
            with pytest.raises(UserError, match=r"along x and z alone|torques about x and y"):
                sensor.update(**asked, dt=DT)
            assert sensor.state() is start


@EACH
def test_what_cannot_be_done_is_refused_and_changes_nothing(name: str) -> None:
    sensor = untouched(name)
    before, unknown = sensor.state(), [math.nan, 0.0, 0.0]
    asked: list[tuple[dict[str, Any], str]] = [
        ({"dt": 0.0, "force": [0.0, 0.0, -1.0]}, "must be above 0 s"),
        ({"dt": math.nan, "force": [0.0, 0.0, -1.0]}, "dt = nan must be a finite number"),
        ({"pose": Pose(place=(0.0, 0.0, 0.02)), "force": [0, 0, 1]}, "not both"),
        ({}, "a pose or a force"),
        ({"force": unknown}, "3 or 6 finite numbers"),
        ({"pose": (0.0, 0.0, 0.0)}, "needs a Pose"),
    ]
    if name == "chain":
        asked.append(({"force": [0.0, 0.0, -1e6]}, "fingertip flat"))
    else:
        asked.append(({"pose": pose(sensor, 10e-3)}, "too deep"))
    for words, sentence in asked:
        with pytest.raises(UserError, match=sentence):
            sensor.update(**({"dt": DT} | words))
        assert sensor.state() is before


@EACH
def test_an_object_of_another_kind_and_none_are_refused(name: str) -> None:
    sensor = TactileSensor(KINDS[name].design, body=KINDS[name].body)
    for ask in (sensor.reset, sensor.state, lambda: sensor.data, lambda: sensor.update(dt=DT)):
        with pytest.raises(UserError, match="attach"):
            ask()
    other = SOLID if name == "chain" else ContactObject()
    assert not isinstance(other, sensor.ability.objects)
    with pytest.raises(UserError, match=r"touches a (ContactObject|Solid)"):
        sensor.attach(other)


def test_what_is_no_pose_is_refused() -> None:
    for place, turn, words in (
        ((math.nan, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), "3 finite numbers"),
        ((0.0, 0.0, 15.0), (1.0, 0.0, 0.0, 0.0), "is 15 m away, allowed is 1 m: are these"),
        ((0.0, 0.0, 0.0), (math.nan, 1.0, 0.0, 0.0), "4 finite numbers"),
        ((0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0), "length 1"),
    ):
        with pytest.raises(UserError, match=words):
            Pose(place=place, turn=turn)
