"""One table of columns makes traces, summaries, reports and logs of one finger and of two."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from chromagrip import Rig, Scene, load_scene, run
from chromagrip.loop import Sample
from chromagrip.loop.columns import Rows, columns_of, interval_of
from chromagrip.loop.results.log import log_of
from chromagrip.loop.results.report import run_on_page
from chromagrip.loop.results.run_folder import RunRead, read_run
from chromagrip.loop.trace import Spent, make_trace, summarise
from chromagrip.tracking import Z90

COARSE = {
    "path": "truth",
    "sensor": "thesis",
    "dome.pitch_mm": 0.8,
    "duration_s": 0.1,
    "pinch.mass_g": 50.0,
    "pinch.hand_times_s": [0.0, 0.2, 0.6],
    "object.size_mm": [20.0, 20.0, 16.0],
}
#: Columns of a finger that the traces of pinches lacked at first.
LATER = [
    f"{finger}_{name}"
    for finger in ("first", "second")
    for name in (
        *("normal_deviation_n", "friction_deviation_n", "limit_margin_low", "limit_margin_high"),
        *("force_x_deviation_n", "force_y_deviation_n", "force_z_deviation_n"),
        "torque_deviation_nmm",
    )
]


@pytest.fixture(scope="module")
def pinch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run of two fingers through their cameras."""
    folder = tmp_path_factory.mktemp("runs") / "pinch"
    changes = COARSE | {"path": "camera", "camera.rest_frames": 2}
    run(load_scene("pinch-lift", changes), folder)
    return folder


@pytest.mark.loops
def test_a_pinch_has_deviations_and_the_interval_of_the_margin_with_torsion(pinch: Path) -> None:
    table = pq.read_table(pinch / "trace.parquet")
    assert set(LATER) <= set(table.column_names)
    meaning = table.schema.metadata[b"first_normal_deviation_n"].decode()
    assert meaning == "standard deviation of the estimated ΣFn"
    of = read_run(pinch).columns
    for finger in ("first", "second"):
        known = np.isfinite(of[f"{finger}_normal_estimated_n"])
        assert known.any()
        assert (of[f"{finger}_normal_deviation_n"][known] > 0.0).all()
        margin = of[f"{finger}_limit_margin_estimated"]
        low, high = (of[f"{finger}_limit_margin_{end}"] for end in ("low", "high"))
        held = np.isfinite(margin)
        assert held.any()
        assert ((low <= margin) & (margin <= high))[held].all()


@pytest.mark.loops
def test_the_report_of_a_pinch_shades_what_its_trace_knows(pinch: Path) -> None:
    read = read_run(pinch)
    panels = {panel.title: panel for panel in run_on_page(read, "run").panels}
    for finger in ("first", "second"):
        forces = panels[f"contact forces [N], {finger} finger"]
        (normal,) = (curve for curve in forces.curves if curve.label == "ΣFn estimated")
        half = Z90 * read.columns[f"{finger}_normal_deviation_n"]
        assert normal.low is not None
        np.testing.assert_array_equal(normal.low, normal.values - half)
    signals = {signal.topic: signal for signal in log_of(read).signals}
    for topic in ("normal_n", "friction_n", "limit_margin", "margin", "mu"):
        assert signals[f"/second/{topic}/estimated"].low is not None


def test_the_summary_of_a_pinch_says_how_it_was_read(pinch: Path) -> None:
    summary = json.loads((pinch / "summary.json").read_text(encoding="utf-8"))
    assert summary["reconstructor"] == "contact"
    assert summary["stiffness_deviation"] > 0.0
    assert not summary["camera_pose"]["notable"]
    assert "gross_slip" not in summary


def _observed(sample: Sample, low: float) -> Sample:
    """Sample of which Γ is certain and the margin with torsion has this lower end."""
    readings = []
    for reading in sample.readings:
        assert reading.observation is not None
        seen = replace(
            reading.observation,
            margin=0.6,
            margin_interval=(0.5, 0.7),
            limit_margin=0.4,
            limit_margin_interval=(low, 0.5),
        )
        readings.append(replace(reading, observation=seen))
    return replace(sample, readings=tuple(readings))


@pytest.fixture
def doubtful(tmp_path: Path) -> RunRead:
    """Run of a pinch in which the margin with torsion leaves sliding open in one of two frames."""
    rig = Rig(load_scene("pinch-lift", COARSE))
    rig.reset()
    sample = rig.sample(1.0)
    scene = load_scene("pinch-lift", COARSE | {"path": "camera", "duration_s": 1 / 60})
    assert scene.sliding_margin is not None
    rows = Rows(scene)
    lines = [rows.line(_observed(sample, low)) for low in (0.3, scene.sliding_margin - 0.02)]
    trace = make_trace(lines, rows.columns)
    (tmp_path / "scene.toml").touch()
    summary = summarise(scene, trace, Spent(1.0))
    return RunRead(folder=tmp_path, scene=scene, summary=summary, columns=trace.columns)


