import numpy as np
import pytest

from chromagrip.model import ForceField
from chromagrip.tracking import FrictionEstimate, core_quantile, max_ratio


def field(ratios: np.ndarray, load: np.ndarray | None = None) -> ForceField:
    normal = np.full(len(ratios), 0.05) if load is None else load
    return ForceField(
        position=np.zeros((len(ratios), 2)),
        normal=normal,
        friction=ratios * normal,
        contact=normal > 0.005,
        totals_covariance=np.zeros((2, 2)),
    )


def test_quantile_is_not_drawn_up_by_noise_where_the_maximum_is() -> None:
    """All nodes slip at µ = 0.5; 9 mN of noise on forces of 50 mN (facts of the error budget)."""
    rng = np.random.default_rng(0)
    largest, upper = [], []
    for _ in range(200):
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
    estimate = FrictionEstimate(max_ratio, window=0.05, observable_below=np.inf)
    for k in range(100):
        value, (low, high) = estimate.update(0.01 * k, field(np.full(9, 0.3 + 0.01 * (k % 5))))
    assert value == pytest.approx(0.32)
    assert low < value < high


def test_friction_is_held_while_it_cannot_be_seen() -> None:
    """Slipping shows µ; once the margin is above 0.85, ratios near ν say nothing about it."""
    estimate = FrictionEstimate(core_quantile, window=0.05, observable_below=0.85)
    press = np.array([-0.4, -0.4, -0.3, 0.0, 0.0, 0.3, 0.4, 0.4])
    before, _ = estimate.update(0.0, field(press))
    assert before == pytest.approx(0.4)  # stands in until something better is known
    seen, _ = estimate.update(0.01, field(np.full(8, 0.7)))
    assert seen == pytest.approx(0.7)
    held, _ = estimate.update(0.02, field(press))
    assert held == pytest.approx(0.7)
    late, _ = estimate.update(9.0, field(press))
    assert late == pytest.approx(0.7)


def test_nothing_is_known_before_contact() -> None:
    value, (low, high) = FrictionEstimate(max_ratio, 0.1, 0.85).update(0.0, field(np.zeros(0)))
    assert np.isnan([value, low, high]).all()
