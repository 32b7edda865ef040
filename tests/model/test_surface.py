"""Surfaces that travel with a sliding object, and surfaces that stay."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.model.integrators import integrate
from chromagrip import model

TIP = model.Fingertip(nodes=101)
BALL = model.ContactObject(stiffness=1000.0, curvature=100.0, friction=0.3, surface="stays")
SURFACES: tuple[model.Surface, ...] = ("travels", "stays")


def dragged(obj: model.ContactObject, grip: float = 1.0) -> model.History:
    """Pressed for 0.2 s, then dragged along x by 3 mm in 0.6 s and held there; every 0.1 s."""
    drive = model.Drive(
        times=[0.0, 0.2, 0.8, 1.0],
        normal=[0.0, grip, grip, grip],
        lateral=[0.0, 0.0, 3e-3, 3e-3],
        lateral_control="position",
    )
    return model.simulate(TIP, obj, drive, dt=1e-3, duration=1.0, every=100)


def middle(obj: model.ContactObject, run: model.History, k: int) -> float:
    """Centre of the normal forces along x, in the ground frame [m]."""
    field = model.contact_forces(TIP, obj, run.state(k))
    return float(field.normal @ field.position[:, 0] / field.normal.sum())


def test_no_normal_force_changes_while_an_object_slides_under_a_surface_that_stays() -> None:
    run = dragged(BALL)
    before, after = (model.contact_forces(TIP, BALL, run.state(k)) for k in (6, 8))
    for field in (before, after):  # all of the contact slides
        ratio = field.friction[field.contact] / field.normal[field.contact]
        assert ratio == pytest.approx(BALL.friction, rel=1e-3)
    assert run.pose[8, 1] - run.pose[6, 1] == pytest.approx(1e-3)
    assert after.normal == pytest.approx(before.normal, abs=1e-6 * before.normal.max())


def test_a_surface_that_travels_takes_the_contact_along() -> None:
    obj = replace(BALL, surface="travels")
    run = dragged(obj, 0.1)  # so light that neither circle is pressed flat
    moved = middle(obj, run, 8) - middle(obj, run, 6)
    # Where two circles touch is on the line of their centres.
    share = TIP.radius / (TIP.radius + 1.0 / obj.curvature)
    assert moved == pytest.approx(share * 1e-3, rel=0.05)


@pytest.mark.parametrize("patches", [(), ((-1e-3, 0.5), (1e-3, 1.5))])
def test_a_flat_object_knows_no_difference(patches: tuple[tuple[float, float], ...]) -> None:
    flat = model.ContactObject(friction=0.3, patches=patches)
    one, other = (dragged(replace(flat, surface=surface)) for surface in SURFACES)
    for name in ("nodes", "pose", "friction", "slip_rate", "rate"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    state = one.state(8)
    mu = [model.node_friction(TIP, replace(flat, surface=surface), state) for surface in SURFACES]
    np.testing.assert_array_equal(*mu)


@pytest.mark.parametrize("curvature", [100.0, -50.0])
def test_friction_alone_carries_the_load_on_a_surface_that_stays(curvature: float) -> None:
    obj = replace(BALL, curvature=curvature)
    state = model.equilibrium(TIP, obj, 2.0, 0.4)
    field = model.contact_forces(TIP, obj, state)
    away = TIP.rest_positions() + state.deformation.nodes - [0.0, TIP.radius + 1.0 / curvature]
    normal = np.sign(curvature) * away / np.linalg.norm(away, axis=1, keepdims=True)
    tangent = np.column_stack([-normal[:, 1], normal[:, 0]])
    assert field.friction @ tangent[:, 0] == pytest.approx(0.4, abs=1e-5)
    total = field.normal @ normal + field.friction @ tangent
    assert total[1] == pytest.approx(-2.0, abs=1e-5)


@pytest.mark.parametrize("surface", SURFACES)
def test_without_friction_only_a_surface_that_travels_pushes_its_object(
    surface: model.Surface,
) -> None:
    """On the flank of the dome its slope does; the other takes no part in the object's motion."""
    obj = replace(BALL, friction=1e-9, surface=surface)
    state = dragged(obj).state(-1)
    later = model.step(TIP, obj, replace(state, step=0.0), 1e-4, 1.0, 0.0)
    moved = later.deformation.object_position - state.deformation.object_position
    if surface == "travels":
        centres = TIP.radius + 1.0 / obj.curvature
        lateral = 1.0 * 3e-3 / np.sqrt(centres**2 - 3e-3**2)  # grip · tan of the line of centres
        assert moved == pytest.approx(1e-4 * lateral / obj.drag, rel=0.2)
    else:
        assert abs(moved) < 1e-6 * 1e-4 / obj.drag


def test_an_independent_method_slides_a_surface_that_stays_alike() -> None:
    tip = model.Fingertip(nodes=21)
    obj = model.ContactObject(
        stiffness=300.0, curvature=100.0, friction=0.2, drag=1.0, surface="stays"
    )
    t = np.linspace(0.0, 4e-3, 201)
    rise = np.sin(0.5 * np.pi * t / 4e-3) ** 2
    drive = model.Drive(times=t, normal=rise, lateral=0.5 * rise)

    def final(obj: model.ContactObject, dt: float, how: str) -> model.History:
        every = round(4e-3 / dt)
        return integrate(how, tip, obj, drive, dt=dt, duration=4e-3, every=every)

    fine = final(obj, 1e-6, "implicit")
    found = final(obj, 2e-6, "euler")
    other = final(replace(obj, surface="travels"), 1e-5, "implicit")
    assert fine.pose[-1, 1] > 0.2e-3
    scale = abs(fine.nodes[-1]).max()
    assert abs(found.nodes[-1] - fine.nodes[-1]).max() < 2e-3 * scale
    assert found.pose[-1, 1] == pytest.approx(fine.pose[-1, 1], rel=2e-3)
    assert abs(other.nodes[-1] - fine.nodes[-1]).max() > 1e-2 * scale
