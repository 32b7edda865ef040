"""Noise of Γ that a scene asks for, without pictures."""

import numpy as np
import pytest

from chromagrip.control import GripObservation
from chromagrip.model import ForceField
from chromagrip.sensing.observers import _with_margin_noise


def test_an_interval_holds_the_margin_as_often_as_it_says() -> None:
    mu, deviation, field = 0.5, 0.04, ForceField(
        position=np.zeros((2, 2)),
        normal=np.array([1.0, 3.0]),
        friction=np.array([0.4, 0.8]),
        contact=np.ones(2, dtype=bool),
        totals_covariance=np.zeros((2, 2)),
    )  # fmt: skip
    margin = field.safety_margin(mu)
    exact = GripObservation(
        time=0.0, field=field, friction=mu, friction_interval=(mu, mu), friction_observable=True,
        margin=margin, margin_interval=(margin, margin), lateral_displacement=0.0,
    )  # fmt: skip
    assert exact.margin == pytest.approx(1.0 - 1.2 / (mu * 4.0))
    drawn = np.random.default_rng(1).standard_normal(4000)
    noisy = [_with_margin_noise(exact, deviation, one) for one in drawn]
    errors = np.array([one.margin - exact.margin for one in noisy])
    np.testing.assert_allclose(errors, deviation * drawn, rtol=0, atol=1e-12)
    held = [low <= exact.margin <= high for low, high in (one.margin_interval for one in noisy)]
    assert np.mean(held) == pytest.approx(0.9, abs=0.015)
    (variance,) = {round(one.field.totals_covariance[1, 1], 12) for one in noisy}
    assert variance == pytest.approx((mu * 4.0 * deviation) ** 2)