def test_doubt_in_a_pinch_is_judged_by_the_margin_that_was_held(doubtful: RunRead) -> None:
    page = run_on_page(doubtful, "run")
    assert "In 50 % of the frames the interval of the margin reached down" in " ".join(page.words)
    (shaded,) = (curve for curve in page.panels[0].curves if curve.label == "sliding was possible")
    assert np.isfinite(shaded.values).tolist() == [False, True]
    (signal,) = (s for s in log_of(doubtful).signals if s.topic == "/first/limit_margin/estimated")
    assert signal.low is not None
    assert signal.low[1] < doubtful.columns["first_margin_low"][1]


def test_a_folder_without_the_later_columns_is_shown(pinch: Path) -> None:
    read = read_run(pinch)
    older = replace(read, columns={k: v for k, v in read.columns.items() if k not in LATER})
    page, log = run_on_page(older, "older"), log_of(older)
    assert len(page.panels) == len(run_on_page(read, "run").panels)
    (normal,) = (s for s in log.signals if s.topic == "/first/normal_n/estimated")
    assert normal.low is None


@pytest.mark.parametrize("name", ["camera-100hz", "dome-1"])
def test_what_is_unknown_is_nan(name: str) -> None:
    """Frames from outside have no truth; a chain has no third dimension."""
    scene = load_scene(name, {"path": "truth"})
    rig = Rig(scene)
    rig.reset()
    rig.step(1.0)
    rows = Rows(scene)
    known = dict(zip(rows.columns, rows.line(rig.sample(1.0)), strict=True))
    outside = replace(rig.sample(1.0), truth=None)
    line = dict(zip(rows.columns, rows.line(outside), strict=True))
    for column, value in line.items():
        told = "_true" in column or column in ("applied_n", "load_n", "object_mm", "contact_nodes")
        assert math.isnan(value) or not told, column
        if not math.isnan(value):
            assert value == known[column]
    assert line["normal_estimated_n"] == known["normal_true_n"]
    assert math.isnan(known["force_z_true_n"]) == (scene.body == "chain")
    assert set(columns_of("chain")) < set(columns_of("dome")) == set(rows.columns)


def test_ends_of_an_interval_or_a_deviation() -> None:
    of = {
        "mu_estimated": np.array([0.5]),
        "mu_low": np.array([0.4]),
        "mu_high": np.array([0.7]),
        "normal_estimated_n": np.array([2.0]),
        "normal_deviation_n": np.array([0.1]),
        "margin_true": np.array([0.3]),
    }
    assert interval_of(of, "margin_true") is None
    assert interval_of(of, "mu_estimated") == (of["mu_low"], of["mu_high"])
    low, high = interval_of(of, "normal_estimated_n") or (None, None)
    assert low is not None
    assert high is not None
    # 5 % of a normal distribution lie beyond 1.645 standard deviations.
    assert (low[0], high[0]) == pytest.approx((2.0 - 0.1645, 2.0 + 0.1645), abs=1e-4)


def test_units_stand_in_the_names() -> None:
    units = {name: column.unit for name, column in columns_of("pinch").items()}
    assert units["first_torque_true_nmm"] == "N mm"
    assert units["pressure_kpa"] == "kPa"
    assert units["turn_deg"] == "°"
    assert units["first_contact_nodes"] == units["first_mu_low"] == "1"
    assert columns_of("chain")["pressure_n_per_m"].unit == "N/m"


def test_scenes_name_their_fingers() -> None:
    one, two = load_scene("dome-1"), load_scene("pinch-lift")
    assert isinstance(one, Scene)
    assert "margin_true" in Rows(one).names
    assert "first_margin_true" in Rows(two).names


@pytest.mark.parametrize("scene", ["dome-1", "pinch-lift"])
def test_a_missing_estimate_is_not_a_force_of_zero(scene: str) -> None:
    changes = COARSE if scene == "pinch-lift" else {"path": "truth", "dome.pitch_mm": 0.8}
    loaded = load_scene(scene, changes)
    rig, rows = Rig(loaded), Rows(loaded)
    rig.reset()
    sample = rig.sample(1.0)
    reading = sample.readings[0]
    assert reading.observation is not None
    silent = replace(reading, observation=replace(reading.observation, no_estimate="imitated"))
    one = replace(sample, readings=(silent, *sample.readings[1:]))
    known, line = (dict(zip(rows.columns, rows.line(each), strict=True)) for each in (sample, one))
    missing = {name for name in line if math.isnan(line[name]) and not math.isnan(known[name])}
    first = "first_" if scene == "pinch-lift" else ""
    sums = {f"{first}normal_estimated_n", f"{first}friction_estimated_n"}
    assert sums <= missing
    # A touch that is not there is an estimate of 0, also where the other finger has none.
    assert all(math.isfinite(v) for n, v in line.items() if n.startswith("second_normal"))


def test_mu_at_the_end_is_unknown_without_an_estimate() -> None:
    scene = load_scene("dome-1", {"path": "truth", "dome.pitch_mm": 0.8})
    rig, rows = Rig(scene), Rows(scene)
    rig.reset()
    line = dict(zip(rows.columns, rows.line(rig.sample(1.0)), strict=True))
    line |= {"mu_estimated": 0.4, "normal_estimated_n": 1.0}
    silent = line | {"normal_estimated_n": math.nan}
    for last, wanted in ((line, 0.4), (silent, None)):
        trace = make_trace([tuple(line.values()), tuple(last.values())], rows.columns)
        assert summarise(scene, trace, Spent(1.0))["final_mu_estimated"] == wanted
