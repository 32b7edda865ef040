"""Surfaces: flat, convex, hollow, and points."""

import numpy as np
import pytest

from chromagrip.model import ContactObject, Drive, Fingertip, contact_forces, equilibrium, simulate
from chromagrip.model.chain.assembly import contact
from chromagrip.model.kernels.contact import contact_frames

TIP = Fingertip(nodes=101)


def arc(radius: float, points: int = 201) -> tuple[tuple[float, float], ...]:
    """Profile of a round object (negative radius: hollow), from its lowest point's height."""
    x = np.linspace(-0.6, 0.6, points) * min(abs(radius), 12e-3)
    z = radius - np.sign(radius) * np.sqrt(radius**2 - x**2)
    return tuple(zip(x.tolist(), (z + 0.123).tolist(), strict=True))


@pytest.mark.parametrize("radius", [20e-3, 10e-3, -30e-3])
def test_points_of_a_circle_are_that_circle(radius: float) -> None:
    exact = ContactObject(stiffness=300.0, curvature=1 / radius)
    drawn = ContactObject(stiffness=300.0, profile=arc(radius))
    a, b = (equilibrium(TIP, obj, 1.0, 0.2) for obj in (exact, drawn))
    assert b.deformation.nodes == pytest.approx(a.deformation.nodes, abs=1e-7)
    assert b.friction == pytest.approx(a.friction, abs=1e-4)


@pytest.mark.parametrize("curvature", [-60.0, 0.0, 80.0])
def test_objects_touch_at_rest_and_no_more(curvature: float) -> None:
    gap, _ = contact_frames(
        contact(TIP, ContactObject(curvature=curvature)), TIP.rest_positions(), 0.0
    )
    assert gap.min() == pytest.approx(0.0, abs=1e-12)


def test_gap_and_normal_of_points_are_the_distance_and_its_gradient() -> None:
    obj = ContactObject(
        profile=tuple((x, 2e-3 * np.cos(x / 2e-3)) for x in np.linspace(-9e-3, 9e-3, 91))
    )
    ct = contact(TIP, obj)
    rng = np.random.default_rng(0)
    x = rng.uniform(-6e-3, 6e-3, 50)
    on_curve = np.column_stack([x, 2e-3 * np.cos(x / 2e-3) + ct.lift])
    points = on_curve - [0.0, 2e-4]
    _, normal = contact_frames(ct, points, 0.0)
    assert np.linalg.norm(normal, axis=1) == pytest.approx(np.ones(50))
    for k, nudge in enumerate(1e-8 * np.eye(2)):
        slope = (
            contact_frames(ct, points + nudge, 0.0)[0] - contact_frames(ct, points - nudge, 0.0)[0]
        ) / 2e-8
        assert slope == pytest.approx(normal[:, k], abs=1e-5)


def test_a_ridge_is_felt_where_it_is() -> None:
    """A bump 1 mm beside the middle carries more than the flat on the other side."""
    x = np.linspace(-8e-3, 8e-3, 161)
    profile = tuple(zip(x, -0.2e-3 * np.exp(-(((x - 1e-3) / 0.4e-3) ** 2)), strict=True))
    obj = ContactObject(profile=profile)
    t = np.array([0.0, 0.2, 0.6])
    hold = Drive(times=t, normal=[0.0, 2.0, 2.0], lateral=np.zeros(3), lateral_control="position")
    run = simulate(TIP, obj, hold, dt=2e-3, duration=0.6, every=300)
    field = contact_forces(TIP, obj, run.state(-1))
    place = field.position[:, 0]
    at_bump, mirrored = (field.normal[abs(place - at) < 0.3e-3].sum() for at in (1e-3, -1e-3))
    assert at_bump > 1.3 * mirrored


def test_an_axial_spring_pressed_at_the_apex_is_hookes_law() -> None:
    """Without membrane only the apex carries, as one spring with the contact in series."""
    tip = Fingertip(nodes=11, law="axial", membrane_stiffness=1.0)
    obj = ContactObject(stiffness=1000.0)
    share = 250 / 10
    grip = 0.2
    state = equilibrium(tip, obj, grip)
    k = tip.tissue_stiffness * share
    assert state.deformation.rigid_part == pytest.approx(
        grip / k + grip / (1000.0 * share), rel=1e-3
    )


@pytest.mark.parametrize("obj", [ContactObject(curvature=100.0), ContactObject(profile=arc(0.01))])
def test_normal_contact_gives_all_work_back(obj: ContactObject) -> None:
    """Penalty contact has a potential: a closed path through the surface does no work."""
    ct = contact(TIP, obj)
    rng = np.random.default_rng(1)
    t = np.linspace(0.0, 2 * np.pi, 20001)
    path = np.column_stack(
        [
            1e-3 * (rng.normal() * np.sin(t) + rng.normal() * np.cos(2 * t)),
            TIP.radius + 4e-4 * (rng.normal() * np.cos(t) + rng.normal() * np.sin(3 * t)),
        ]
    )
    gap, normal = contact_frames(ct, path, 0.0)
    assert gap.min() < 0.0 < gap.max()
    force = obj.stiffness * np.maximum(0.0, -gap)[:, None] * normal
    parts = (0.5 * (force[1:] + force[:-1]) * np.diff(path, axis=0)).sum(axis=1)
    assert abs(parts.sum()) < 1e-5 * abs(parts).sum()
