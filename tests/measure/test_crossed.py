"""A chain's grasp on a dome."""

import numpy as np
import pytest

from chromagrip import UserError
from chromagrip.measure.worlds.dome.across import dome_states, solid_of
from chromagrip.measure.worlds.force_scenes import Grasp
from chromagrip.model import ContactObject, Drive, dome_forces
from chromagrip.render import load_sensor


def test_what_a_dome_does_not_hold_is_said() -> None:
    with pytest.raises(UserError, match="one µ"):
        solid_of(ContactObject(curvature=-20.0))


def test_a_dome_bears_grip_and_load_of_a_chains_grasp() -> None:
    obj = ContactObject(stiffness=500.0, friction=0.6)
    drive = Drive(
        times=np.array([0.0, 0.1, 0.3, 0.6]),
        normal=np.array([0.02, 2.0, 2.0, 2.0]),
        lateral=np.array([0.0, 0.0, 0.4, 0.4]),
    )
    dome = load_sensor("thesis").dome
    states = dome_states(dome, solid_of(obj), Grasp(obj=obj, drive=drive, ends=(0.6,)), 60)
    assert len(states) == 61
    field = dome_forces(dome, states[-1])
    assert field.total_force == pytest.approx([0.4, 0.0, -2.0], abs=0.02)
    assert field.total_friction == pytest.approx(0.4, abs=0.02)
