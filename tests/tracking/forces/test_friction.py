import numpy as np
import pytest

from chromagrip.model import ForceField, FrictionReading
from chromagrip.tracking import (
    CAMERA_RULE,
    FRICTION,
    THESIS_RULE,
    Z90,
    FrictionEstimate,
    FrictionRule,
    core_quantile,
    max_ratio,
)
from chromagrip.tracking.forces.friction import (
    LARGEST_FRICTION,
    FrictionSettings,
    mostly_slipping,
)

QUANTILE_RULE = FrictionRule(read=FRICTION["core-quantile"], may_fall=mostly_slipping)


def field(ratios: np.ndarray, load: np.ndarray | None = None) -> ForceField:
    normal = np.full(len(ratios), 0.05) if load is None else load
    return ForceField(
        position=np.linspace([-1.5e-3, 8e-3], [1.5e-3, 8e-3], len(ratios)),
        normal=normal,
        friction=ratios * normal,
        contact=normal > 0.005,
        totals_covariance=np.zeros((2, 2)),
    )


def test_quantile_is_not_drawn_up_by_noise_where_the_maximum_is() -> None:
    """All nodes slip at µ = 0.5; 9 mN of noise on forces of 50 mN (facts of the error budget)."""
    rng = np.random.default_rng(0)
    largest, upper = [], []
    for _ in range(60):
        noisy = 0.5 + rng.normal(0, 0.06, 40)
        largest.append(max_ratio(field(noisy)))
        upper.append(core_quantile(field(noisy)))
    assert np.mean(largest) > 0.6
    assert np.mean(upper) == pytest.approx(0.5, abs=0.06)


def test_lightly_loaded_rim_does_not_count() -> None:
    ratios = np.array([5.0, 0.4, 0.4, 0.4, -5.0])
    load = np.array([0.006, 0.05, 0.06, 0.05, 0.006])
    assert core_quantile(field(ratios, load)) == pytest.approx(0.4)
    assert max_ratio(field(ratios, load)) == pytest.approx(5.0)
    assert np.isnan(core_quantile(field(ratios, np.zeros(5))))


def test_average_is_over_the_window_alone() -> None:
    estimate = FrictionEstimate(THESIS_RULE, window=0.05)
    for k in range(100):
        value, (low, high) = estimate.update(0.01 * k, field(np.full(9, 0.3 + 0.01 * (k % 5))))
    assert value == pytest.approx(0.32)
    assert low < value < high


PRESS = np.array([-0.4, -0.4, -0.3, 0.0, 0.0, 0.3, 0.4, 0.4])
SLIP = np.ones(8)
#: A stuck middle and slipping flanks.
HELD = np.array([1.0, 0.9, 0.6, 0.3, 0.3, 0.6, 0.9, 1.0])


def test_friction_is_held_while_it_cannot_be_seen() -> None:
    """Slipping shows µ; once the margin is above 0.85, ratios near ν say nothing about it."""
    estimate = FrictionEstimate(QUANTILE_RULE, window=0.05)
    before, _ = estimate.update(0.0, field(PRESS))
    assert before == pytest.approx(0.4)  # stands in until something better is known
    seen, _ = estimate.update(0.01, field(0.7 * SLIP))
    assert seen == pytest.approx(0.7)
    for time in (0.02, 9.0):
        assert estimate.update(time, field(PRESS))[0] == pytest.approx(0.7)


def settle(estimate: FrictionEstimate, start: float, ratios: np.ndarray) -> float:
    """µ after 0.2 s of one field, four windows."""
    return [estimate.update(start + 0.01 * k, field(ratios))[0] for k in range(20)][-1]


def test_friction_rises_at_once_and_falls_only_where_the_contact_slips() -> None:
    """A contact that sticks again shows less than µ; one that slips shows what µ has become."""
    estimate = FrictionEstimate(QUANTILE_RULE, window=0.05)
    assert settle(estimate, 0.0, 0.4 * SLIP) == pytest.approx(0.4)
    assert settle(estimate, 1.0, 0.6 * HELD) == pytest.approx(core_quantile(field(0.6 * HELD)))
    known = settle(estimate, 2.0, 0.6 * SLIP)
    assert known == pytest.approx(0.6)
    assert settle(estimate, 3.0, 0.45 * HELD) == pytest.approx(0.6)  # healed, not slippery
    assert settle(estimate, 4.0, 0.3 * SLIP) == pytest.approx(0.3)  # moisture


