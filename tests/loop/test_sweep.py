"""Sweeps: every run once, in any number of processes, resumed where they were interrupted."""

import csv
import math
from dataclasses import replace
from pathlib import Path

import pytest

from chromagrip import UserError, load_scene, run
from chromagrip.measure.engine import FIGURES, UNFINISHED, key_of
from chromagrip.measure.score.intervals import share_interval
from chromagrip.measure.sweep import sweep as swept
from chromagrip.measure.sweep.report import means, sweep_report
from chromagrip.measure.sweep.runs import Plan, SweepCell, SweepRun, tasks
from chromagrip.measure.sweep.sweep import MAP, RUNS, sweep
from chromagrip.measure.worlds.scorecard import scores

QUICK = {"path": "truth", "duration_s": 0.1, "truth.margin_noise": 0.02}
KI, MU = "safety_margin.integral_n_per_s", "object.friction"
PLAN = Plan(
    scenes=("camera-100hz", "jerk-1"),
    axes=((KI, (10.0, 40.0)),),
    seeds=1,
    fixed=QUICK | {"seed": 1, MU: 0.4},
)


def lines_of(folder: Path) -> list[dict[str, str]]:
    with (folder / RUNS).open(newline="") as file:
        return list(csv.DictReader(file))


def test_every_combination_is_run_once_and_scored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An interrupted sweep goes on with what is missing, to the same report."""
    made: list[SweepRun] = []
    real = swept.cell

    def interrupted(task: SweepRun) -> SweepCell:
        if len(made) == 3:
            raise KeyboardInterrupt
        made.append(task)
        return real(task)

    monkeypatch.setattr(swept, "cell", interrupted)
    with pytest.raises(KeyboardInterrupt):
        sweep(PLAN, tmp_path, False, 1)
    assert {path.name for path in tmp_path.iterdir()} == {UNFINISHED}
    more: list[SweepRun] = []
    monkeypatch.setattr(swept, "cell", lambda task: more.append(task) or real(task))
    report = sweep(PLAN, tmp_path, False, 1)
    assert len(more) == 1
    assert more[0] not in made
    lines = {(one["scene"], one["seed"], float(one[KI])): one for one in lines_of(tmp_path)}
    assert lines.keys() == {(name, "1", ki) for name in PLAN.scenes for ki in (10.0, 40.0)}
    assert {path.name for path in tmp_path.iterdir()} == {RUNS, MAP, FIGURES, "index.html"}
    expected = scores(run(load_scene("jerk-1", QUICK | {KI: 40.0, MU: 0.4, "seed": 1})))
    # Γ has not settled at the end of so short a run: there is no time after which it had.
    expected["settling"] = math.inf
    one = lines["jerk-1", "1", 40.0]
    assert {name: float(one[name]) for name in expected} == expected
    assert len(report.tables[0].lines) == 2
    assert sweep(PLAN, None, False, 1) == report
    with pytest.raises(UserError, match="is not empty"):
        sweep(PLAN, tmp_path, False, 1)


def test_what_decides_a_run_is_in_its_key() -> None:
    def keys(plan: Plan) -> set[str]:
        return set(map(key_of, tasks(plan)))

    assert keys(PLAN) < keys(replace(PLAN, seeds=3))
    assert not keys(PLAN) & keys(replace(PLAN, fixed=QUICK | {"duration_s": 0.3}))


def made(gross: float, settling: float, failed: str = "") -> SweepCell:
    return SweepCell(scene="s", setting="", seed=0, failed=failed, gross=gross, settling=settling)


def test_failed_runs_count_as_lost_and_not_in_means() -> None:
    cells = [made(0.0, 0.2), made(1.0, 0.4), made(math.nan, math.nan, "gave up")]
    assert means(cells)["settling"] == pytest.approx((0.3, 0.2, 0.4))  # mean, low, high
    report = sweep_report(Plan(scenes=("s",), fixed={}), cells)
    assert {row.score: row.value for row in report.rows}["lost"] == 2
    assert any("gave up" in note for note in report.notes)
    # A run that never settles spoils no mean.
    assert means([made(0.0, 0.2), made(0.0, math.inf)])["settling"][0] == 0.2


def test_what_settles_is_the_controllers_own_target() -> None:
    """A loop that aims at 0.5 has settled there, as one that aims at 0.3 has there."""
    changes = {"path": "truth", "duration_s": 1.5, "fingertip.nodes": 101, "load.times_s": [0.0]}
    changes |= {"load.forces_n": [0.25], "safety_margin.desired_margin": 0.5}
    result = run(load_scene("camera-100hz", changes))
    assert result.trace["margin_true"][-1] == pytest.approx(0.5, abs=0.05)
    assert scores(result)["settling"] < 1.0


def test_the_interval_of_a_share_is_wilsons() -> None:
    """Where the score test of its ends has the 5 % quantile, from both sides."""
    for hits, count in ((0, 81), (3, 10), (7, 7)):
        for end in share_interval(hits, count):
            if 0.0 < end < 1.0:
                score = (hits / count - end) / math.sqrt(end * (1.0 - end) / count)
                assert abs(score) == pytest.approx(1.6449, abs=1e-4)
    assert share_interval(0, 81)[1] == pytest.approx(0.0323, abs=1e-4)


def test_scenes_of_one_finger_and_of_two_are_swept_apart() -> None:
    with pytest.raises(UserError, match="sweep them apart"):
        tasks(Plan(scenes=("thesis", "pinch-lift"), seeds=1, fixed={"path": "truth"}))
