"""A sensor in a MuJoCo model: objects rest with their weight, slide at µ, and swing."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import ellipk

from chromagrip import UserError

mujoco = pytest.importorskip("mujoco")

from chromagrip.mujoco import MujocoTip, attach  # noqa: E402

RADIUS, WEIGHT = 20e-3, 9.81


HULL = '<geom name="hull" type="sphere" size="0.0199" mass="0.1"/>'
JOINT = '<joint type="slide" axis="0 0 1" stiffness="1e5" armature="1"/>'


def world(part: str, step: float = 1e-3, tip: str = "", more: str = "") -> tuple[Any, Any]:
    """Model and data with a sensor that looks up, and a part above it."""
    site = "" if "<site" in tip else '<site name="tip"/>'
    text = f"""<mujoco><option timestep="{step}" integrator="implicitfast"/><worldbody>
      <geom name="floor" type="plane" size="1 1 1"/>
      <body name="tip" pos="0.1 0 0.2">{tip}{site}</body>{part}
    </worldbody>{more}</mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    return model, mujoco.MjData(model)


def run(model: Any, data: Any, tip: MujocoTip, end: float) -> np.ndarray:
    """Forces on the sensor in each step until a time, shape (T, 3)."""
    forces = []
    while data.time < end:
        mujoco.mj_step(model, data)
        forces.append(tip.update().wrench[:3].copy())
    return np.array(forces)


def box(mass: float, joints: str = "<freejoint/>", size: str = "0.005 0.005 0.005") -> str:
    half = float(size.split()[2])
    return (
        f'<body name="part" pos="0.1 0 {0.2 + RADIUS + half + 2e-4}">{joints}'
        f'<geom name="box" type="box" size="{size}" mass="{mass}"/></body>'
    )


@pytest.mark.parametrize(
    ("mass", "step", "tip", "pair"),
    [
        (0.02, 1e-3, HULL, ""),
        (0.5, 1e-3, f'{JOINT}{HULL}<body name="mount"><site name="tip"/></body>', ""),
        (0.1, 2e-3, HULL, '<contact><pair geom1="hull" geom2="box"/></contact>'),
    ],
)
def test_a_box_rests_with_its_weight(mass: float, step: float, tip: str, pair: str) -> None:
    """Also where the site is on a frame of its own, or a pair of contact is listed."""
    model, data = world(box(mass), step, tip, pair)
    held = attach(model, data, site="tip", body="part", two_way=True, friction=0.5)
    force = -run(model, data, held, 0.4)[-round(0.1 / step) :, 2]
    assert data.ncon == 0  # MuJoCo's own contact of the pair is off
    assert force.mean() == pytest.approx(WEIGHT * mass, rel=0.01)
    assert force.std() < 0.02 * WEIGHT * mass
    floor, part = model.geom("floor").id, model.geom("box").id
    assert model.geom_contype[floor] & model.geom_conaffinity[part]  # another contact stays
    bodies = [model.site("tip").bodyid[0], model.body("part").id]
    force, torque = np.split(data.xfrc_applied[bodies], 2, axis=1)
    np.testing.assert_allclose(force[0], -force[1])  # they cancel, and so do their moments
    moment = torque + np.cross(data.xipos[bodies], force)
    np.testing.assert_allclose(moment[0], -moment[1], atol=1e-12)


def test_a_box_slides_at_its_friction() -> None:
    joints = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>'
    model, data = world(box(0.1, joints, "0.04 0.02 0.01"))
    tip = attach(model, data, site="tip", body="part", two_way=True, friction=0.4)
    run(model, data, tip, 0.2)
    data.qfrc_applied[0] = 0.6  # more than 0.4 · 0.981 N
    force = run(model, data, tip, 0.32)
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


@pytest.mark.parametrize("how", ["reset", "far"])
def test_no_force_is_left_behind(how: str) -> None:
    """After a reset of the tip alone, and where the object is suddenly metres away."""
    model, data = world(box(0.1))
    tip = attach(model, data, site="tip", body="part", two_way=True, friction=0.5)
    run(model, data, tip, 0.05)
    assert data.xfrc_applied.any()
    if how == "reset":
        tip.reset()
    else:
        data.qpos[2] += 5.0
        mujoco.mj_step(model, data)
        tip.update()
    np.testing.assert_allclose(data.xfrc_applied, 0.0, atol=1e-12)


def test_other_contacts_of_the_fingertip_stay() -> None:
    other = '<body name="other"><freejoint/><geom size="0.01" mass="0.01"/></body>'
    model, data = world(box(0.1) + other, tip=HULL)
    attach(model, data, site="tip", body="part", two_way=True)
    pairs = (model.geom_contype[:, None] & model.geom_conaffinity) != 0
    pairs |= pairs.T
    hull, part, free = (model.geom(k).id for k in ("hull", "box", 3))
    assert (pairs[hull, free], pairs[part, free], pairs[hull, part]) == (True, True, False)


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
    mujoco.mj_kinematics(model, data)
    assert tip.update().wrench[2] < -0.01
    assert tip.sensor.data.contact.obj.shape.name == {"sphere": "ball"}.get(kind, kind)


def test_what_is_missing_is_named() -> None:
    two = '<body name="part"><geom name="a" size="0.01"/><geom name="b" size="0.02"/></body>'
    model, data = world(two + '<body name="egg"><geom type="ellipsoid" size="1 1 2"/></body>')
    for wrong, words in (
        ({"site": "finger"}, "no site 'finger'; it has tip"),
        ({"geom": None}, r"2 geoms \(a, b\); choose one: geom=NAME"),
        ({"site": 0}, "the site is given by its name, not by 0"),
        ({"two_way": True, "relaxation": -1.0}, r"relaxation \[s\]"),
        ({"body": "egg", "geom": None}, "type ellipsoid cannot be touched"),
    ):
        with pytest.raises(UserError, match=words):
            attach(model, data, **{"site": "tip", "body": "part", "geom": "a"} | wrong)  # type: ignore[arg-type]
    with pytest.raises(UserError, match="the MjData is of another model"):
        attach(model, world(box(0.1))[1], site="tip", body="part", geom="a")