def test_what_is_held_is_less_by_the_error_that_is_stated() -> None:
    """By hand: µ that was seen but may not fall is kept by its mean less its deviation."""
    reading = FrictionReading(value=0.6, deviation=0.1, observable=True)
    later = FrictionReading(value=0.3, deviation=0.1, observable=True)
    shown = iter([reading] * 6 + [later] * 6)
    rule = FrictionRule(read=lambda _: next(shown), may_fall=lambda _: False)
    estimate = FrictionEstimate(rule, window=0.05)
    values = [estimate.update(0.01 * k, field(SLIP)) for k in range(12)]
    assert values[5][0] == pytest.approx(0.6)
    # Five readings of one error count as one: it is common to all.
    assert values[5][1] == pytest.approx((0.6 - Z90 * 0.1, 0.6 + Z90 * 0.1))
    assert values[-1][0] == pytest.approx(0.6 - 0.1)


def test_first_noisy_frames_are_not_held_on_to() -> None:
    """Less than a window of frames is an average, not a memory."""
    estimate = FrictionEstimate(QUANTILE_RULE, window=0.1)
    estimate.update(0.0, field(2.0 * HELD))
    assert settle(estimate, 0.01, 0.5 * HELD) == pytest.approx(
        core_quantile(field(0.5 * HELD)), rel=0.3
    )


def test_the_core_and_its_quantile_are_settings() -> None:
    load = np.array([0.1, 0.1, 0.1, 0.04, 0.04])
    some = field(np.array([0.2, 0.3, 0.4, 0.9, 0.9]), load)
    assert core_quantile(some) == pytest.approx(0.9)
    assert core_quantile(some, FrictionSettings(core_share=0.5)) == pytest.approx(0.35)
    median = FrictionSettings(core_share=0.5, core_quantile=0.5)
    assert core_quantile(some, median) == pytest.approx(0.3)


@pytest.mark.parametrize("name", FRICTION)
def test_a_pure_press_does_not_show_friction(name: str) -> None:
    """Its ratios reach ±ν whatever µ is (E7): no method may call that µ, and all above may be."""
    press = field(np.linspace(-0.4, 0.4, 31))
    assert not FRICTION[name](press).observable
    estimate = FrictionEstimate(
        FrictionRule(read=FRICTION[name], may_fall=mostly_slipping), window=0.1
    )
    for k in range(5):
        value, (_, high) = estimate.update(0.01 * k, press)
    assert not estimate.observable
    if np.isfinite(value):
        assert high == LARGEST_FRICTION


def test_certain_readings_count_more() -> None:
    """Two readings of µ, one four times as certain as the other: weights 16 to 1."""
    readings = iter([(0.4, 0.02), (0.6, 0.08)])

    def read(_: ForceField) -> FrictionReading:
        value, deviation = next(readings)
        return FrictionReading(value=value, deviation=deviation, observable=True)

    estimate = FrictionEstimate(FrictionRule(read=read, may_fall=lambda _: True), window=1.0)
    estimate.update(0.0, field(SLIP))
    value, (low, high) = estimate.update(0.01, field(SLIP))
    assert value == pytest.approx((16 * 0.4 + 0.6) / 17)
    # The larger of their scatter, which is 0.2/√2, and the error that is stated.
    assert (high - low) / 2 == pytest.approx(Z90 * 0.2 / np.sqrt(2))


def test_no_contact_and_a_first_touch_without_friction_say_nothing() -> None:
    value, (low, high) = FrictionEstimate(CAMERA_RULE, 0.1).update(0.0, field(np.zeros(0)))
    assert np.isnan([value, low, high]).all()
    estimate = FrictionEstimate(THESIS_RULE, window=0.05)
    assert np.isnan(estimate.update(0.0, field(np.zeros(1)))[0])
    assert estimate.update(0.01, field(np.array([0.3])))[0] == pytest.approx(0.3)
