"""Histories that a read-out is trained on: their forces are those of the model."""

import numpy as np
import pytest

from chromagrip.calibrate.histories import RULE, of_plan, random_plan
from chromagrip.model import Fingertip, contact_forces, rest_state
from chromagrip.model.chain.assembly import chain, contact
from chromagrip.model.chain.plant import march

TIP = Fingertip()


def test_kept_forces_are_those_of_the_model() -> None:
    """Against every step of the chain and `contact_forces`, one state at a time."""
    number, plan = next(
        (number, plan)
        for number in range(1000)
        if (plan := random_plan(TIP, number)).contact.shape == "round"
    )
    found = of_plan(plan, number)
    obj = plan.contact.obj
    tip, drive = plan.fingertip, plan.drive
    steps = round(float(drive.times[-1]) / plan.dt)
    run = march(chain(tip), contact(tip, obj), rest_state(tip), drive, plan.dt, steps, 1, RULE)
    states = [run.state(k) for k in range(len(run))]
    seen = np.array([state.deformation.seen for state in states])
    for k in range(len(found.history)):
        at = int(abs(seen - found.displacement[k]).max(axis=(1, 2)).argmin())
        assert found.displacement[k] == pytest.approx(seen[at], abs=1e-9)
        field = contact_forces(tip, obj, states[at])
        assert found.normal[k] == pytest.approx(field.normal, rel=1e-5, abs=1e-7)
        assert found.friction[k] == pytest.approx(field.friction, rel=1e-5, abs=1e-7)
        assert found.totals[k, 0] == pytest.approx(field.total_normal)
        assert abs(found.totals[k, 1]) == pytest.approx(field.total_friction)
    assert (found.totals[:, 2] == obj.friction).all()
