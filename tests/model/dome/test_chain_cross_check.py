"""One chain solved by two engines: `equilibrium`, and the contact solver of the dome."""

import numpy as np
import pytest

from benchmarks.model.bodies import BUCKLED, GRASPS, Grasp, compare
from benchmarks.model.chain_on_newton import grasp_by_newton, unstable_modes
from chromagrip.model import ContactObject, Fingertip, contact_forces, equilibrium


def test_both_engines_find_the_same_forces() -> None:
    coarse, fine = (compare(GRASPS[3]._replace(nodes=51), parts) for parts in (30, 90))
    assert fine.normal < 1e-4
    assert fine.friction < 2e-4
    assert fine.nodal < 2e-3
    # Both follow friction in steps; what is left is of first order in them.
    assert fine.nodal_friction < 0.55 * coarse.nodal_friction


def test_a_press_without_load_is_the_same_node_by_node() -> None:
    tip, obj = Fingertip(nodes=51), ContactObject(stiffness=160.0, curvature=50.0)
    field = contact_forces(tip, obj, equilibrium(tip, obj, 1.0))
    other = grasp_by_newton(tip, obj, 1.0, 0.0, 40)
    assert np.allclose(other.normal_forces, field.normal, atol=2e-3 * field.normal.max())
    assert abs(other.tangential_forces.sum()) < 1e-5
    assert other.forces[:, 2].sum() == pytest.approx(-1.0, abs=1e-5)  # of the object on the nodes


def test_springs_buckle_on_fine_chains_under_hard_objects_only() -> None:
    for grasp, buckles in ((BUCKLED, True), (GRASPS[1], False), (GRASPS[4], False)):
        tip = Fingertip(nodes=grasp.nodes)
        state = equilibrium(tip, grasp.obj, grasp.grip, parts=20)
        assert (unstable_modes(tip, state.deformation.seen) > 0) == buckles, grasp.name


@pytest.mark.elements
@pytest.mark.parametrize("grasp", GRASPS, ids=lambda grasp: grasp.name)
def test_three_digits(grasp: Grasp) -> None:
    assert max(compare(grasp, 400)) < 1e-3
