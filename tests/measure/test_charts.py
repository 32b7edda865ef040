"""Charts of speed against accuracy: the front, the page, and the points of each stage."""

import csv
import re
import shutil
import subprocess
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.lines import Line2D
from matplotlib.text import Text

from benchmarks.__main__ import load
from chromagrip import UserError
from chromagrip.measure.bench.force import Speed
from chromagrip.measure.bench.force_sets import GraspTask, Measured
from chromagrip.measure.charts import force as chart_force
from chromagrip.measure.charts import force_dome
from chromagrip.measure.charts.chart import Axis, Chart, Peer, Point, front
from chromagrip.measure.charts.drawing import draw
from chromagrip.measure.charts.loop import settings as settings_of_the_loop
from chromagrip.measure.charts.page import write_chart
from chromagrip.measure.engine import measure
from chromagrip.measure.study import Asked, studies
from chromagrip.measure.worlds.dome.readings import Reading
from chromagrip.measure.worlds.dome.sets import DomeResult, by_set
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


def test_a_chart_is_drawn_with_a_tooltip_on_every_point(page: Path) -> None:
    root = ElementTree.parse(page.with_name("made.svg")).getroot()
    titles = {
        group.get("id"): group.findtext("{http://www.w3.org/2000/svg}title")
        for group in root.iter("{http://www.w3.org/2000/svg}g")
        if re.match("(point|peer)-", group.get("id") or "")
    }
    assert len(titles) == 2 * 4 + 1
    told = titles["point-0-2"] or ""
    for text in ("set as <c>", "3 ms a frame (2.7 to 6)", "error: 4", "chromagrip chart c"):
        assert text in told
    assert "slip: 8" in (titles["point-1-2"] or "")
    assert "measured & told elsewhere" in (titles["peer-0-0"] or "")
    with page.with_name("made.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["name"], row["front of e"]) for row in rows] == [
        ("a", "1"), ("b", "1"), ("c", "0"), ("d", "1"),
    ]  # fmt: skip
    assert (float(rows[0]["milliseconds"]), float(rows[0]["slowest"])) == (1.0, 2.0)
    assert page.with_name("made.png").stat().st_size > 0


def test_labels_overlap_neither_each_other_nor_points() -> None:
    """All of them find room, also where points are close together."""
    points = [made_point(f"method {k}", 5.0 + 0.05 * k, 2.0 + 0.03 * k) for k in range(12)]
    figure = draw(replace(made_chart(), points=points), "")
    figure.draw_without_rendering()  # where the labels are in the end
    for panel, peers in zip(figure.axes, (1, 0), strict=True):
        named = [text for text in panel.texts if text.get_text() != "limit"]
        assert len(named) == len(points) + peers
        boxes = [Text.get_window_extent(text) for text in panel.texts]
        assert all(not a.overlaps(b) for a, b in combinations(boxes, 2))
        places = panel.transData.transform([(p.milliseconds, p.errors["e"]) for p in points])
        if peers:
            assert not any(box.contains(*place) for box in boxes for place in places)


def test_the_legend_of_a_chart_explains_every_mark() -> None:
    """Colour, shape and filling of each point, and each line, are in it."""
    figure = draw(made_chart(), "")
    (legend,) = figure.legends

    def look(line: Line2D) -> tuple[object, ...]:
        shown = line.get_marker(), line.get_color(), line.get_linestyle()
        return (*shown, line.get_markerfacecolor() if shown[0] != "None" else "")

    told = {look(line) for line in legend.get_lines()}
    drawn = {look(line) for panel in figure.axes for line in panel.lines}
    assert drawn <= told
    texts = [text.get_text() for text in legend.get_texts()]
    assert "limit: least error" in texts
    assert len(texts) == len(set(texts)) == len(told) == len(drawn) + 1  # the bar is no line


