"""The 27 objects on built domes: runs are counted as what they are."""

import json

import pytest

from chromagrip.measure.bench import loop_dome as loop
from chromagrip.measure.bench.loop_dome import SETS, DomeGripRun, GripOutcome, report_of, tasks
from chromagrip.measure.engine import measure
from chromagrip.measure.study import Asked
from chromagrip.output.report import values
from chromagrip.scene.scene import load_scene
from chromagrip.thesis import DESIRED_MARGIN

SET = "chromatouch-2020"
FRAMES = {"frames": 100.0, "outside": 10.0, "unsafe": 5.0, "wrong": 2.0, "flagged": 25.0}


def held(margin: float = 0.3) -> GripOutcome:
    return GripOutcome(lost=False, margin=margin, force=5.0, counts=FRAMES)


LOST = GripOutcome(lost=True, margin=0.0, force=15.0, counts=FRAMES)


def scored(runs: dict[DomeGripRun, GripOutcome | str]) -> dict[str, float | None]:
    return {name[-1]: value for name, value in values(report_of(list(runs.items())).rows).items()}


def test_what_slides_with_the_true_forces_is_told_apart() -> None:
    runs: dict[DomeGripRun, GripOutcome | str] = {
        DomeGripRun(SET, "truth", 0, 0): held(),
        DomeGripRun(SET, "truth", 1, 0): LOST,
        DomeGripRun(SET, "camera", 0, 0): LOST,
        DomeGripRun(SET, "camera", 0, 1): held(),
        DomeGripRun(SET, "camera", 1, 0): LOST,
        DomeGripRun(SET, "camera", 1, 1): "the dome gave up",
    }
    found = scored(runs)
    assert (found["runs"], found["lost"]) == (4.0, 3.0)
    assert (found["lost_by_truth"], found["lost_where_truth_holds"]) == (1.0, 1.0)
    assert found["stopped"] == 1.0


def test_margins_are_judged_of_the_runs_that_hold() -> None:
    runs: dict[DomeGripRun, GripOutcome | str] = {
        DomeGripRun(SET, "camera", 0, 0): held(0.30),
        DomeGripRun(SET, "camera", 1, 0): held(0.44),
        DomeGripRun(SET, "camera", 2, 0): held(0.16),
        DomeGripRun(SET, "camera", 3, 0): held(0.50),
        DomeGripRun(SET, "camera", 4, 0): LOST,
    }
    found = scored(runs)
    assert found["within"] == pytest.approx(75.0)
    assert found["error"] == pytest.approx(0.14)


def test_frames_of_the_camera_alone_are_counted() -> None:
    camera = held()
    truth = camera._replace(counts=dict.fromkeys(FRAMES, 1000.0))
    found = scored(
        {DomeGripRun(SET, "truth", 0, 0): truth, DomeGripRun(SET, "camera", 0, 0): camera}
    )
    assert found["inside"] == pytest.approx(90.0)
    assert found["wrong"] == pytest.approx(2.0)
    assert found["flagged"] == pytest.approx(20.0)


@pytest.mark.parametrize("thing", [0, 13, 26])
def test_the_load_of_a_set_needs_the_grip_that_it_names(thing: int) -> None:
    for name, chosen in SETS.items():
        scene = load_scene(chosen.scene, chosen.changes(thing))
        grip = max(scene.load.forces_n) / (scene.object.friction * (1.0 - DESIRED_MARGIN))
        if chosen.grip is None:
            assert max(scene.load.forces_n) == 2.0
        else:
            assert f"{chosen.grip:g} N" in name
            assert grip == pytest.approx(chosen.grip)
        assert scene.path == "camera"


def test_each_object_is_gripped_with_each_specimen() -> None:
    runs = [task for task in tasks(False) if task.name == SET]
    assert len(runs) == len(set(runs)) == 27 * (1 + SETS[SET].seeds)
    assert len(tasks(True)) == 2 * len(SETS)


def test_the_command_reports_rows_of_each_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop, "grip_of", lambda _: held())
    report = measure("bench", "loop", Asked(quick=True, world="dome"), workers=1)
    assert {row.subject for row in report.rows} == {(name,) for name in SETS}
    assert json.dumps([row.value for row in report.rows])
