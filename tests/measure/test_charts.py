"""Charts of speed against accuracy: the front, the page, and the points of each stage."""

import csv
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.__main__ import load
from chromagrip.measure.bench.force import Speed
from chromagrip.measure.bench.force_sets import GraspTask, Measured
from chromagrip.measure.charts import force as chart_force
from chromagrip.measure.charts.chart import Axis, Chart, Peer, Point, front
from chromagrip.measure.charts.page import write_chart
from chromagrip.measure.engine import measure
from chromagrip.measure.study import Asked
from chromagrip.measure.worlds.force_scores import Answers
from chromagrip.measure.worlds.grasps import LIBRARY
from chromagrip.output.page import write_page


def made_point(name: str, time: float, error: float) -> Point:
    """Point of one error, with turns around its time."""
    return Point(
        name=name,
        times=[0.9 * time, time, 2.0 * time],
        errors={"e": error, "f": 2.0 * error},
        ours=name == "a",
        settings=f"set as <{name}>",
        command=f"chromagrip chart {name}",
    )


def made_chart() -> Chart:
    """Chart of four methods, two errors and one peer."""
    told = (("a", 1.0, 9.0), ("b", 2.0, 3.0), ("c", 3.0, 4.0), ("d", 9.0, 1.0))
    peer = Peer(name="other", milliseconds=30.0, error=6.0, source="measured & told elsewhere")
    axes = (
        Axis(key="e", label="error", unit="px", lines={"limit": 0.5}, peers=(peer,)),
        Axis(key="f", label="slip", unit="mm"),
    )
    return Chart(
        part="made", title="Points", per="frame", points=[made_point(*one) for one in told],
        axes=axes, levels={"limit": "least error"}, compared="told elsewhere",
    )  # fmt: skip


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Page of the made chart, with its pictures and table beside it."""
    path = tmp_path_factory.mktemp("page") / "index.html"
    write_page(path, "Chart", [], [write_chart(made_chart(), path.parent)])
    return path


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


def test_a_chart_is_drawn_with_a_tooltip_on_every_point_and_its_page_holds_all(page: Path) -> None:
    root = ElementTree.parse(page.with_name("made.svg")).getroot()
    titles = {
        group.get("id"): group.findtext("{http://www.w3.org/2000/svg}title") or ""
        for group in root.iter("{http://www.w3.org/2000/svg}g")
        if re.match("(point|peer)-", group.get("id") or "")
    }
    assert len(titles) == 2 * 4 + 1
    for text in ("set as <c>", "3 ms a frame (2.7 to 6)", "error: 4", "chromagrip chart c"):
        assert text in titles["point-0-2"]
    assert "slip: 8" in titles["point-1-2"]
    assert "measured & told elsewhere" in titles["peer-0-0"]
    with page.with_name("made.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert "".join(row["name"] + row["front of e"] for row in rows) == "a1b1c0d1"
    assert (float(rows[0]["milliseconds"]), float(rows[0]["slowest"])) == (1.0, 2.0)
    assert page.with_name("made.png").stat().st_size > 0
    nodes = ElementTree.fromstring(page.read_text(encoding="utf-8")).iter()  # well-formed
    cells = {"".join(node.itertext()) for node in nodes if node.tag.rpartition("}")[2] == "td"}
    for point in made_chart().points:
        assert {point.name, point.settings, point.command, "9 *"} <= cells


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
@pytest.mark.parametrize("part", ["chart-model", "chart-dome"])
def test_a_stage_yields_its_points(part: str, tmp_path: Path) -> None:
    """More work is never drawn as less wrong than the truth it is measured against."""
    out = tmp_path / "new"
    load()
    report = measure("project", part, Asked(quick=True), out=out)
    rows = {row.name: row.value for row in report.rows}
    assert len([name for name in rows if name.endswith("/time")]) >= 4
    values = {name: value for name, value in rows.items() if value is not None and value > 0.0}
    assert values.keys() == rows.keys()
    if part == "chart-model":
        slow, fast = (f"model/251 nodes, {step} ms" for step in ("2", "10"))
        assert values[f"{slow}/normal_error"] < values[f"{fast}/normal_error"]
    else:
        coarse, fine = (f"model-dome/{pitch} mm, 5 ms/place_error" for pitch in ("0.8", "0.6"))
        assert 1.5 * values[fine] < values[coarse] < 10.0
    ends = sorted(path.suffix for path in out.iterdir())
    assert ends == [".csv", ".html", ".json", ".png", ".svg"]
    assert all(path.stat().st_size for path in out.iterdir())
