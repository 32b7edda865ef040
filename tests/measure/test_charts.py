"""Charts of speed against accuracy: the front, the page, and the points of each stage."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.__main__ import load
from chromagrip.measure.bench.force import Speed
from chromagrip.measure.bench.force_sets import GraspTask, Measured
from chromagrip.measure.charts import force as chart_force
from chromagrip.measure.charts.chart import Point, front
from chromagrip.measure.engine import measure
from chromagrip.measure.study import Asked
from chromagrip.measure.worlds.force_scores import Answers
from chromagrip.measure.worlds.grasps import LIBRARY


def made_point(name: str, time: float, error: float) -> Point:
    """Point of one error, with turns around its time."""
    errors = {"e": error}
    return Point(name=name, times=[0.9 * time, time, 2.0 * time], errors=errors, ours=False)


@given(
    st.lists(
        st.tuples(st.floats(0.01, 1e3), st.floats(1e-6, 1e3)), min_size=1, max_size=12, unique=True
    )
)
def test_the_front_is_a_front(told: list[tuple[float, float]]) -> None:
    """Its errors fall as time rises, and each point left out is beaten by one in it."""
    points = [made_point(str(k), time, error) for k, (time, error) in enumerate(told)]
    best = front(points, "e")
    assert all(
        a.milliseconds <= b.milliseconds and a.errors["e"] > b.errors["e"]
        for a, b in pairwise(best)
    )
    assert all(
        any(a.milliseconds <= b.milliseconds and a.errors["e"] <= b.errors["e"] for a in best)
        for b in points
    )


def test_a_chart_has_errors_beside_the_constant_and_the_limit() -> None:
    true = np.array([[1.0, 0.2, 0.5, 0.6], [2.0, 0.4, 0.6, 0.7], [4.0, 1.0, 0.4, 0.3]])
    value = true + np.array([0.1, 0.0, 0.0, 0.02])
    said = Answers(value=value, interval=np.stack([value] * 2, axis=-1), flagged=true[:, 0] < 0.0)
    found = Measured(
        true=true,
        answers={
            "single": {"sequential": said},
            "0.1s": {"sequential": said},
            "way": {"way": replace(said, value=true)},
        },
        limit={"single": 0.01 * true, "0.1s": 0.005 + 0.0 * true, "way": np.nan * true},
    )
    task = GraspTask(world="matched", kind=LIBRARY, index=0, reconstructors={}, limited=True)
    times = Speed({}, 3), [("sequential", [1.0, 2.0, 4.0]), ("way", [8.0, 9.0, 9.0])]
    names = {"sequential": "sequential", "way": "way"}
    chart = chart_force._chart([(task, found), times], names, 1)
    rows = {row.name: row.value for row in chart.rows()}
    assert rows["force/sequential/time"] == 2.0
    assert rows["force/sequential/single/margin_rms"] == pytest.approx(0.02)
    assert rows["force/way/0.1s/margin_rms"] == rows["force/way/single/margin_rms"] == 0.0
    assert rows["force/constant/0.1s/margin_rms"] == pytest.approx(true[:, 3].std())
    assert rows["force/limit/single/normal_rms"] == pytest.approx(1.0)
    assert rows["force/limit/0.1s/margin_rms"] == pytest.approx(0.005)


@pytest.mark.studies
def test_a_chart_of_a_stage_is_drawn_and_more_work_is_less_wrong(tmp_path: Path) -> None:
    out = tmp_path / "new"
    load()
    report = measure("project", "chart-model", Asked(quick=True), out=out)
    rows = {row.name: row.value for row in report.rows}
    assert len([name for name in rows if name.endswith("/time")]) >= 4
    values = {name: value for name, value in rows.items() if value is not None and value > 0.0}
    assert values.keys() == rows.keys()
    slow, fast = (f"model/251 nodes, {step} ms" for step in ("2", "10"))
    assert values[f"{slow}/normal_error"] < values[f"{fast}/normal_error"]
    ends = sorted(path.suffix for path in out.iterdir())
    assert ends == [".csv", ".html", ".json", ".png", ".svg"]
    assert all(path.stat().st_size for path in out.iterdir())
