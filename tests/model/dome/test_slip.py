"""Slip of an object over a dome, against motions whose slip is known."""

import math

import numpy as np
import pytest

from chromagrip.model import Dome, Motion, Solid, contact_steps, dome_forces, press_and_move
from chromagrip.model.dome import DomeSlip, follow_dome_slip, no_dome_slip
from chromagrip.model.shapes import Shape, ball, cylinder, plane

DOME = Dome(pitch=0.8e-3, reach=math.radians(50.0))


def slips(shape: Shape, motion: Motion, mu: float = 0.3, dt: float = 4e-3) -> list[DomeSlip]:
    """Record after each step of a motion."""
    records = [no_dome_slip(DOME)]
    before = None
    for dome, _ in contact_steps(DOME, Solid(shape=shape, friction=mu), motion, dt):
        after = dome.state()
        if before is not None:
            field = dome_forces(DOME, after, whole=False)
            records.append(follow_dome_slip(records[-1], DOME, before, after, field))
        before = after
    return records


def test_a_plate_that_slides_slips_as_far_as_it_moves() -> None:
    records = slips(plane(), press_and_move(0.5e-3, shift=(1.5e-3, 1.0e-3)))
    # Once all slips, each further step of the plate is slip: 25 steps of the motion.
    step = math.hypot(1.5e-3, 1.0e-3) / 25
    assert records[-1].current - records[-6].current == pytest.approx(5 * step, rel=0.02)
    assert records[-1].rigid_slip - records[-6].rigid_slip == pytest.approx(5 * step, rel=0.02)
    # What it moved before is elastic shear, which is no slip.
    pressed = records[25]
    assert pressed.lateral_displacement < 1e-5
    assert records[-1].lateral_displacement < math.hypot(1.5e-3, 1.0e-3)


def test_turning_and_rolling_are_no_slip() -> None:
    turned = slips(plane(), press_and_move(0.5e-3, twist=math.radians(40.0)))
    assert turned[-1].lateral_displacement < 0.05e-3
    radius, path = 4e-3, 1.5e-3
    poses = np.zeros((3, 6))
    poses[1:, 2] = -0.4e-3
    poses[2, 0], poses[2, 4] = path, path / radius
    times = np.array([0.0, 0.1, 0.2])
    rolled = slips(cylinder(radius), Motion(times=times, poses=poses), mu=0.8)
    assert rolled[-1].lateral_displacement < 0.1 * path
    slid = poses.copy()
    slid[2, 4] = 0.0
    assert (
        slips(ball(radius), Motion(times=times, poses=slid))[-1].lateral_displacement > 0.4 * path
    )


def test_lifted_objects_keep_what_they_slipped() -> None:
    poses = np.zeros((4, 6))
    poses[1:3, 2] = -0.3e-3
    poses[2:, 0] = 1.5e-3
    poses[3, 2] = 0.3e-3
    records = slips(plane(), Motion(times=np.array([0.0, 0.1, 0.2, 0.3]), poses=poses))
    assert np.isnan(records[-1].path).all()
    assert records[-1].current == 0.0
    assert records[-1].lateral_displacement == max(record.current for record in records) > 0.5e-3
