from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chromagrip.control import (
    PRINTED_SETTINGS,
    ConservativeControl,
    ConservativeSettings,
    Controller,
    GripObservation,
    LimitSurfaceControl,
    LimitSurfaceSettings,
    MarginInversion,
    MarginInversionSettings,
    ReactToSlip,
    ReactToSlipSettings,
    SafetyMarginControl,
    SafetyMarginSettings,
)
from chromagrip.model import ForceField

NOTHING = ForceField(
    position=np.zeros((1, 2)),
    normal=np.zeros(1),
    friction=np.zeros(1),
    contact=np.zeros(1, dtype=bool),
    totals_covariance=np.zeros((2, 2)),
)


def seen(time: float, margin: float, displacement: float = float("nan")) -> GripObservation:
    return GripObservation(
        time=time,
        field=NOTHING,
        friction=0.5,
        friction_interval=(0.5, 0.5),
        friction_observable=True,
        margin=margin,
        margin_interval=(margin, margin),
        lateral_displacement=displacement,
    )


EVERY: list[Callable[[], Controller]] = [
    lambda: SafetyMarginControl(PRINTED_SETTINGS),
    lambda: ReactToSlip(ReactToSlipSettings()),
    lambda: ConservativeControl(ConservativeSettings()),
    lambda: MarginInversion(MarginInversionSettings()),
    lambda: LimitSurfaceControl(LimitSurfaceSettings()),
]


@pytest.mark.parametrize("make", EVERY)
@given(st.lists(st.floats(-2.0, 1.0) | st.just(float("nan")), min_size=1, max_size=40))
def test_every_controller_is_finite_and_repeats_itself_after_reset(
    make: Callable[[], Controller], margins: list[float]
) -> None:
    controller = make()
    runs = []
    for _ in range(2):
        controller.reset()
        runs.append([controller.command(seen(0.01 * k, m)).force for k, m in enumerate(margins)])
    assert runs[0] == runs[1]
    assert all(np.isfinite(force) and force >= 0 for force in runs[0])


def test_constant_error_gives_the_pi_law() -> None:
    """F = u + Kp·e + Ki·Σe·T, rising when the margin is too small (E1)."""
    gains = SafetyMarginSettings(proportional_n=0.25, integral_n_per_s=30.0)
    controller = SafetyMarginControl(gains)
    for k in range(5, 25):
        force = controller.command(seen(0.01 * k, 0.1)).force
    assert force == pytest.approx(0.5 + 0.25 * 0.2 + 30.0 * 0.2 * 0.01 * 19)


def test_a_sum_over_samples_is_a_rate_per_second() -> None:
    """Ki = 0.1 per sample of 1 ms is 100 per second (E2): the sampling rate does not matter."""

    def after_one_second(period: float) -> float:
        controller = SafetyMarginControl(PRINTED_SETTINGS)
        for k in range(round(1.0 / period) + 1):
            force = controller.command(seen(0.1 + k * period, 0.29)).force
        return force

    assert after_one_second(0.01) == pytest.approx(after_one_second(0.001), rel=1e-6)
    assert after_one_second(0.001) == pytest.approx(0.5 + 2.5 * 0.01 + 100 * 0.01)


def test_the_sum_freezes_at_the_floor() -> None:
    controller = SafetyMarginControl(PRINTED_SETTINGS)
    for k in range(1000):
        assert controller.command(seen(0.1 + 0.001 * k, 1.0)).force == 0.1
    # Without wind-up the first sample below the desired margin is answered at once.
    assert controller.command(seen(1.2, 0.1)).force > 0.5


def test_off_before_its_start_and_without_contact() -> None:
    controller = SafetyMarginControl(PRINTED_SETTINGS)
    assert controller.command(seen(0.02, 1.0)).force == 0.5
    assert controller.command(seen(0.5, float("nan"))).force == 0.5


def test_truth_path_steps_once_per_displacement() -> None:
    controller = ReactToSlip(ReactToSlipSettings())
    path = [0.0, 1.2e-3, 1.31e-3, 1.31e-3, 2.5e-3, 2.62e-3]
    forces = [controller.command(seen(k, 0.0, d)).force for k, d in enumerate(path)]
    assert forces == [0.5, 0.5, 2.5, 2.5, 2.5, 4.5]


def test_camera_path_steps_once_per_low_margin() -> None:
    controller = ReactToSlip(ReactToSlipSettings())
    noise = np.random.default_rng(0).normal(0, 0.03, 220)
    level = np.full(220, 0.4)
    level[50:60], level[120:125], level[150:160] = 0.0, 0.0, 0.0
    forces = [controller.command(seen(0.01 * k, m)).force for k, m in enumerate(level + noise)]
    steps = np.flatnonzero(np.diff(forces) > 1.0) + 1
    assert len(steps) == 2
    assert 50 < steps[0] < 62  # within the hold of 0.1 s and some noise
    assert 150 < steps[1] < 162
    assert forces[-1] == 4.5


def test_camera_path_steps_again_while_the_margin_stays_low() -> None:
    """One step may be too little for the load; the ceiling ends it."""
    controller = ReactToSlip(ReactToSlipSettings())
    forces = [controller.command(seen(0.01 * k, 0.0)).force for k in range(200)]
    assert forces[:12] == [0.5] * 10 + [2.5] * 2
    assert (np.diff(np.flatnonzero(np.diff(forces) > 1.0)) >= 10).all()
    assert forces[-1] == controller.settings.grip_first.ceiling_n


def test_one_low_frame_is_not_slip() -> None:
    controller = ReactToSlip(ReactToSlipSettings())
    margins = [0.3] * 20 + [-0.5] + [0.3] * 20
    assert {controller.command(seen(0.01 * k, m)).force for k, m in enumerate(margins)} == {0.5}


def test_conservative_is_constant() -> None:
    controller = ConservativeControl(ConservativeSettings())
    assert {controller.command(seen(t, m)).force for t, m in ((0, 1.0), (1, -1.0))} == {5.0}
