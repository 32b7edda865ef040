import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chromagrip.model import Fingertip, chain_compliance, chain_forces
from chromagrip.model.kernels.springs import AXIAL, INVERSE_POISSON, SPLIT, spring

TIP = Fingertip(nodes=31)
lengths = st.floats(-5e-3, 5e-3).filter(lambda v: abs(v) > 1e-4)
moves = st.floats(-1e-3, 1e-3)


def smooth_displacement(rng: np.random.Generator, nodes: int) -> np.ndarray:
    angle = np.linspace(0, np.pi, nodes)
    waves = np.stack([np.sin(k * angle) for k in range(1, 6)], axis=1)
    return 1e-4 * waves @ rng.standard_normal((5, 2))


@pytest.mark.parametrize("law", [SPLIT, INVERSE_POISSON, AXIAL])
@given(lengths, lengths, moves, moves, st.sampled_from([-0.4, 0.0, 0.4]))
def test_spring_tangent_is_the_derivative(
    law: int, rest_x: float, rest_z: float, dx: float, dz: float, cross: float
) -> None:
    if min(abs(rest_x + dx), abs(rest_z + dz)) < 5e-5:
        return  # the absolute value has no derivative at zero

    def terms(moved: np.ndarray) -> np.ndarray:
        reach = np.array([rest_x, rest_z]) + moved
        return np.array(spring(law, *reach, *moved, 314.0, cross, 1.0, 0.0))

    at = np.array([dx, dz])
    tangent = terms(at)[2:].reshape(2, 2)
    length = np.hypot(rest_x + dx, rest_z + dz)
    for k, nudge in enumerate(1e-8 * np.eye(2)):
        slope = (terms(at + nudge)[:2] - terms(at - nudge)[:2]) / 2e-8
        # Central differences err with the third derivative, which grows with the nudge over L.
        np.testing.assert_allclose(tangent[:, k], slope, rtol=1e-4, atol=1e-3 * (1 + 1e-3 / length))


def test_compliance_inverts_the_tangent() -> None:
    rng = np.random.default_rng(3)
    seen = smooth_displacement(rng, TIP.nodes)
    load = np.zeros((TIP.nodes, 2, 1))
    load[1:-1, :, 0] = 1e-6 * rng.standard_normal((TIP.nodes - 2, 2))
    added = chain_compliance(TIP, seen, load)[:, :, 0]
    change = chain_forces(TIP, seen + added / 2) - chain_forces(TIP, seen - added / 2)
    np.testing.assert_allclose(change[1:-1], load[1:-1, :, 0], atol=2e-9)


def test_radial_spring_at_the_apex_is_hookes_law() -> None:
    """One node moved along its own tissue spring: force = k·Δ, plus the membrane's small share."""
    tip = Fingertip(nodes=31, membrane_stiffness=1e-9)
    seen = np.zeros((31, 2))
    seen[15, 1] = -1e-4
    forces = chain_forces(tip, seen)
    stiffness = tip.tissue_stiffness * 250 / 30
    assert forces[15] == pytest.approx([0.0, -1e-4 * stiffness], abs=1e-9)
    assert abs(forces[:14]).max() < 1e-9


def test_poisson_pushes_both_halves_outwards() -> None:
    """Pressed straight down, the right half is pushed right and the left half left (E6)."""
    seen = np.zeros((TIP.nodes, 2))
    seen[1:-1, 1] = -1e-4
    held = chain_forces(TIP, seen)[:, 0]  # what must hold it back
    assert (held[TIP.nodes // 2 + 1 : -1] < 0).all()
    np.testing.assert_allclose(held, -held[::-1], atol=1e-12)


@pytest.mark.parametrize("nodes", [101, 501])
def test_node_count_does_not_change_the_stiffness(nodes: int) -> None:
    """A uniform squeeze costs the same total force whatever the node count."""

    def total(n: int) -> float:
        tip = Fingertip(nodes=n)
        seen = np.zeros((n, 2))
        seen[:, 1] = -1e-4 * np.cos(tip.angles()) ** 2
        return float(chain_forces(tip, seen)[1:-1, 1].sum())

    assert total(nodes) == pytest.approx(total(251), rel=0.01)
