"""A sensor in a MuJoCo model: objects rest with their weight, slide at µ, and swing."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import ellipk

from chromagrip import UserError

mujoco = pytest.importorskip("mujoco")

from chromagrip.mujoco import MujocoTip, attach  # noqa: E402

RADIUS, WEIGHT = 20e-3, 9.81


def world(part: str, step: float = 1e-3, tip: str = "") -> tuple[object, object]:
    """Model and data with a sensor that looks up, and a part above it."""
    text = f"""<mujoco><option timestep="{step}" integrator="implicitfast"/><worldbody>
      <body name="tip" pos="0.1 0 0.2">{tip}<site name="tip"/></body>{part}
    </worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    return model, mujoco.MjData(model)


def run(model: object, data: object, tip: MujocoTip, end: float) -> np.ndarray:
    """Forces on the sensor in each step until a time, shape (T, 3)."""
    forces = []
    while data.time < end:  # type: ignore[attr-defined]
        mujoco.mj_step(model, data)
        forces.append(tip.update().wrench[:3].copy())
    return np.array(forces)


def box(mass: float, joints: str = "<freejoint/>", size: str = "0.005 0.005 0.005") -> str:
    half = float(size.split()[2])
    return (
        f'<body name="part" pos="0.1 0 {0.2 + RADIUS + half + 2e-4}">{joints}'
        f'<geom name="box" type="box" size="{size}" mass="{mass}"/></body>'
    )


@pytest.mark.parametrize(("mass", "step"), [(0.02, 1e-3), (0.5, 1e-3), (0.1, 2e-3)])
def test_a_box_rests_with_its_weight(mass: float, step: float) -> None:
    model, data = world(box(mass), step, '<geom type="sphere" size="0.0199" mass="0.1"/>')
    tip = attach(model, data, site="tip", body="part", two_way=True, friction=0.5)
    force = -run(model, data, tip, 0.8)[-150:, 2]
    assert data.ncon == 0  # MuJoCo's own contact of the pair is off
    assert force.mean() == pytest.approx(WEIGHT * mass, rel=0.01)
    assert force.std() < 0.02 * WEIGHT * mass


def test_a_box_slides_at_its_friction() -> None:
    joints = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>'
    model, data = world(box(0.1, joints, "0.04 0.02 0.01"))
    tip = attach(model, data, site="tip", body="part", two_way=True, friction=0.4)
    run(model, data, tip, 0.3)
    data.qfrc_applied[0] = 0.6  # more than 0.4 · 0.981 N
    force = run(model, data, tip, 0.42)
    sliding = force[-20:]
    assert data.qvel[0] > 0.02
    np.testing.assert_allclose(sliding[:, 0] / -sliding[:, 2], 0.4, rtol=0.03)


@pytest.mark.loops
def test_a_peg_between_two_fingers_swings_with_the_period_of_a_pendulum() -> None:
    """The fingertips hold it by friction, whose torque is small; a tighter grip stiffens it."""
    length, half, press, angle = 0.12, 5e-3, 0.35e-3, 0.7
    side = half + RADIUS - press
    model = mujoco.MjModel.from_xml_string(f"""
    <mujoco><option timestep="5e-4" integrator="implicitfast"/><worldbody>
      <body pos="{-side} 0 0"><site name="left" euler="0 90 0"/></body>
      <body pos="{side} 0 0"><site name="right" euler="0 -90 0"/></body>
      <body name="peg" euler="{math.degrees(angle)} 0 0"><freejoint/>
        <geom name="peg" type="box" size="{half} .01 .01" mass=".001"/>
        <geom type="box" pos="0 0 {-length}" size=".05 .05 .005" mass=".1"/>
      </body></worldbody></mujoco>""")
    data = mujoco.MjData(model)
    tips = [
        attach(model, data, site=name, body="peg", geom="peg", two_way=True, friction=0.8)
        for name in ("left", "right")
    ]
    angles, times = [], []
    while data.time < 0.95:
        mujoco.mj_step(model, data)
        for tip in tips:
            tip.update()
        times.append(data.time)
        angles.append(2.0 * math.atan2(data.qpos[4], data.qpos[3]))
    turned = np.array(angles)
    crossed = np.flatnonzero(np.diff(np.sign(turned)))
    within = turned[crossed] / (turned[crossed] - turned[crossed + 1])
    zeros = np.array(times)[crossed] + 5e-4 * within
    peg = model.body("peg").id
    mass, arm = model.body_mass[peg], float(np.linalg.norm(model.body_ipos[peg]))
    turn = Rotation.from_quat(model.body_iquat[peg], scalar_first=True).as_matrix()
    inertia = (turn**2 @ model.body_inertia[peg])[0] + mass * arm**2
    # Of the swing between the first two extremes after the start, with its amplitude.
    amplitude = 0.5 * (-turned[crossed[0] : crossed[1]].min() + turned[crossed[1] :].max())
    period = 4.0 * math.sqrt(inertia / (mass * WEIGHT * arm))
    period *= ellipk(math.sin(0.5 * amplitude) ** 2)
    assert 0.3 < amplitude < angle, (amplitude, zeros, period)
    assert zeros[2] - zeros[0] == pytest.approx(period, rel=0.03)


def test_forces_on_both_bodies_cancel() -> None:
    model, data = world(box(0.1))
    tip = attach(model, data, site="tip", body="part", two_way=True, friction=0.5)
    run(model, data, tip, 0.3)
    on = data.xfrc_applied[[model.body("tip").id, model.body("part").id]]
    np.testing.assert_allclose(on[0, :3], -on[1, :3])
    moment = [
        each[3:] + np.cross(data.xipos[model.body(name).id], each[:3])
        for each, name in zip(on, ("tip", "part"), strict=True)
    ]
    np.testing.assert_allclose(moment[0], -np.array(moment[1]), atol=1e-12)


