"""The controllers of the thesis against their laws; what each does is in test_contract.py too."""

from itertools import pairwise

import numpy as np
import pytest

from chromagrip.control import (
    PRINTED_SETTINGS,
    GripObservation,
    ReactToSlip,
    ReactToSlipSettings,
    SafetyMarginControl,
    SafetyMarginSettings,
)

from . import observed

NAN = float("nan")


def seen(time: float, margin: float, displacement: float = NAN) -> GripObservation:
    """Observation of a Γ, of forces that ask for no grip."""
    return observed.seen(time, margin, normal=0.0, lateral_displacement=displacement)


def test_constant_error_gives_the_pi_law() -> None:
    """F = u + Kp·e + Ki·Σe·T, rising when the margin is too small (E1)."""
    gains = SafetyMarginSettings(proportional_n=0.25, integral_n_per_s=30.0)
    controller = SafetyMarginControl(gains)
    for k in range(5, 25):
        force = controller.command(seen(0.01 * k, 0.1)).force
    assert force == pytest.approx(0.5 + 0.25 * 0.2 + 30.0 * 0.2 * 0.01 * 19)


def test_a_sum_over_samples_is_a_rate_per_second() -> None:
    """Ki = 0.1 per sample of 1 ms is 100 per second (E2): the sampling rate does not matter."""
    for period in (0.01, 0.001):
        controller = SafetyMarginControl(PRINTED_SETTINGS)
        for k in range(round(1.0 / period) + 1):
            force = controller.command(seen(0.1 + k * period, 0.29)).force
        assert force == pytest.approx(0.5 + 2.5 * 0.01 + 100 * 0.01)


def test_the_sum_freezes_at_the_floor() -> None:
    controller = SafetyMarginControl(PRINTED_SETTINGS)
    for k in range(300):
        assert controller.command(seen(0.1 + 0.001 * k, 1.0)).force == 0.1
    # Without wind-up the first sample below the desired margin is answered at once.
    assert controller.command(seen(1.2, 0.1)).force > 0.5


def test_off_before_its_start_and_without_contact() -> None:
    controller = SafetyMarginControl(PRINTED_SETTINGS)
    assert controller.command(seen(0.02, 1.0)).force == 0.5
    assert controller.command(seen(0.5, NAN)).force == 0.5


@pytest.mark.parametrize(("error", "count"), [(0.0, 30), (0.2, 30), (0.2, 31)])
def test_safety_margin_goes_on_from_the_grip_that_doubt_asked_for(error: float, count: int) -> None:
    """When doubt ends, the PI law goes on from the grip with the error of Γ: no step back."""
    settings = SafetyMarginSettings(start_s=0.0, integral_n_per_s=1.0)
    controller, force = SafetyMarginControl(settings), 0.0
    margin, period = settings.desired_margin - error, observed.PERIOD
    for k in range(count):  # the interval of Γ leaves sliding open
        force = controller.command(observed.seen(period * k, margin, half=margin + 0.2)).force
    assert force > settings.feedforward_n + 0.1
    for k in range(count, count + 3):
        after = controller.command(observed.seen(period * k, margin, half=0.001)).force
        assert after - force == pytest.approx(settings.integral_n_per_s * error * period)
        force = after


def test_truth_path_steps_once_per_displacement() -> None:
    controller = ReactToSlip(ReactToSlipSettings())
    path = [0.0, 1.2e-3, 1.31e-3, 1.31e-3, 2.5e-3, 2.62e-3]
    forces = [controller.command(seen(k, 0.0, d)).force for k, d in enumerate(path)]
    assert forces == [0.5, 0.5, 2.5, 2.5, 2.5, 4.5]


def test_a_low_mean_over_the_hold_is_an_event() -> None:
    """Of the frames since the last event or gap that are no older than 0.1 s, by brute force."""
    rng = np.random.default_rng(0)
    margins = rng.normal(0.05, 0.05, 400)
    margins[rng.integers(0, 400, 4)] = NAN
    controller, start, expected = ReactToSlip(ReactToSlipSettings()), 0, []
    for k, margin in enumerate(margins):
        mean = margins[max(k - 10, 0) : k + 1].mean()
        if np.isnan(margin):
            start = k + 1
        elif k - 10 >= start and mean < 0.05:
            start = k + 1
            expected.append(k)
    # An interval of 1 excludes sliding, so that no doubt raises the grip as well.
    certain = [
        observed.seen(0.01 * k, m, normal=0.0, margin_interval=(1.0, 1.0))
        for k, m in enumerate(margins)
    ]
    forces = [0.5] + [controller.command(one).force for one in certain]
    events = [k for k, (one, other) in enumerate(pairwise(forces)) if other > one]
    assert events == expected
    assert len(events) > 8
    assert forces[-1] == 0.5 + 2.0 * len(events)


def test_camera_path_steps_again_while_the_margin_stays_low() -> None:
    """One step may be too little for the load; the ceiling ends it."""
    controller = ReactToSlip(ReactToSlipSettings())
    forces = [controller.command(seen(0.01 * k, 0.0)).force for k in range(200)]
    assert forces[:12] == [0.5] * 10 + [2.5] * 2
    assert (np.diff(np.flatnonzero(np.diff(forces) > 1.0)) >= 10).all()
    assert forces[-1] == controller.settings.grip_first.ceiling_n
