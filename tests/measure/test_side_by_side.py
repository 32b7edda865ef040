"""Chain and dome side by side, and the dome against what is published and seen of it."""

import math

import numpy as np
import pytest

from benchmarks.model import side_by_side as page
from benchmarks.model.side_by_side import Press, Side, side_by_side, side_rows
from benchmarks.render.real_press import FLOW, outward_flow, real_presses
from chromagrip.model.shapes import ball, plane
from chromagrip.render import load_sensor

pytestmark = pytest.mark.studies


@pytest.fixture(scope="module")
def sides() -> list[Side]:
    return side_by_side(True)


def test_what_equilibrium_demands_is_the_same(sides: list[Side]) -> None:
    judged = [row for row in side_rows(sides) if row.target is not None]
    assert {row.name for row in judged} == {
        f"bodies/flat/difference/{score}" for score in ("normal", "friction", "margin")
    }
    assert all(row.met for row in judged), judged
    for side in sides:
        assert np.allclose(side.press.force[-1], page.GRIP, rtol=0.03), side.body
        assert (np.diff(side.press.depth) > 0.0).all()


def test_force_grows_with_another_power_of_the_depth(sides: list[Side]) -> None:
    rows = {row.name: row.value or math.nan for row in side_rows(sides)}
    for name in page.OBJECTS:
        assert rows[f"bodies/{name}/chain/power_of_the_depth"] == pytest.approx(1.5, abs=0.05)
        assert rows[f"bodies/{name}/dome/power_of_the_depth"] == pytest.approx(2.1, abs=0.1)
        for body in ("chain", "dome"):
            assert rows[f"bodies/{name}/{body}/off_the_rule"] < 8.0


def test_a_parabola_of_pressure_follows_the_rule() -> None:
    a = np.array([1e-3, 2e-3])
    turned, strip = math.pi * a**2 / 2.0, 4.0 / 3.0 * a  # for a pressure of 1 Pa in the middle
    force = np.full(2, page.FITTED)
    assert page._off_rule(Press(force, a, a, turned / strip)) < 1e-12


def test_the_edge_of_a_pressure_is_found_between_nodes() -> None:
    place = np.linspace(-3e-3, 3e-3, 31)
    force = np.maximum(0.0, 2.05e-3 - abs(place))
    assert page._edge(place, force, 0.2e-3) == pytest.approx(2.05e-3)


def test_the_hue_of_a_press_is_the_published_one() -> None:
    rows = {row.score: row.value for row in real_presses()}
    assert rows["hue_slope"] == pytest.approx(9.2, rel=0.3)
    # A layer bonded to a core moves with its height: (4.4 − 2) mm of 4.4 mm, and some more.
    assert rows["shear_of_the_centroid"] == pytest.approx(0.55, abs=0.12)


def test_the_flow_of_a_real_pair_is_in_range_and_a_ball_has_less() -> None:
    sensor = load_sensor("dome-2020")
    flow = outward_flow(sensor, plane())[1]
    assert (np.diff(flow) > 0.0).all()
    assert flow[0] < FLOW[0] < FLOW[1] < flow[-1]
    assert (outward_flow(sensor, ball(20e-3))[1][10:] < 0.9 * flow[10:]).all()