def test_the_page_holds_all_that_it_shows(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    nodes = list(ElementTree.fromstring(text).iter())  # well-formed
    loaded = {
        value
        for node in nodes
        for name, value in node.attrib.items()
        if name.rpartition("}")[2] in ("src", "href") and not value.startswith("#")
    }
    assert loaded == set()
    cells = {"".join(node.itertext()) for node in nodes if node.tag.rpartition("}")[2] == "td"}
    for point in made_chart().points:
        assert {point.name, point.settings, point.command} <= cells
    assert {"9 *", "4"} <= cells
    assert text.count("<title>") == 1 + 2 * 4 + 1
    assert "measured &amp; told elsewhere" in text


@pytest.mark.studies
def test_the_page_opens_from_disk(page: Path) -> None:
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
    if browser is None:
        pytest.skip("no Chromium is installed; `apt install chromium` brings one")
    command = [browser, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom", page.as_uri()]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout
    assert shown.count("set as &lt;c&gt;") >= 3


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
@pytest.mark.parametrize("part", ["chart-model", "chart-dome", "track"])
def test_a_stage_yields_its_points(part: str, tmp_path: Path) -> None:
    """More work is never drawn as less wrong than the truth it is measured against."""
    out, verb = tmp_path / "new", "chart" if part == "track" else "project"
    load()
    report = measure(verb, part, Asked(quick=True), out=out)
    rows = {row.name: row.value for row in report.rows}
    assert len([name for name in rows if name.endswith("/time")]) >= 4
    values = {name: value for name, value in rows.items() if value is not None and value > 0.0}
    assert values.keys() == rows.keys()
    if part == "chart-model":
        slow, fast = (f"model/251 nodes, {step} ms" for step in ("2", "10"))
        assert values[f"{slow}/normal_error"] < values[f"{fast}/normal_error"]
    elif part == "chart-dome":
        coarse, fine = (f"model-dome/{pitch} mm, 5 ms/place_error" for pitch in ("0.8", "0.6"))
        assert 1.5 * values[fine] < values[coarse] < 10.0
    else:
        limit = values["track/Cramér–Rao/clean/rms"]
        assert values["track/fit/clean/rms"] > 0.8 * limit
        assert values["track/chromatouch/clean/rms"] > 5.0 * values["track/fit/clean/rms"]
    ends = sorted(path.suffix for path in out.iterdir())
    assert ends == [".csv", ".html", ".json", ".png", ".svg"]
    assert all(path.stat().st_size for path in out.iterdir())


@pytest.mark.parametrize(
    ("quick", "chosen", "others"),
    [
        (False, (), {"dome-2020", "dome-2022", "chromatouch-next"}),
        (True, (), set()),
        (False, ("sequential",), set()),
    ],
)
def test_a_chart_of_domes_has_all_that_read_them(
    quick: bool, chosen: tuple[str, ...], others: set[str]
) -> None:
    """Errors are those of the frames that are not flagged; the constant answer is the mean."""
    true = np.array([[1.0, 0.2, 0.5, 0.6], [2.0, 0.4, 0.5, 0.6], [4.0, 1.0, 0.5, 0.5]])
    off = np.array([0.1, 0.2, 4.0])  # the last one is flagged
    value = true + off[:, None] * [1.0, 0.0, 0.0, 0.3]
    answers = Answers(
        value=value,
        interval=np.stack([value - 1.0, value + 1.0], axis=-1),
        flagged=np.array([False, False, True]),
    )
    side = np.zeros((3, 2))
    spent = np.array([0.02, np.nan, 0.04])
    said = Reading(
        answers=answers, side=side, spent=spent, each=np.zeros(0), late=np.zeros(3, bool)
    )
    study = force_dome.dome_chart(Asked(quick=quick, methods=chosen))
    assert {task.design for task in study.settings} == {"thesis", *others}
    results = [
        (task, DomeResult(true=true, side=side, readings=dict.fromkeys(task.reconstructors, said)))
        for task in study.settings
    ]
    once = {task.design: (task, result) for task, result in results}
    chart = force_dome._chart(by_set(list(once.values())), 1)
    names = [*chosen] or ["sequential", "contact"]
    assert [point.name for point in chart.points] == names
    for point in chart.points:
        assert point.times == [20.0, 40.0]
        assert point.errors["normal_error"] == pytest.approx(10.0)  # of 1 N and of 2 N
        assert point.errors["margin_error"] == pytest.approx(0.3 * np.sqrt(0.025))
        assert "33 % of the frames flagged" in point.settings
    lines = {axis.key: axis.lines["constant"] for axis in chart.axes}
    assert lines["margin_error"] == pytest.approx(np.std(true[:, 3]))
    assert len(chart.axes[0].peers) == (3 if others else 0)


def test_every_stage_has_a_chart() -> None:
    assert set(studies("chart")) == {"track", "force", "loop"}
    assert len(settings_of_the_loop(False)) >= 8


def test_nobody_is_no_reconstructor(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no reconstructor 'nobody'"):
        measure("chart", "force", Asked(methods=("nobody",)), out=tmp_path / "new")
