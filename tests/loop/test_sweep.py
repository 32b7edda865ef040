"""Sweeps: every run once, in any number of processes, resumed where they were interrupted."""

import csv
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from chromagrip import UserError, load_scene, run
from chromagrip.control import ConservativeControl, ConservativeSettings
from chromagrip.measure.engine import FIGURES, UNFINISHED, key_of
from chromagrip.measure.score.intervals import share_interval
from chromagrip.measure.sweep import sweep as swept
from chromagrip.measure.sweep.report import means, sweep_report
from chromagrip.measure.sweep.runs import Plan, SweepCell, SweepRun, tasks, words
from chromagrip.measure.sweep.sweep import MAP, RUNS, sweep
from chromagrip.measure.worlds.scorecard import scores
from chromagrip.output.report import table_lines

from .test_pinch import COARSE

Typed = Callable[..., CompletedProcess[str]]
QUICK = {"path": "truth", "duration_s": 0.1, "truth.margin_noise": 0.02}
KI, MU = "safety_margin.integral_n_per_s", "object.friction"
PLAN = Plan(
    scenes=("camera-100hz", "jerk-1"),
    axes=((KI, (10.0, 40.0)),),
    seeds=1,
    fixed=QUICK | {"seed": 1, MU: 0.4},
)
MINE = """
from chromagrip.control import GripCommand

class Mine:
    def __init__(self, gain):
        self.gain = gain
    def reset(self):
        pass
    def command(self, observation):
        if self.gain > 8.0 and observation.time > 0.1:
            raise RuntimeError("too stiff")
        return GripCommand(force=max(0.5, self.gain * observation.field.total_friction))
"""


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
    counted: list[str] = []
    report = sweep(PLAN, tmp_path, False, 1, counted.append)
    assert len(more) == 1
    assert more[0] not in made
    assert counted[-1].endswith(": 4 of 4")
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


@pytest.mark.loops
def test_own_controllers_in_processes(typed: Typed, tmp_path: Path) -> None:
    (tmp_path / "mine_swept.py").write_text(MINE, encoding="utf-8")
    line = "sweep --scene camera-100hz --controller mine_swept:Mine --arg gain=3,5,9 --path truth "
    line += "--set duration_s=0.3 --set load.forces_n=[0.5,0.65] --seeds 2 --workers 2 --out swept"
    done = typed(*line.split(), "--json")
    assert done.returncode == 0, done.stderr
    rows = {row["name"]: row["value"] for row in json.loads(done.stdout)["rows"]}
    name = "controller=mine_swept:Mine controller_arguments.gain"
    assert [rows[f"{name}={gain}/lost"] for gain in (3, 5, 9)] == [0, 0, 2]
    assert rows[f"{name}=9/pressure_max"] is None
    assert rows[f"{name}=5/pressure_max"] > rows[f"{name}=3/pressure_max"]
    (text,) = {one["failed"] for one in lines_of(tmp_path / "swept")} - {""}
    assert text.startswith("controller mine_swept:Mine failed at t = 0.11 s")
    done = typed(*line.split(), "--overwrite")
    assert "A run failed: controller mine_swept:Mine failed" in done.stdout.replace("\n", " ")
    assert "folder swept" in done.stdout


def test_ctrl_c_says_how_to_go_on(typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(task: SweepRun) -> SweepCell:
        raise KeyboardInterrupt

    monkeypatch.setattr(swept, "cell", interrupted)
    done = typed("sweep", "--vary", f"{MU}=0.4,0.5", "--workers", "1", "--out", "swept")
    assert done.returncode == 130
    assert "what is done is in swept; call it again with --out swept to go on" in done.stderr


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--vary object.friction", "--vary object.friction: expected values, such as"),
        ("--vary object.fiction=1,2", "fiction"),
        ("--vary seed=1 --vary seed=2", "seed is varied twice; give all its values"),
        ("--seeds 0", "--seeds 0: expected 1 or more"),
        (f"--vary seed={','.join(map(str, range(400)))} --seeds 300", "too long"),
    ],
)
def test_what_cannot_be_swept_is_refused_before_there_is_a_folder(
    words: str, message: str, typed: Typed, tmp_path: Path
) -> None:
    done = typed("sweep", *words.split())
    assert (done.returncode, done.stdout) == (2, "")
    assert message in done.stderr
    assert list(tmp_path.iterdir()) == []


def made(gross: float, settling: float, failed: str = "") -> SweepCell:
    return SweepCell(scene="s", setting="", seed=0, failed=failed, gross=gross, settling=settling)


