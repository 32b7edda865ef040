"""A chain's grasp on a dome."""

import numpy as np
import pytest

from chromagrip import UserError
from chromagrip.measure.worlds.crossed import dome_states, solid_of
from chromagrip.measure.worlds.force_scenes import PERIOD, Grasp
from chromagrip.model import ContactObject, Drive, dome_forces
from chromagrip.render import load_sensor


def test_what_a_chain_alone_holds_is_said() -> None:
    with pytest.raises(UserError, match="one µ"):
        solid_of(ContactObject(curvature=-20.0))


@pytest.mark.parametrize("curvature", [0.0, 50.0])
def test_a_dome_bears_a_chains_grip_and_load(curvature: float) -> None:
    grasped = Grasp(
        obj=ContactObject(stiffness=500.0, friction=0.6, curvature=curvature),
        drive=Drive(
            times=np.array([0.0, 0.1, 0.3, 0.6]),
            normal=np.array([0.02, 2.0, 2.0, 2.0]),
            lateral=np.array([0.0, 0.0, 0.4, 0.4]),
        ),
        ends=(0.6,),
    )
    dome, solid = load_sensor("thesis").dome, solid_of(grasped.obj)
    end = dome_states(dome, solid, grasped, round(0.6 / PERIOD))[-1]
    field = dome_forces(dome, end)
    assert field.total_force == pytest.approx([0.4, 0.0, -2.0], abs=0.02)
