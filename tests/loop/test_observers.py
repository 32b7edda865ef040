"""Observations of force fields that are known: Γ, µ, force, torque, torsion and their intervals."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from chromagrip import Result, load_scene, run
from chromagrip.control import GripObservation
from chromagrip.model import ForceField, FrictionReading, torsion
from chromagrip.render import load_sensor
from chromagrip.sensing.margins import finished, held, with_friction_bias, with_limit_margin
from chromagrip.sensing.observers import ForceObserver, margin_deviation, margin_interval
from chromagrip.tracking import Z90, SensorCalibration, Tracks, nominal_calibration

NORMAL, FRICTION = 2.0, 0.6
#: µ that is read, and its standard deviation.
MU, MU_DEVIATION = 0.5, 0.03
#: Of a stiffness that is known.
CALIBRATION = replace(nominal_calibration(load_sensor("thesis")), stiffness_deviation=0.0)
TRACKS = Tracks(
    time=0.0,
    position=np.zeros((2, 1, 2)),
    log_size=np.zeros((2, 1)),
    hue=np.zeros(1),
    visible=np.ones((2, 1), dtype=bool),
    ambiguous=np.zeros((2, 1), dtype=bool),
    last_seen=np.zeros((2, 1)),
    covariance=np.zeros((1, 6, 6)),
)


class Known:
    """A reconstructor that answers the same field of two nodes to every frame."""

    def __init__(self, calibration: SensorCalibration, rest: Tracks) -> None:
        self.field = ForceField(
            position=np.zeros((2, 2)),
            normal=np.array([0.4, 0.6]) * NORMAL,
            friction=np.array([0.5, 0.5]) * FRICTION,
            contact=np.ones(2, dtype=bool),
            totals_covariance=np.zeros((2, 2)),
            friction_reading=FrictionReading(value=MU, deviation=MU_DEVIATION, observable=True),
        )

    def reset(self) -> None:
        """Nothing to forget."""

    def update(self, tracks: Tracks) -> ForceField:
        """The field."""
        return self.field


def observed(calibration: SensorCalibration) -> GripObservation:
    return ForceObserver(calibration, TRACKS, Known, window=0.1).observe(0.0, TRACKS)


def test_the_margin_is_that_of_the_middle_of_the_interval_of_friction() -> None:
    """Γ = 1 − ΣFf/(µ·ΣFn); either end of µ's interval gives another one."""
    observation = observed(CALIBRATION)
    assert observation.friction == pytest.approx(MU)
    low, high = observation.friction_interval
    assert (low, high) == pytest.approx((MU - Z90 * MU_DEVIATION, MU + Z90 * MU_DEVIATION))
    assert observation.margin == pytest.approx(1.0 - FRICTION / (MU * NORMAL), abs=1e-12)
    # dΓ/dµ = ΣFf/(µ²·ΣFn), to first order on both sides.
    spread = Z90 * MU_DEVIATION * FRICTION / (MU**2 * NORMAL)
    expected = (observation.margin - spread, observation.margin + spread)
    assert observation.margin_interval == pytest.approx(expected, rel=1e-9)


def test_forces_are_no_surer_than_the_stiffness_they_were_read_with() -> None:
    """Tissue that is a tenth stiffer makes both sums a tenth too small, nearly together."""
    observation = observed(replace(CALIBRATION, stiffness_deviation=0.1))
    normal, friction = 0.1 * NORMAL, 0.1 * FRICTION
    expected = [[normal**2, 0.95 * normal * friction], [0.95 * normal * friction, friction**2]]
    np.testing.assert_allclose(observation.field.totals_covariance, expected, rtol=1e-12)
    plain = observed(CALIBRATION)
    assert observation.margin == plain.margin
    width, narrow = (np.ptp(o.margin_interval) for o in (observation, plain))
    ratio = 0.1 * FRICTION / (MU * NORMAL)  # of ΣFf to µ·ΣFn, were only one of them off
    alone = np.sqrt(2.0 - 2.0 * 0.95) * ratio
    assert width == pytest.approx(np.hypot(narrow, 2 * Z90 * alone), rel=1e-9)