def test_failed_runs_count_as_lost_and_not_in_means() -> None:
    cells = [made(0.0, 0.2), made(1.0, 0.4), made(math.nan, math.nan, "gave up")]
    assert means(cells)["settling"] == pytest.approx((0.3, 0.2, 0.4))  # mean, low, high
    report = sweep_report(Plan(scenes=("s",), fixed={}), cells)
    assert {row.score: row.value for row in report.rows}["lost"] == 2
    assert any("gave up" in note for note in report.notes)
    # A run that never settles says so, and spoils no mean.
    cells = [made(0.0, 0.2), made(0.0, math.inf)]
    assert means(cells)["settling"][0] == 0.2
    for some, told in ((cells, "never in 1 of 2"), (cells[1:], "never in 1 of 1")):
        (line,) = sweep_report(Plan(scenes=("s",), fixed={}), some).tables[0].lines
        assert line[2].endswith(told)


def test_what_settles_is_the_controllers_own_target() -> None:
    """A loop that aims at 0.5 has settled there, as one that aims at 0.3 has there."""
    changes = {"path": "truth", "duration_s": 1.5, "fingertip.nodes": 101, "load.times_s": [0.0]}
    changes |= {"load.forces_n": [0.25], "safety_margin.desired_margin": 0.5}
    result = run(load_scene("camera-100hz", changes))
    assert result.trace["margin_true"][-1] == pytest.approx(0.5, abs=0.05)
    assert scores(result)["settling"] < 1.0
    own = load_scene("camera-100hz", {"controller": "mine:Own(desired_margin=0.4)"})
    assert own.target_margin == 0.4
    assert load_scene("camera-100hz", {"controller": "mine:Own"}).target_margin is None
    assert run(load_scene("camera-100hz", QUICK), controller=Aiming).scene.target_margin == 0.2


class Aiming(ConservativeControl):
    """A controller that has a target of its own by default."""

    def __init__(self, desired_margin: float = 0.2) -> None:
        super().__init__(ConservativeSettings(force_n=2.0))
        self.target = desired_margin


def test_the_interval_of_a_share_is_wilsons() -> None:
    """Where the score test of its ends has the 5 % quantile, from both sides."""
    for hits, count in ((0, 81), (3, 10), (7, 7)):
        for end in share_interval(hits, count):
            if 0.0 < end < 1.0:
                score = (hits / count - end) / math.sqrt(end * (1.0 - end) / count)
                assert abs(score) == pytest.approx(1.6449, abs=1e-4)
    assert share_interval(0, 81)[1] == pytest.approx(0.0323, abs=1e-4)


PINCHED = COARSE | {"duration_s": 0.1, "controller": "conservative"}


@pytest.mark.loops
def test_two_fingers_are_swept_by_what_they_lose() -> None:
    plan = Plan(
        scenes=("pinch-lift",),
        axes=(("conservative.force_n", (0.3, 2.0)),),
        seeds=1,
        fixed=PINCHED | {"duration_s": 0.8},
    )
    report = sweep(plan, None, False, 1)
    # Both fingers hold 50 g: 2·µ·N has to be above 0.49 N, with µ = 0.5.
    assert [line[1][:6] for line in report.tables[0].lines] == ["1 of 1", "0 of 1"]
    assert "turn [°]" in report.tables[0].header
    assert "dropped, turned or crushed" in report.notes[0]


def test_a_pinch_that_ends_before_the_lift_is_swept_too_and_apart_from_one_finger() -> None:
    plan = Plan(scenes=("pinch-lift",), seeds=1, fixed=PINCHED)
    (line,) = sweep(plan, None, False, 1).tables[0].lines
    assert line[0].startswith("0 of 1")
    assert "–" in line
    with pytest.raises(UserError, match="sweep them apart"):
        tasks(Plan(scenes=("thesis", "pinch-lift"), seeds=1, fixed={"path": "truth"}))


def test_every_block_of_a_wide_table_names_its_settings() -> None:
    axes = (("controller", ("a", "b")), (KI, (1.0, 2.0)))
    plan = Plan(scenes=("s",), axes=axes, fixed={})
    cells = [
        SweepCell(
            scene="s", setting=words(one), seed=0, gross=0.0, settling=0.1, pressure_max=400.0
        )
        for one in plan.settings()
    ]
    lines = list(table_lines(sweep_report(plan, cells).tables[0], 70))
    blocks = [line for line in lines if line.startswith("controller")]
    assert len(blocks) > 1
    assert all(KI in line for line in blocks)
    assert sum(line.startswith("b ") for line in lines) == 2 * len(blocks)
