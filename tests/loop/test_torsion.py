"""Force, torque, and the margin of friction and torsion together, of contacts that are known."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from chromagrip import Result, UserError, load_scene, run
from chromagrip.control import GripObservation
from chromagrip.model import ForceField, torsion
from chromagrip.sensing.margins import held, with_limit_margin
from chromagrip.sensing.observers import ForceObserver
from chromagrip.tracking import Z90

from .test_observers import CALIBRATION, TRACKS, Known

#: Force [N] and radius [m] of a contact of Hertz, and µ.
NORMAL, RADIUS, MU = 2.0, 3e-3, 0.5
#: Torsion at which it turns [N·m].
BOUND = 3.0 * math.pi / 16.0 * MU * NORMAL * RADIUS


def hertz(pull: float = 0.0, twist: float = 0.0, deviation: float = 0.0) -> ForceField:
    """Contact of Hertz with shares of the friction that it bears as a pull and as a twist.

    Parameters
    ----------
    pull, twist: shares; the twist turns at each place with the friction there
    deviation: standard deviation of the torque [N·m]
    """
    # Rings of equal force from the middle of equal angles: sums are exact in the angle.
    force = (np.arange(400) + 0.5) / 400
    radius = RADIUS * np.sqrt(1.0 - (1.0 - force) ** (2.0 / 3.0))
    angle = 2.0 * math.pi * np.arange(24) / 24
    r, phi = (each.ravel() for each in np.meshgrid(radius, angle, indexing="ij"))
    count = len(r)
    normal = np.full(count, NORMAL / count)
    around = np.stack([-np.sin(phi), np.cos(phi), np.zeros(count)], axis=-1)
    friction = MU * normal[:, None] * (pull * np.array([1.0, 0.0, 0.0]) + twist * around)
    return ForceField(
        position=np.stack([r * np.cos(phi), r * np.sin(phi), np.full(count, 0.02)], axis=-1),
        normal=normal,
        friction=friction,
        contact=np.ones(count, bool),
        totals_covariance=np.zeros((2, 2)),
        directions=np.tile([0.0, 0.0, -1.0], (count, 1)),
        wrench_covariance=np.diag([0.0, 0.0, 0.0, deviation**2]),
    )


def seen(field: ForceField, mu: float = MU, mu_deviation: float = 0.0) -> GripObservation:
    margin = field.safety_margin(mu)
    spread = Z90 * mu_deviation * field.total_friction / (mu**2 * field.total_normal)
    return with_limit_margin(
        GripObservation(
            time=0.0,
            field=field,
            friction=mu,
            friction_interval=(mu - Z90 * mu_deviation, mu + Z90 * mu_deviation),
            friction_observable=True,
            margin=margin,
            margin_interval=(margin - spread, margin + spread),
            lateral_displacement=math.nan,
        )
    )


def test_a_contact_of_hertz_that_turns_has_no_margin() -> None:
    """It bears 3π/16·µ·P·a, of which Γ knows nothing."""
    observation = seen(hertz(twist=1.0))
    assert observation.torque == pytest.approx(BOUND, rel=2e-3)
    assert MU * torsion(observation.field)[2] == pytest.approx(BOUND, rel=2e-3)
    assert observation.margin == pytest.approx(1.0, abs=1e-9)
    assert observation.limit_margin == pytest.approx(0.0, abs=1e-6)
    assert held(observation, "smaller").margin == observation.limit_margin
    assert seen(hertz(twist=0.4)).limit_margin == pytest.approx(0.6, abs=1e-6)


def test_without_torque_it_is_the_margin_of_friction() -> None:
    for pull in (0.0, 0.3, 0.99):
        observation = seen(hertz(pull=pull))
        assert observation.limit_margin == pytest.approx(observation.margin, abs=1e-9)
        # Never more, be it by the end of a search.
        assert observation.limit_margin <= observation.margin
    chain = ForceObserver(CALIBRATION, TRACKS, Known, window=0.1).observe(0.0, TRACKS)
    assert with_limit_margin(chain) is chain
    assert held(chain, "smaller") is chain
    assert np.isnan([*chain.force, *chain.force_deviation, chain.torque]).all()


def test_pull_and_torsion_together_ask_for_more_than_each() -> None:
    both = seen(hertz(pull=0.5, twist=0.5)).limit_margin
    # No node is above its own bound, so all is borne; each alone leaves one half.
    assert 0.0 < both < 0.5 - 0.05


def test_more_grip_is_more_margin() -> None:
    field = hertz(pull=0.4, twist=0.5)
    margins = [seen(replace(field, normal=f * field.normal)).limit_margin for f in (1.0, 1.5, 2.0)]
    assert margins == sorted(margins)
    # At the same radius what is borne grows with the grip.
    assert 1.0 - margins[2] == pytest.approx(0.5 * (1.0 - margins[0]), rel=1e-6)


def test_the_interval_holds_the_errors_of_torque_and_friction() -> None:
    deviation = 0.1 * BOUND
    observation = seen(hertz(twist=0.5, deviation=deviation))
    assert observation.torque_deviation == pytest.approx(deviation)
    half = Z90 * 0.1
    expected = (observation.limit_margin - half, observation.limit_margin + half)
    assert observation.limit_margin_interval == pytest.approx(expected, rel=3e-3)
    # A µ that is off by a share is as much of the share that is used.
    unsure = seen(hertz(twist=0.5), mu_deviation=0.1 * MU)
    low, high = unsure.limit_margin_interval
    assert high - low == pytest.approx(2.0 * Z90 * 0.1 * 0.5, rel=3e-3)
    # A torque that is not known at all may be what little is left.
    blind = seen(hertz(pull=0.5, deviation=BOUND))
    assert blind.limit_margin == pytest.approx(0.5)
    assert blind.limit_margin_interval[0] < 0.0
    exact = seen(hertz(pull=0.5, twist=0.5))
    assert exact.limit_margin_interval == pytest.approx((exact.limit_margin,) * 2)


def test_the_stiffness_is_an_error_of_force_and_torque() -> None:
    class Dome(Known):
        def __init__(self, *_: object) -> None:
            self.field = hertz(pull=0.4, twist=0.5)

    known = replace(CALIBRATION, stiffness_deviation=0.08)
    observer = ForceObserver(known, TRACKS, Dome, window=0.1)
    observation = observer.observe(0.0, TRACKS)
    np.testing.assert_allclose(observation.force, [0.4 * MU * NORMAL, 0.0, -NORMAL], atol=1e-12)
    np.testing.assert_allclose(observation.force_deviation, 0.08 * abs(observation.force))
    assert observation.torque_deviation == pytest.approx(0.08 * observation.torque)


def ran(**changes: Any) -> Result:
    """A coarse dome whose object is pulled, then twisted, on the truth path."""
    keys = {
        "dome.pitch_mm": 0.8,
        "duration_s": 1.2,
        "object.drag_n_s_per_m": 10.0,
        "load.interpolation": "linear",
        "load.times_s": [0.0, 0.1, 0.3, 0.8],
        "load.forces_n": [0.0, 0.25, 0.25, 0.25],
        "load.twists_nmm": [0.0, 0.0, 0.0, 0.6],
    }
    return run(load_scene("dome-1", keys | changes))


@pytest.mark.parametrize("controller", ["safety-margin", "margin-inversion"])
def test_the_smaller_margin_is_held(controller: str) -> None:
    trace = ran(controller=controller).trace
    known = trace["time_s"] > 0.9
    # µ is read low by what sticks at the rim, so that the grip is on the safe side.
    assert trace["limit_margin_estimated"][known] == pytest.approx(0.3, abs=0.05)
    assert trace["limit_margin_true"][-1] > 0.25
    assert trace["margin_estimated"][-1] > 0.45
    assert trace["torque_estimated_nmm"][-1] == pytest.approx(0.6, rel=0.03)
    assert trace["force_z_true_n"][-1] == pytest.approx(-trace["grip_n"][-1], rel=0.02)


def test_the_margin_of_friction_alone_lets_the_object_turn() -> None:
    kept, turned = ran(), ran(held_margin="friction")
    assert turned.trace["margin_estimated"][-1] == pytest.approx(0.3, abs=0.05)
    assert turned.trace["limit_margin_true"][-1] < 0.1
    assert abs(turned.summary["final_turn_deg"]) > 3.0 * abs(kept.summary["final_turn_deg"])


def test_a_chain_has_no_torsion_to_hold() -> None:
    with pytest.raises(UserError, match=r"held_margin = 'friction' is for body = .dome."):
        load_scene("thesis", {"held_margin": "friction"})