@pytest.mark.parametrize("deviation", [0.02, 0.4])
def test_the_interval_of_a_doubtful_friction_on_a_dome_is_that_of_its_logarithm(
    deviation: float,
) -> None:
    """Where µ alone is not known, the ends of Γ's interval are the margins at its ends."""
    reading = FrictionReading(value=MU, deviation=deviation * MU, observable=False)
    field = replace(
        Known(CALIBRATION, TRACKS).field,
        position=np.zeros((2, 3)),
        friction=np.array([[0.5, 0.0, 0.0], [0.5, 0.0, 0.0]]) * FRICTION,
        directions=np.array([[0.0, 0.0, 1.0]] * 2),
        friction_reading=reading,
    )
    low, high = margin_interval(field, MU, deviation * MU)
    ends = [field.safety_margin(MU * np.exp(side * Z90 * deviation)) for side in (-1, 1)]
    assert (low, high) == pytest.approx(ends, abs=1e-12)
    spread = Z90 * margin_deviation(field, MU, deviation * MU)
    assert field.safety_margin(MU) - low > spread > high - field.safety_margin(MU)


def test_an_object_that_slides_has_the_speed_of_its_damper() -> None:
    """0.8 N on 0.5 N of friction slides by (0.8 − 0.5)/120 = 2.5 mm/s against the drag."""
    changes = {
        "path": "truth",
        "controller": "conservative",
        "conservative.force_n": 1.0,
        "load.times_s": [0.1],
        "load.forces_n": [0.8],
        "fingertip.nodes": 101,
        "duration_s": 0.6,
    }
    result = run(load_scene("camera-100hz", changes))
    later = result.trace["time_s"] > 0.45
    for column in ("rigid_slip_mm", "lateral_displacement_mm"):
        slip = result.trace[column]
        assert np.diff(slip[later]) == pytest.approx(0.025, rel=0.02), column
        assert result.summary[column] == slip[-1]


#: Radius of a contact of Hertz [m], and torsion at which it turns [N·m].
RADIUS = 3e-3
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


def test_pull_and_torsion_together_ask_for_more_than_each_and_grip_for_less() -> None:
    field = hertz(pull=0.5, twist=0.5)
    # No node is above its own bound, so all is borne; each alone leaves one half.
    assert 0.0 < seen(field).limit_margin < 0.5 - 0.05
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


def test_a_bias_on_friction_stops_at_a_hundredth_and_moves_the_intervals_as_far() -> None:
    plain = seen(hertz(pull=0.4), mu_deviation=0.05)
    share = 0.4 * MU  # ΣFf/ΣFn
    for bias, mu in ((0.3, 0.8), (-2.0, 0.01)):
        biased = with_friction_bias(plain, bias)
        assert (biased.friction, biased.margin) == pytest.approx((mu, 1.0 - share / mu))
        for one, other, moved in (
            (biased.friction_interval, plain.friction_interval, mu - MU),
            (biased.margin_interval, plain.margin_interval, biased.margin - plain.margin),
        ):
            assert np.subtract(one, other) == pytest.approx([moved, moved])
    assert with_friction_bias(replace(plain, margin=math.nan), 0.3).friction == MU


def test_no_interval_exceeds_one_and_an_unknown_end_stays_unknown() -> None:
    wide = replace(seen(hertz(twist=0.4)), margin=0.98, margin_interval=(0.9, 1.04))
    found = finished(wide)
    assert found.margin_interval == (0.9, 1.0)
    assert max(found.limit_margin_interval) <= 1.0
    lost = replace(wide, margin=math.nan, margin_interval=(math.nan, math.nan))
    assert np.isnan(finished(lost).margin_interval).all()


@cache
def ran(controller: str = "safety-margin", held_margin: str = "smaller") -> Result:
    """A coarse dome whose object is pulled, then twisted, on the truth path."""
    changes = {
        "controller": controller,
        "held_margin": held_margin,
        "dome.pitch_mm": 0.8,
        "duration_s": 0.9,
        "object.drag_n_s_per_m": 10.0,
        "load.interpolation": "linear",
        "load.times_s": [0.0, 0.1, 0.2, 0.5],
        "load.forces_n": [0.0, 0.25, 0.25, 0.25],
        "load.twists_nmm": [0.0, 0.0, 0.0, 0.6],
    }
    return run(load_scene("dome-1", changes))


@pytest.mark.parametrize(
    "controller", ["safety-margin", pytest.param("margin-inversion", marks=pytest.mark.loops)]
)
def test_the_smaller_margin_is_held(controller: str) -> None:
    trace = ran(controller).trace
    known = trace["time_s"] > 0.75
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
