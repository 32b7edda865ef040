"""Printed figures of the thesis that statics alone must give (E3–E7)."""

import numpy as np
import pytest

from chromagrip import model

TIP = model.Fingertip()
#: As rigid as matters: ten times more changes the width by less than a node.
RIGID = 1e6


def pressed(obj: model.ContactObject, grip: float, load: float = 0.0) -> model.ForceField:
    return model.contact_forces(TIP, obj, model.equilibrium(TIP, obj, grip, load))


def test_statics_balance_every_force() -> None:
    field = pressed(model.ContactObject(), 5.0, 0.65)
    assert field.normal.sum() == pytest.approx(5.0, abs=1e-6)
    assert field.friction.sum() == pytest.approx(0.65, abs=1e-5)


def test_statics_are_where_a_slow_run_ends() -> None:
    obj = model.ContactObject(stiffness=160.0, curvature=50.0)
    still = model.equilibrium(TIP, obj, 2.0)
    drive = model.Drive(times=[0.0, 2.0, 4.0], normal=[0.0, 2.0, 2.0], lateral=np.zeros(3))
    slow = model.simulate(TIP, obj, drive, dt=1e-2, duration=4.0, every=400)
    assert slow.nodes[-1] == pytest.approx(still.deformation.nodes, abs=2e-6)


@pytest.mark.parametrize("stiffness", [80.0, 1000.0])
def test_the_largest_grip_presses_the_dome_flat(stiffness: float) -> None:
    """The model itself is near there at 0.6 of it, as its tissue gives way sideways too."""
    obj = model.ContactObject(stiffness=stiffness)
    grip = model.largest_grip(TIP, obj)
    tissue, radius = TIP.tissue_stiffness, TIP.radius
    angle = np.linspace(-np.pi / 2, np.pi / 2, 100_001)
    heights = radius * np.trapezoid(np.cos(angle), angle) * 250 / np.pi
    assert grip == pytest.approx(heights / (1 / tissue + 1 / stiffness), rel=0.01)
    few = model.Fingertip(nodes=51)
    assert model.largest_grip(few, obj) == pytest.approx(grip, rel=0.01)
    state = model.equilibrium(few, obj, 0.6 * grip)
    assert 0.7 * radius < state.deformation.rigid_part < 1.6 * radius


def free_width(obj: model.ContactObject, grip: float) -> float:
    """Deformed distance between the first nodes that do not touch [m]."""
    state = model.equilibrium(TIP, obj, grip)
    touching = np.flatnonzero(model.contact_forces(TIP, obj, state).normal > 0.0)
    x = TIP.rest_positions()[:, 0] + state.deformation.nodes[:, 0]
    return float(x[touching[-1] + 1] - x[touching[0] - 1])


def test_rigid_contact_is_that_of_a_parabola_on_a_bed_of_springs() -> None:
    """Without friction and membrane: F = k_int/p·∫(δ − x²/2r) dx, so a³ = 1.5·F·r·p/k_int."""
    obj = model.ContactObject(stiffness=RIGID, friction=1e-9)
    state = model.equilibrium(TIP, obj, 1.0)
    half = (1.5 * TIP.radius * TIP.pitch / TIP.tissue_stiffness) ** (1 / 3)
    touching = model.contact_forces(TIP, obj, state).normal > 0.0
    x = (TIP.rest_positions() + state.deformation.nodes)[touching, 0]
    assert np.ptp(x) == pytest.approx(2 * half, abs=2 * TIP.pitch)


def test_printed_widths_are_those_without_friction_to_the_first_free_nodes() -> None:
    """3.3 mm on a rigid surface at 1 N, 5.83 mm and 858 N/m on 1000 N/m at 5 N.

    Between the outermost nodes that touch it is 3.13 and 5.65 mm, with friction 3.01 and 5.72.
    """
    assert free_width(model.ContactObject(stiffness=RIGID, friction=1e-9), 1.0) == pytest.approx(
        3.3e-3, abs=0.05e-3
    )
    soft = free_width(model.ContactObject(friction=1e-9), 5.0)
    assert soft == pytest.approx(5.83e-3, abs=0.05e-3)
    assert 5.0 / soft == pytest.approx(858, rel=0.01)


def test_with_friction_5_83_mm_is_the_touched_length_of_the_dome() -> None:
    field = pressed(model.ContactObject(), 5.0)
    (touching,) = np.nonzero(field.normal > 0.0)
    arc = TIP.arc_lengths()
    length = arc[touching[-1]] - arc[touching[0]]
    assert length == pytest.approx(5.83e-3, abs=0.005e-3)
    assert 5.0 / length == pytest.approx(858, abs=1)


@pytest.mark.parametrize(
    ("grip", "mean", "deviation"),
    [(None, 437, 135), (5.0, 789, 159), (2.5, 501, 104)],
    ids=["safety margin", "conservative", "react to slip"],
)
def test_table_2_from_statics(grip: float | None, mean: float, deviation: float) -> None:
    """E5: final grips alone. The printed width is without friction, deformed, of all that touch."""
    found = []
    for mu in (0.3, 0.5, 0.7):
        for kpa in (200, 32, 16):
            for curvature in (0.0, 50.0, 200.0):
                obj = model.ContactObject(
                    stiffness=model.stiffness_from_young(kpa * 1e3),
                    friction=1e-9,
                    curvature=curvature,
                )
                force = 0.65 / (0.7 * mu) if grip is None else grip
                field = pressed(obj, force)
                touching = field.position[field.normal > 0.0, 0]
                found.append(force / np.ptp(touching))
    assert np.mean(found) == pytest.approx(mean, rel=0.03)
    assert np.std(found, ddof=1) == pytest.approx(deviation, rel=0.05)


@pytest.mark.parametrize("poisson", [0.2, 0.48])
def test_static_press_shows_the_poisson_factor(poisson: float) -> None:
    """E7: with every node sticking, the local ratio is ν."""
    tip = model.Fingertip(poisson_tissue=poisson, poisson_membrane=poisson / 100)
    obj = model.ContactObject(friction=0.9)
    field = model.contact_forces(tip, obj, model.equilibrium(tip, obj, 1.0))
    ratio = (abs(field.friction) / np.maximum(field.normal, 1e-12))[field.contact].max()
    assert ratio == pytest.approx(poisson, rel=0.015)