@pytest.mark.parametrize("how", ["reset", "far"])
def test_no_force_is_left_behind(how: str) -> None:
    """After a reset of the tip alone, and where the object is suddenly metres away."""
    model, data = world(box(0.1))
    tip = attach(model, data, site="tip", body="part", two_way=True, friction=0.5)
    run(model, data, tip, 0.1)
    assert data.xfrc_applied.any()
    if how == "reset":
        tip.reset()
    else:
        data.qpos[2] += 5.0
        mujoco.mj_step(model, data)
        tip.update()
    np.testing.assert_allclose(data.xfrc_applied, 0.0, atol=1e-12)


def test_other_contacts_of_the_fingertip_stay() -> None:
    other = (
        '<body name="other" pos="0.1 0.015 0.23"><freejoint/><geom size="0.01" mass="0.01"/></body>'
    )
    hull = '<geom name="hull" type="sphere" size="0.0199"/>'
    model, data = world(box(0.1) + other, tip=hull)
    before = model.geom_contype.copy()
    attach(model, data, site="tip", body="part", two_way=True)
    pairs = (model.geom_contype[:, None] & model.geom_conaffinity) != 0
    pairs |= pairs.T
    hull_, part, free = (model.geom(k).id for k in ("hull", "box", 2))
    assert pairs[hull_, free]
    assert pairs[part, free]
    assert not pairs[hull_, part]
    attach(model, data, site="tip", body="part")  # one way leaves contacts as they are
    assert (model.geom_contype != before).any()


@pytest.mark.parametrize(
    ("kind", "size", "top"),
    [
        ("sphere", "0.006", 6e-3),
        ("capsule", "0.004 0.006", 10e-3),
        ("cylinder", "0.006 0.004", 4e-3),
    ],
)
def test_shapes_are_those_of_the_geoms(kind: str, size: str, top: float) -> None:
    part = f"""<body name="part" pos="0.1 0 {0.2 + RADIUS + top - 0.3e-3}">
      <joint type="slide" axis="0 0 1"/><geom type="{kind}" size="{size}" mass="0.01"/></body>"""
    model, data = world(part)
    tip = attach(model, data, site="tip", body="part")
    mujoco.mj_step(model, data)
    shape = tip.sensor.data.contact.obj.shape
    mujoco.mj_kinematics(model, data)
    assert tip.update().wrench[2] < -0.01
    assert shape.name == {"sphere": "ball"}.get(kind, kind)


@pytest.mark.parametrize("how", ["child", "pair"])
def test_contact_of_a_welded_body_and_of_a_listed_pair_is_off(how: str) -> None:
    """A site is often on a frame of its own; a box rests with its weight all the same."""
    hull = '<geom name="hull" type="sphere" size="0.0199"/>'
    inner = '<body name="mount"><site name="tip"/></body>' if how == "child" else ""
    pair = '<contact><pair geom1="hull" geom2="box"/></contact>' if how == "pair" else ""
    text = f"""<mujoco><option timestep="1e-3"/><worldbody>
      <geom name="floor" type="plane" size="1 1 1"/>
      <body name="finger" pos="0.1 0 0.2"><joint type="slide" axis="0 0 1" stiffness="1e5"/>
      <inertial pos="0 0 0" mass="1" diaginertia=".01 .01 .01"/>{hull}{inner}
      {"" if inner else '<site name="tip"/>'}</body>{box(0.05)}</worldbody>{pair}</mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    tip = attach(model, data, site="tip", body="part", two_way=True, friction=0.5)
    force = -run(model, data, tip, 0.6)[-100:, 2]
    assert data.ncon == 0
    assert force.mean() == pytest.approx(WEIGHT * 0.05, rel=0.01)
    floor, part = model.geom("floor").id, model.geom("box").id
    assert model.geom_contype[floor] & model.geom_conaffinity[part]  # another contact stays


def test_what_is_missing_is_named() -> None:
    two = '<body name="part"><geom name="a" size="0.01"/><geom name="b" size="0.02"/></body>'
    model, data = world(two + '<body name="egg"><geom type="ellipsoid" size="1 1 2"/></body>')
    with pytest.raises(UserError, match="no site 'finger'; it has tip"):
        attach(model, data, site="finger", body="part")
    with pytest.raises(UserError, match="no body 'cup'; it has egg, part, tip, world"):
        attach(model, data, site="tip", body="cup")
    with pytest.raises(UserError, match=r"2 geoms \(a, b\); choose one: geom=NAME"):
        attach(model, data, site="tip", body="part")
    for wrong, words in (
        ({"site": None}, "the site is given by its name, not by None"),
        ({"site": 0}, "the site is given by its name, not by 0"),
        ({"sensor": 3}, "must be the name or file of a design"),
        ({"two_way": "no"}, "two_way = 'no' must be True or False"),
        ({"two_way": True, "relaxation": -1.0}, r"relaxation \[s\]"),
        ({"body": "tip", "geom": None}, "body 'tip' has no geom to touch"),
    ):
        with pytest.raises(UserError, match=words):
            attach(model, data, **{"site": "tip", "body": "part", "geom": "a"} | wrong)  # type: ignore[arg-type]
    with pytest.raises(UserError, match="MjModel and MjData, in this order"):
        attach(data, model, site="tip", body="part", geom="a")
    with pytest.raises(UserError, match="the MjData is of another model"):
        attach(model, world(box(0.1))[1], site="tip", body="part", geom="a")
    with pytest.raises(UserError, match="type ellipsoid cannot be touched"):
        attach(model, data, site="tip", body="egg")
