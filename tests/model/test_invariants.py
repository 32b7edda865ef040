"""What must hold for any parameters and any path: balance, symmetry, cone, energy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromagrip.model import (
    ContactObject,
    Drive,
    Fingertip,
    chain_forces,
    contact_forces,
    simulate,
)
from chromagrip.model.chain.assembly import chain

TIP = Fingertip(nodes=51)
objects = st.builds(
    ContactObject,
    stiffness=st.sampled_from([80.0, 160.0, 1000.0, 1e5]),
    friction=st.floats(0.1, 1.5),
    curvature=st.sampled_from([-50.0, 0.0, 50.0, 200.0]),
    dahl_exponent=st.sampled_from([0.5, 0.7, 1.0, 1.5]),
)


def frames(obj: ContactObject, points: np.ndarray, object_x: float) -> np.ndarray:
    """Normal of a flat or round object at the points, from its definition."""
    if obj.curvature == 0.0:
        return np.tile([0.0, -1.0], (len(points), 1))
    radius = 1.0 / obj.curvature
    away = points - [object_x, TIP.radius + radius]
    return np.sign(radius) * away / np.linalg.norm(away, axis=1, keepdims=True)


@settings(max_examples=12)
@given(objects, st.floats(0.05, 2.0), st.floats(-0.4, 0.4))
def test_contact_carries_grip_and_load_and_stays_in_the_cone(
    obj: ContactObject, grip: float, share: float
) -> None:
    load = share * obj.friction * grip
    drive = Drive(times=[0.0, 0.2, 0.4], normal=[0.0, grip, grip], lateral=[0.0, 0.0, load])
    run = simulate(TIP, obj, drive, dt=2e-3, duration=1.0, every=50)
    for k in range(1, len(run)):
        state = run.state(k)
        field = contact_forces(TIP, obj, state)
        assert (abs(field.friction) <= obj.friction * field.normal + 1e-12).all()
    normal = frames(obj, TIP.rest_positions() + state.deformation.nodes, run.pose[-1, 1])
    tangent = np.column_stack([-normal[:, 1], normal[:, 0]])
    total = (field.normal[:, None] * normal + field.friction[:, None] * tangent).sum(axis=0)
    # What is left is carried by the dampers, of which the state knows the rates.
    drag = [obj.drag * state.rate[-1, 1], _damping(state.rate)]
    assert total + drag == pytest.approx([load, -grip], abs=2e-3 * grip)


def _damping(rate: np.ndarray) -> float:
    """Force of all dampers along z, towards the base."""
    ch = chain(TIP)
    return -float((ch.damping[1:-1] * rate[1:-2, 1]).sum() + ch.damping_rigid * rate[-1, 0])


def closed_path(rng: np.random.Generator, scale: float, steps: int = 400) -> np.ndarray:
    """Smooth displacement paths (steps, N, 2) that end where they start, rims held."""
    t = np.linspace(0.0, 2 * np.pi, steps + 1)
    angle = np.linspace(0.0, np.pi, TIP.nodes)
    waves = np.stack([np.sin(k * angle) for k in range(1, 5)])
    turns = np.stack([np.sin(t), 1 - np.cos(t), np.sin(2 * t)], axis=1)
    return scale * np.einsum("ta,akc,kn->tnc", turns, rng.standard_normal((3, 4, 2)), waves)


def work_on_chain(tip: Fingertip, path: np.ndarray) -> tuple[float, float]:
    """Work done on the springs over a path, and the work turned over [J]."""
    forces = np.array([chain_forces(tip, u) for u in path])
    parts = 0.5 * (forces[1:] + forces[:-1]) * np.diff(path, axis=0)
    return float(parts.sum()), float(abs(parts.sum(axis=(1, 2))).sum())


@pytest.mark.parametrize("seed", range(2))
def test_axial_springs_give_all_work_back(seed: int) -> None:
    """The Sensor Model's springs have a potential."""
    path = closed_path(np.random.default_rng(seed), 2e-4)
    work, turned = work_on_chain(Fingertip(nodes=51, law="axial"), path)
    assert abs(work) < 1e-3 * turned


@pytest.mark.parametrize("seed", range(2))
def test_work_of_the_split_law_over_a_small_cycle_is_third_order(seed: int) -> None:
    """Without Poisson terms the split law conserves energy but for the turning of its springs.

    Its force is linear in displacement times |sin|, |cos|, so what a cycle makes or loses falls
    with the third power of its size while the work turned over falls with the second: a passive law
    to leading order, and no more than that.
    """
    tip = Fingertip(nodes=51, poisson_tissue=0.0, poisson_membrane=0.0)
    lost = []
    for scale in (4e-6, 2e-6):
        work, turned = work_on_chain(tip, closed_path(np.random.default_rng(seed), scale))
        assert abs(work) < 0.05 * turned
        lost.append(abs(work))
    assert lost[0] / lost[1] == pytest.approx(8.0, rel=0.25)


def test_poisson_terms_make_or_lose_energy_to_leading_order() -> None:
    """E6 makes K non-symmetric: a cycle at ν = 0.4 does work of second order, of either sign."""
    rng = np.random.default_rng(1)
    path = closed_path(rng, 2e-6)
    there, turned = work_on_chain(TIP, path)
    back, _ = work_on_chain(TIP, path[::-1])
    assert there == pytest.approx(-back, rel=1e-6)
    assert abs(there) > 0.01 * turned
