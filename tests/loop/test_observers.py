"""Observations: Γ, µ and their intervals, of a force field that is known."""

from dataclasses import replace

import numpy as np
import pytest

from chromagrip import load_scene, run
from chromagrip.control import GripObservation
from chromagrip.model import ForceField, FrictionReading
from chromagrip.render import load_sensor
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


def test_rigid_slip_is_what_the_object_slides_in_millimetres() -> None:
    """0.8 N on 0.5 N of friction slides by (0.8 − 0.5)/120 = 2.5 mm/s against the drag."""
    changes = {
        "path": "truth",
        "controller": "conservative",
        "conservative.force_n": 1.0,
        "load.times_s": [0.1],
        "load.forces_n": [0.8],
        "duration_s": 0.8,
    }
    result = run(load_scene("camera-100hz", changes))
    time, slip = result.trace["time_s"], result.trace["rigid_slip_mm"]
    later = time > 0.5
    assert np.diff(slip[later]) == pytest.approx(0.025, rel=0.02)
    assert result.summary["rigid_slip_mm"] == slip[-1]
