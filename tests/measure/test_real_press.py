"""The dome of silicone against what is published and seen of the dome of 2020."""

import numpy as np
import pytest

from benchmarks.render.real_press import FLOW, outward_flow, real_presses
from chromagrip.model.shapes import ball, plane
from chromagrip.render import load_sensor


@pytest.mark.studies
def test_the_hue_of_a_press_is_the_published_one() -> None:
    rows = {row.score: row.value for row in real_presses()}
    assert rows["hue_slope"] == pytest.approx(9.2, rel=0.3)
    # A layer bonded to a core moves with its height: (4.4 − 2) mm of 4.4 mm, and some more.
    assert rows["shear_of_the_centroid"] == pytest.approx(0.55, abs=0.12)


@pytest.mark.studies
def test_the_flow_of_a_real_pair_is_in_range_and_a_ball_has_less() -> None:
    sensor = load_sensor("dome-2020")
    flow = outward_flow(sensor, plane())[1]
    assert (np.diff(flow) > 0.0).all()
    assert flow[0] < FLOW[0] < FLOW[1] < flow[-1]
    assert (outward_flow(sensor, ball(20e-3))[1][10:] < 0.9 * flow[10:]).all()
