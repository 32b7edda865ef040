"""Rows of speed: what is said of made points, and of runs that no clock decides."""

import pytest

from benchmarks import speed as bench_speed
from benchmarks.speed import STAGES, frame_parts
from chromagrip import UserError
from chromagrip.loop.fidelity import Choice, Fidelity
from chromagrip.measure.charts.chart import Chart, Point
from chromagrip.measure.charts.loop import AXES
from chromagrip.scene.scene import Scene, load_scene


def point(name: str, time: float, error: float, settings: str = "tracker a") -> Point:
    """Point of the loop's chart."""
    return Point(
        name=name,
        times=[time],
        errors={"margin_error": error, "displacement": 0.01},
        ours=name == "ours",
        settings=settings,
    )


def test_the_fastest_that_reads_as_well_is_told() -> None:
    """Not the fastest of all, nor one that has the truth."""
    points = [
        point("ours", 10.0, 0.05),
        point("equal", 8.0, 0.05),
        point("worse", 5.0, 0.09),
        point("wrong", 2.0, 0.2),
        point("told", 1.0, 0.01, "path truth"),
    ]
    chart = Chart(part="loop", title="", per="frame", points=points, axes=AXES)
    rows = {row.name: row for row in bench_speed._chart_rows(chart)}
    assert rows["speed/best-error/equal/speed"].value == pytest.approx(125.0)
    assert rows["speed/best-error/equal/speed"].met
    assert rows["speed/error-0.10/worse/speed"].value == pytest.approx(200.0)
    assert not rows["speed/error-0.10/worse/speed"].met
    assert rows["speed/default/ours/margin_error"].value == 0.05


def test_a_plan_that_misses_its_tolerance_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is refused, each object is run once for all tolerances; two thirds are kept."""
    fidelity, ran = Fidelity(), []

    def planned(tolerance: float, scene: Scene) -> Choice:
        return Choice(
            fidelity=fidelity, changes=fidelity.changes, milliseconds=1.0, error=tolerance, lines=()
        )

    def error(chosen: Fidelity, obj: dict[str, float]) -> float:
        ran.append(chosen)
        return 0.08

    monkeypatch.setattr(Fidelity, "auto", staticmethod(planned))
    monkeypatch.setattr(bench_speed, "_error", error)
    rows = {row.name: row for row in bench_speed._planned_rows()}
    assert rows["speed/plan/held"].value == pytest.approx(200.0 / 3.0)
    assert not rows["speed/plan/held"].met
    assert len(ran) == rows["speed/plan/planned"].value / 3.0  # type: ignore[operator]


def test_every_stage_of_a_frame_takes_its_time() -> None:
    scene = load_scene("margin-60hz", {"duration_s": 0.1})
    parts = frame_parts(scene)
    assert tuple(parts) == STAGES
    assert all(parts[stage] > 0.0 for stage in STAGES[:-1])


def test_a_grasp_tells_its_time_and_memory() -> None:
    seconds, megabytes = bench_speed._grasp(["--path", "truth", "--set=duration_s=0.05"])
    assert seconds > 0.1
    assert 50.0 < megabytes < 4000.0
    with pytest.raises(UserError, match="--path nowhere failed: "):
        bench_speed._grasp(["--path", "nowhere"])
