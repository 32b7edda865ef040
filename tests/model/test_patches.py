"""Friction that varies along the surface: balance, cone, drag, and an independent integrator."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.model.integrators import integrate
from chromagrip import model

TIP = model.Fingertip(nodes=101)
STRIPES = tuple((1e-3 * x, 1.4 if x % 2 else 0.6) for x in range(-6, 7))
STRIPED = model.ContactObject(friction=0.5, patches=STRIPES)


def press_and_pull(grip: float, load: float) -> model.Drive:
    return model.Drive(times=[0.0, 0.2, 0.4], normal=[0.0, grip, grip], lateral=[0.0, 0.0, load])


def pulled(obj: model.ContactObject, grip: float, load: float) -> model.History:
    drive = press_and_pull(grip, load)
    return model.simulate(TIP, obj, drive, dt=2e-3, duration=1.0, every=50)


def last(obj: model.ContactObject, run: model.History) -> tuple[np.ndarray, model.ForceField]:
    state = run.state(-1)
    return model.node_friction(TIP, obj, state), model.contact_forces(TIP, obj, state)


@pytest.mark.parametrize("curvature", [0.0, 50.0])
def test_each_node_keeps_its_own_cone(curvature: float) -> None:
    obj = replace(STRIPED, curvature=curvature)
    run = pulled(obj, 2.0, 0.6)
    for k in range(len(run)):
        state = run.state(k)
        field = model.contact_forces(TIP, obj, state)
        assert (
            abs(field.friction) <= model.node_friction(TIP, obj, state) * field.normal + 1e-12
        ).all()
    mu, field = last(obj, run)
    ratio = abs(field.friction[field.contact]) / field.normal[field.contact]
    # One µ for all would be wrong on either side: rough nodes carry more than it, slippery less.
    assert ratio.max() > 0.5 * 1.1
    assert (mu[field.contact] - ratio).min() == pytest.approx(0.0, abs=1e-6)
    assert ratio[mu[field.contact] < 0.5 * 0.8].max() < 0.5 * 0.8


def test_a_node_has_the_friction_of_the_surface_under_it() -> None:
    run = pulled(STRIPED, 2.0, 0.6)
    x, factor = np.array(STRIPES).T
    under = TIP.rest_positions()[:, 0] + run.nodes[-1][:, 0] - run.pose[-1, 1]
    mu, field = last(STRIPED, run)
    assert mu == pytest.approx(0.5 * np.interp(under, x, factor), rel=1e-12)
    holds = (mu * field.normal)[field.contact].sum()
    whole = model.whole_friction(TIP, STRIPED, run.state(-1), field)
    assert field.safety_margin(whole) == pytest.approx(1.0 - 0.6 / holds, abs=2e-3)
    state = model.rest_state(TIP)
    nothing = model.contact_forces(TIP, STRIPED, state)
    assert np.isnan(model.whole_friction(TIP, STRIPED, state, nothing))
    assert model.whole_friction(TIP, model.ContactObject(friction=0.4), state, nothing) == 0.4


def test_too_much_load_slides_at_the_speed_of_the_drag() -> None:
    """v = (F − Σµᵢ·Fn,i)/c, and the object's motion brings other patches under the contact."""
    run = model.simulate(
        TIP, STRIPED, press_and_pull(1.0, 0.8), dt=1e-3, duration=1.0, every=1
    )  # fmt: skip
    seen = set()
    for k in range(600, len(run), 100):
        state = run.state(k)
        field = model.contact_forces(TIP, STRIPED, state)
        holds = float((model.node_friction(TIP, STRIPED, state) * field.normal).sum())
        speed = (run.pose[k, 1] - run.pose[k - 1, 1]) / 1e-3
        assert speed == pytest.approx((0.8 - holds) / STRIPED.drag, rel=0.01)
        whole = model.whole_friction(TIP, STRIPED, state, field)
        assert field.safety_margin(whole) == pytest.approx(0.0, abs=1e-5)
        seen.add(round(whole, 2))
    assert len(seen) > 2


def test_the_dense_baseline_agrees() -> None:
    """Friction in its state, another matrix and another integrator (SciPy's)."""
    tip = model.Fingertip(nodes=21)
    obj = replace(STRIPED, friction=0.1, stiffness=300.0, curvature=50.0)
    t = np.linspace(0.0, 2e-3, 201)
    rise = np.sin(0.5 * np.pi * t / 2e-3) ** 2
    drive = model.Drive(times=t, normal=rise, lateral=0.3 * rise)
    found, fine = (
        integrate(method, tip, obj, drive, dt=dt, duration=2e-3, every=round(2e-3 / dt))
        for method, dt in (("bdf", 1e-3), ("implicit", 1e-6))
    )
    plain = model.simulate(
        tip, replace(obj, patches=()), drive, dt=1e-6, duration=2e-3, every=2000
    )  # fmt: skip
    moved = abs(fine.nodes[-1]).max()
    error = abs(found.nodes[-1] - fine.nodes[-1]).max()
    assert error < 2e-4 * moved
    assert abs(plain.nodes[-1] - fine.nodes[-1]).max() > 10 * error  # patches are felt
