"""Margins with torsion, against what is known of a contact that is only twisted."""

import math
from dataclasses import replace

import numpy as np
import pytest

from chromagrip.control import GripObservation
from chromagrip.model import ForceField
from chromagrip.sensing.margins import finished, with_limit_margin

MU, OFF = 0.5, 0.2


def twisted(share: float, known: bool) -> GripObservation:
    """A ring of nodes whose friction turns, at a share of µ·Fn; µ is known to 20 %, or exactly."""
    angles = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    field = ForceField(
        position=1e-3 * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1),
        normal=np.ones(12),
        friction=share * MU * np.stack([-np.sin(angles), np.cos(angles), 0.0 * angles], axis=1),
        contact=np.ones(12, dtype=bool),
        totals_covariance=np.zeros((2, 2)),
        directions=np.tile([0.0, 0.0, 1.0], (12, 1)),
    )
    off = 0.0 if known else OFF
    return GripObservation(
        time=0.0,
        field=field,
        friction=MU,
        friction_interval=(MU * (1.0 - off), MU * (1.0 + off)),
        friction_observable=True,
        margin=1.0,
        margin_interval=(1.0, 1.0),
        lateral_displacement=math.nan,
    )


@pytest.mark.parametrize("share", [0.2, 0.6])
def test_an_error_of_friction_is_one_of_the_torsion_that_is_borne(share: float) -> None:
    """The share of the torsion is M/(µ·bound): where µ is off by 20 %, so is the share."""
    found = with_limit_margin(twisted(share, known=False))
    assert found.limit_margin == pytest.approx(1.0 - share, abs=1e-3)
    low, high = found.limit_margin_interval
    assert low == pytest.approx(found.limit_margin - OFF * share, abs=1e-3)
    assert high == pytest.approx(found.limit_margin + OFF * share, abs=1e-3)


def test_a_known_friction_leaves_no_doubt() -> None:
    found = with_limit_margin(twisted(0.4, known=True))
    assert np.ptp(found.limit_margin_interval) < 1e-9


def test_no_interval_exceeds_one_and_an_unknown_end_stays_unknown() -> None:
    wide = replace(twisted(0.4, known=True), margin=0.98, margin_interval=(0.9, 1.04))
    found = finished(wide)
    assert found.margin_interval == (0.9, 1.0)
    assert max(found.limit_margin_interval) <= 1.0
    lost = replace(wide, margin=math.nan, margin_interval=(math.nan, math.nan))
    assert all(math.isnan(end) for end in finished(lost).margin_interval)
