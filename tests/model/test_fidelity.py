"""No more than the scene needs: each choice of less, and what it costs in accuracy."""

import numpy as np
import pytest

from chromagrip.model import (
    ContactObject,
    Drive,
    Fingertip,
    contact_forces,
    equilibrium,
    simulate,
)

TIP = Fingertip()


@pytest.mark.parametrize(
    "obj", [ContactObject(), ContactObject(stiffness=80.0, friction=0.7, curvature=50.0)]
)
def test_graded_chain_keeps_the_continuum(obj: ContactObject) -> None:
    graded = Fingertip.graded()
    assert graded.nodes <= 100
    fields = []
    for tip in (TIP, graded):
        state = equilibrium(tip, obj, 2.0, 0.4)
        fields.append(contact_forces(tip, obj, state))
    whole, fewer = fields
    assert fewer.normal.sum() == pytest.approx(whole.normal.sum(), rel=1e-3)
    assert fewer.friction.sum() == pytest.approx(whole.friction.sum(), rel=5e-3)
    assert fewer.contact.sum() == whole.contact.sum()
    # Where both have nodes, the forces are the same.
    middle = slice(graded.nodes // 2 - 20, graded.nodes // 2 + 21)
    same = slice(TIP.nodes // 2 - 20, TIP.nodes // 2 + 21)
    assert fewer.normal[middle] == pytest.approx(whole.normal[same], rel=0.01, abs=5e-4)


def test_cost_of_a_step_knows_no_memory_of_its_length() -> None:
    """10 ms steps end where 0.1 ms steps do, Γ and ΣFn within 2 % (loads smooth over a step)."""
    obj = ContactObject(stiffness=160.0, curvature=200.0)
    t = np.linspace(0.0, 0.6, 601)
    rise = np.sin(0.5 * np.pi * np.clip(t / 0.3, 0, 1)) ** 2
    pull = np.sin(0.5 * np.pi * np.clip((t - 0.3) / 0.3, 0, 1)) ** 2
    drive = Drive(times=t, normal=3.0 * rise, lateral=0.6 * pull)
    rows = []
    for dt in (1e-4, 1e-2):
        run = simulate(TIP, obj, drive, dt=dt, duration=0.6, every=round(0.1 / dt))
        fields = [contact_forces(TIP, obj, run.state(k)) for k in range(1, 7)]
        rows.append(
            [(f.normal.sum(), 1 - abs(f.friction.sum()) / (0.5 * f.normal.sum())) for f in fields]
        )
    assert np.array(rows[1]) == pytest.approx(np.array(rows[0]), rel=0.02)
