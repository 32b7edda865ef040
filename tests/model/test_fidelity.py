"""No more than the scene needs: each choice of less, and what it costs in accuracy."""

import pytest

from chromagrip.model import (
    ContactObject,
    Fingertip,
    contact_forces,
    equilibrium,
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
