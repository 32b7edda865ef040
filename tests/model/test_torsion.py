"""Torsion of a contact against sums over its nodes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromagrip.model import ForceField
from chromagrip.model.limit_surface import torsion
from chromagrip.model.pinch import Limits, box_body
from chromagrip.model.pinch.outcome import PinchRecord
from chromagrip.scene import load_scene


def field(seed: int) -> ForceField:
    """A contact in the plane of x and y, away from the sensor's axis, with any friction."""
    random = np.random.default_rng(seed)
    position = random.normal([2e-3, -1e-3, 0.0], [1e-3, 2e-3, 0.0], (9, 3))
    return ForceField(
        position=position,
        normal=random.uniform(0.1, 1.0, 9),
        friction=random.normal(0.0, 0.2, (9, 3)) * [1.0, 1.0, 0.0],
        contact=np.ones(9, dtype=bool),
        totals_covariance=np.zeros((2, 2)),
        directions=np.tile([0.0, 0.0, 1.0], (9, 1)),
    )


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50)
def test_the_slope_gives_the_torsion_from_the_wrench(seed: int) -> None:
    """Torque about the centre of pressure = torque about the origin − centre × force."""
    of = field(seed)
    twist, slope, _ = torsion(of)
    force = of.friction.sum(axis=0)
    about_axis = np.cross(of.position, of.friction).sum(axis=0)[2]
    assert twist == pytest.approx(slope @ [*force, about_axis], rel=1e-9, abs=1e-15)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_net_friction_is_what_lies_across_the_mean_normal(seed: int) -> None:
    """Against a projection by QR, on a contact whose normals differ and nodes leave."""
    random = np.random.default_rng(seed)
    directions = random.normal([0.0, 0.0, 2.0], 0.5, (9, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    on = np.arange(9) < 7
    of = replace(
        field(seed), friction=random.normal(0.1, 0.2, (9, 3)), directions=directions, contact=on
    )
    mean = (of.normal[on, None] * directions[on]).sum(axis=0)
    across = np.linalg.qr(np.column_stack([mean, np.eye(3)[:, :2]]))[0][:, 1:]
    expected = across @ (across.T @ of.friction[on].sum(axis=0))
    assert of.net_friction == pytest.approx(expected, abs=1e-12)
    assert of.total_friction == pytest.approx(np.linalg.norm(expected))


EDGES = (0.010, 0.024, 0.052)


def integrated() -> np.ndarray:
    """Moments of inertia of a homogeneous box of 1 kg, by summing over its parts."""
    axes = [(np.arange(200) + 0.5) / 200 * edge - edge / 2 for edge in EDGES]
    x, y, z = (float(np.mean(axis**2)) for axis in axes)
    return np.array([y + z, x + z, x + y])


def test_a_box_turns_as_its_parts_do() -> None:
    assert box_body(1.0, EDGES).inertia == pytest.approx(integrated(), rel=1e-4)


def test_the_object_of_a_scene_turns_as_its_parts_do() -> None:
    changes = {"object.shape": "box", "object.size_mm": [1e3 * edge for edge in EDGES]}
    scene = load_scene("pinch-lift", {**changes, "pinch.mass_g": 50.0, "pinch.inertia_g_mm2": []})
    dome = scene.build_dome()
    pinch = scene.pinch.build(dome, dome, scene.build_solid(), scene.object)
    assert pinch.body.inertia == pytest.approx(0.05 * integrated(), rel=1e-3)


def test_the_worst_of_a_pinch_is_its_outcome() -> None:
    """Crushed is worse than turned, dropped worse than both; each stays once it has happened."""
    limits = Limits(pressure=1e5)
    turned = PinchRecord(largest_turn=1.0)
    both = replace(turned, largest_pressure=2e5)
    assert turned.outcome(limits) == "turned"
    assert both.outcome(limits) == "crushed"
    assert replace(both, dropped=True).outcome(limits) == "dropped"
    assert PinchRecord(turn=1.0).outcome(limits) == "held"  # what counts is the largest so far
