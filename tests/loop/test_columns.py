"""One table of columns makes traces, summaries, reports and logs of one finger and of two."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from chromagrip import Rig, Scene, load_scene, run
from chromagrip.control import GripObservation
from chromagrip.loop import Sample
from chromagrip.loop.columns import Rows, columns_of, interval_of
from chromagrip.loop.results.log import log_of
from chromagrip.loop.results.report import run_on_page
from chromagrip.loop.results.run_folder import RunRead, read_run
from chromagrip.loop.trace import Spent, make_trace, summarise
from chromagrip.tracking import Z90

from .test_pinch import COARSE


@pytest.mark.loops
def test_a_pinch_through_its_cameras_has_intervals_in_trace_report_and_log(tmp_path: Path) -> None:
    changes = COARSE | {"path": "camera", "camera.rest_frames": 2, "duration_s": 0.1}
    run(load_scene("pinch-lift", changes), tmp_path)
    read = read_run(tmp_path)
    of, page = read.columns, run_on_page(read, "run")
    panels = {panel.title: panel for panel in page.panels}
    for finger in ("first", "second"):
        known = np.isfinite(of[f"{finger}_normal_estimated_n"])
        assert known.any()
        assert (of[f"{finger}_normal_deviation_n"][known] > 0.0).all()
        margin = of[f"{finger}_limit_margin_estimated"]
        low, high = (of[f"{finger}_limit_margin_{end}"] for end in ("low", "high"))
        held = np.isfinite(margin)
        assert held.any()
        assert ((low <= margin) & (margin <= high))[held].all()
        forces = panels[f"contact forces [N], {finger} finger"]
        (normal,) = (curve for curve in forces.curves if curve.label == "ΣFn estimated")
        half = Z90 * of[f"{finger}_normal_deviation_n"]
        np.testing.assert_array_equal(normal.low, normal.values - half)
    signals = {signal.topic: signal for signal in log_of(read).signals}
    for topic in ("normal_n", "friction_n", "limit_margin", "margin", "mu"):
        assert signals[f"/second/{topic}/estimated"].low is not None
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert summary["reconstructor"] == "contact"
    assert summary["stiffness_deviation"] > 0.0
    assert not summary["camera_pose"]["notable"]
    assert "gross_slip" not in summary


def sampled(scene: Scene) -> Sample:
    """Sample after a step of a grasp."""
    rig = Rig(scene)
    rig.reset()
    rig.step(1.0)
    return rig.sample(1.0)


def altered(sample: Sample, *which: int, **values: Any) -> Sample:
    """Sample in which some fingers were observed otherwise."""
    readings = list(sample.readings)
    for k in which:
        seen = readings[k].observation
        assert isinstance(seen, GripObservation)
        readings[k] = replace(readings[k], observation=replace(seen, **values))
    return replace(sample, readings=tuple(readings))


def test_doubt_in_a_pinch_is_judged_by_the_margin_that_was_held(tmp_path: Path) -> None:
    """The margin with torsion leaves sliding open in one of two frames; Γ is certain."""
    sample = sampled(load_scene("pinch-lift", COARSE))
    scene = load_scene("pinch-lift", COARSE | {"path": "camera", "duration_s": 1 / 60})
    assert scene.sliding_margin is not None
    rows, lines = Rows(scene), []
    for low in (0.3, scene.sliding_margin - 0.02):
        seen = {"margin": 0.6, "margin_interval": (0.5, 0.7), "limit_margin": 0.4}
        lines.append(rows.line(altered(sample, 0, 1, **seen, limit_margin_interval=(low, 0.5))))
    trace = make_trace(lines, rows.columns)
    (tmp_path / "scene.toml").touch()
    summary = summarise(scene, trace, Spent(1.0))
    doubtful = RunRead(folder=tmp_path, scene=scene, summary=summary, columns=trace.columns)
    page = run_on_page(doubtful, "run")
    assert "In 50 % of the frames the interval of the margin reached down" in " ".join(page.words)
    (shaded,) = (curve for curve in page.panels[0].curves if curve.label == "sliding was possible")
    assert np.isfinite(shaded.values).tolist() == [False, True]
    (signal,) = (s for s in log_of(doubtful).signals if s.topic == "/first/limit_margin/estimated")
    assert signal.low is not None
    assert signal.low[1] < doubtful.columns["first_margin_low"][1]


DOME = {"path": "truth", "dome.pitch_mm": 0.8}


@pytest.mark.parametrize(
    ("name", "changes"), [("camera-100hz", {"path": "truth"}), ("dome-1", DOME)]
)
def test_what_is_unknown_is_nan(name: str, changes: dict[str, Any]) -> None:
    """Frames from outside have no truth; a chain has no third dimension."""
    scene = load_scene(name, changes)
    sample, rows = sampled(scene), Rows(scene)
    known = dict(zip(rows.columns, rows.line(sample), strict=True))
    line = dict(zip(rows.columns, rows.line(replace(sample, truth=None)), strict=True))
    for column, value in line.items():
        told = "_true" in column or column in ("applied_n", "load_n", "object_mm", "contact_nodes")
        assert math.isnan(value) or not told, column
        if not math.isnan(value):
            assert value == known[column]
    assert line["normal_estimated_n"] == known["normal_true_n"]
    assert math.isnan(known["force_z_true_n"]) == (scene.body == "chain")
    assert set(columns_of("chain")) < set(columns_of("dome")) == set(rows.columns)


@pytest.mark.parametrize(
    ("name", "changes", "first"), [("dome-1", DOME, ""), ("pinch-lift", COARSE, "first_")]
)
def test_a_missing_estimate_is_not_a_force_of_zero(
    name: str, changes: dict[str, Any], first: str
) -> None:
    scene = load_scene(name, changes)
    sample, rows = sampled(scene), Rows(scene)
    silent = altered(sample, 0, no_estimate="imitated")
    known, line = (dict(zip(rows.columns, rows.line(s), strict=True)) for s in (sample, silent))
    missing = {name for name in line if math.isnan(line[name]) and not math.isnan(known[name])}
    assert {f"{first}normal_estimated_n", f"{first}friction_estimated_n"} <= missing
    # A touch that is not there is an estimate of 0, also where the other finger has none.
    assert all(math.isfinite(v) for n, v in line.items() if n.startswith("second_normal"))


def test_ends_of_an_interval_or_a_deviation() -> None:
    names = ("mu_estimated", "mu_low", "mu_high", "normal_estimated_n", "normal_deviation_n")
    of = {name: np.array([v]) for name, v in zip(names, (0.5, 0.4, 0.7, 2.0, 0.1), strict=True)}
    assert interval_of(of | {"margin_true": np.array([0.3])}, "margin_true") is None
    assert interval_of(of, "mu_estimated") == (of["mu_low"], of["mu_high"])
    # 5 % of a normal distribution lie beyond 1.645 standard deviations.
    ends = np.ravel(interval_of(of, "normal_estimated_n"))
    assert ends == pytest.approx([2.0 - 0.1645, 2.0 + 0.1645], abs=1e-4)


def test_units_stand_in_the_names() -> None:
    units = {name: column.unit for name, column in columns_of("pinch").items()}
    assert units["first_torque_true_nmm"] == "N mm"
    assert units["pressure_kpa"] == "kPa"
    assert units["turn_deg"] == "°"
    assert units["first_contact_nodes"] == units["first_mu_low"] == "1"
    assert columns_of("chain")["pressure_n_per_m"].unit == "N/m"
