"""Limit Surface, against the grip at which a contact of Hertz has the desired margin."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chromagrip.control import GripObservation, LimitSurfaceControl, LimitSurfaceSettings
from chromagrip.control.limit_surface import TORSION_POWER, grip_factor
from chromagrip.model import ForceField, margin_within, torsion

from . import observed
from .observed import PERIOD

MU = 0.5
#: Radius of the contact under a grip of 1 N [m], and nodes across it.
RADIUS, ACROSS = 3e-3, 15


def touched(grip: float, pull: float, torque: float) -> ForceField:
    """A flat contact of Hertz under a pull along x [N] and a torque [N·m], far from slipping."""
    radius = RADIUS * grip ** (1.0 / 3.0)
    line = np.linspace(-radius, radius, ACROSS)
    x, y = (each.ravel() for each in np.meshgrid(line, line))
    inside = np.hypot(x, y) < 0.999 * radius
    x, y = x[inside], y[inside]
    pressure = np.sqrt(1.0 - (x**2 + y**2) / radius**2)
    normal = grip * pressure / pressure.sum()
    friction = np.zeros((len(x), 3))
    friction[:, 0] = pull * pressure / pressure.sum()
    turn = torque / (pressure * (x**2 + y**2)).sum()
    friction[:, :2] += turn * pressure[:, None] * np.stack([-y, x], axis=1)
    return ForceField(
        position=np.stack([x, y, np.zeros_like(x)], axis=1),
        normal=normal,
        friction=friction,
        contact=np.ones(len(x), np.bool_),
        totals_covariance=np.zeros((2, 2)),
        directions=np.tile([0.0, 0.0, -1.0], (len(x), 1)),
    )


def seen(time: float, field: ForceField, mu: float = MU) -> GripObservation:
    limit = margin_within(field, mu)
    return observed.seen(
        time,
        limit,
        mu=mu,
        field=field,
        lateral_displacement=0.0,
        limit_margin=limit,
        limit_margin_interval=(limit, limit),
        torsion=torsion(field)[0],
        torsion_borne=mu * torsion(field)[2],
    )


@given(st.floats(0.0, 3.0), st.floats(0.0, 3.0), st.floats(0.05, 0.95))
def test_the_factor_puts_the_load_on_the_surface(pull: float, turn: float, allowed: float) -> None:
    if pull + turn < 1e-3:
        return
    s = grip_factor(pull, turn, allowed)
    assert math.hypot(pull / s, turn / s**TORSION_POWER) == pytest.approx(allowed, rel=1e-6)


@pytest.mark.parametrize(("pull", "torque"), [(0.0, 4e-3), (0.5, 2e-3)])
def test_it_settles_at_the_desired_margin(pull: float, torque: float) -> None:
    controller, grip = LimitSurfaceControl(LimitSurfaceSettings(caution=0.0)), 6.0
    for k in range(150):
        grip = controller.command(seen(PERIOD * k, touched(grip, pull, torque))).force
    assert margin_within(touched(grip, pull, torque), MU) == pytest.approx(0.3, abs=0.02)


def test_torsion_alone_needs_the_grip_of_hertz() -> None:
    """From one frame under a grip of 4 N: torsion borne grows with the grip to the power 4/3."""
    controller = LimitSurfaceControl(LimitSurfaceSettings(caution=0.0, smoothing_s=1e-6))
    field = touched(4.0, 0.0, 2e-3)
    borne = MU * torsion(field)[2]
    grip = controller._grip(seen(0.0, field), MU)
    assert 0.7 * borne * (grip / 4.0) ** TORSION_POWER == pytest.approx(2e-3, rel=0.01)


def test_a_cautious_friction_grips_as_if_it_were_the_true_one() -> None:
    """What the limit surface bears of pull and torsion is in proportion to µ."""
    field = touched(4.0, 0.4, 2e-3)
    settings = LimitSurfaceSettings()
    read, true = (
        LimitSurfaceControl(settings)._grip(seen(0.0, field, mu), 0.35) for mu in (MU, 0.35)
    )
    assert read == pytest.approx(true, rel=1e-4)


@pytest.mark.parametrize("lead", [0.05, 0.15])
def test_rising_torsion_is_gripped_as_what_it_will_be(lead: float) -> None:
    settings = LimitSurfaceSettings(lead_s=lead, caution=0.0)
    rising, there = LimitSurfaceControl(settings), LimitSurfaceControl(settings)
    rate = 10e-3
    for k in range(6):
        grip = rising._grip(seen(PERIOD * k, touched(4.0, 0.0, rate * PERIOD * k)), MU)
    later = rate * (PERIOD * 5 + lead)
    assert grip == pytest.approx(there._grip(seen(0.0, touched(4.0, 0.0, later)), MU), rel=0.02)


def test_a_swing_is_not_expected_to_go_farther_than_the_one_before() -> None:
    controller = LimitSurfaceControl(LimitSurfaceSettings(caution=0.0))
    grips = []
    for k in range(120):
        torque = 2e-3 + 1e-3 * math.exp(-PERIOD * k) * math.sin(2 * math.pi * 3.0 * PERIOD * k)
        grips.append(controller._grip(seen(PERIOD * k, touched(4.0, 0.0, torque)), MU))
    at_peak = LimitSurfaceControl(LimitSurfaceSettings(caution=0.0))
    peak = at_peak._grip(seen(0.0, touched(4.0, 0.0, 1.2 * 3e-3)), MU)
    assert max(grips[:20]) > peak  # the first rise has no swing before it
    assert max(grips[30:]) <= peak
