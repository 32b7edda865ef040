"""The dome's stability map: outcomes, and how an interrupted map goes on."""

import math
from pathlib import Path

import pytest

from chromagrip.measure.stability import dome, model
from chromagrip.measure.stability.dome import Cell, Grid, cells, outcome, report, settings
from chromagrip.measure.stability.figures import draw_dome
from chromagrip.measure.stability.parts import stability_model

SMALL = Grid(("plane", "ball"), (0.7,), (1e9,), (100e-6, 400e-6))


def test_the_worst_outcome_counts() -> None:
    assert outcome(0.01, 0.0, 0) == "accurate"
    assert outcome(0.01, 0.5, 0) == "accurate, steps halved"
    assert outcome(0.03, 0.5, 0) == "inaccurate"
    assert outcome(0.01, 0.5, 1) == "not converged"
    assert outcome(math.nan, 0.0, 0) == "not judged"


def test_long_steps_are_inaccurate_and_short_ones_are_not(tmp_path: Path) -> None:
    found = list(cells(settings(SMALL), lambda _: None))
    assert [cell.setting for cell in found] == settings(SMALL)
    assert [cell.outcome for cell in found] == ["accurate", "inaccurate"] * 2
    short, long = found[2:]
    assert short.error < 0.01 < 0.03 < long.error
    told = report(found, True)
    assert [note.split(" (")[0] for note in told.notes] == [
        f"the dome is inaccurate at 400 µm a step on a {shape} of 1e+09 N/m³"
        for shape in ("plane", "ball")
    ]
    draw_dome(found, tmp_path / "map.png", True)
    assert (tmp_path / "map.png").stat().st_size > 5000


def test_a_run_without_solution_is_not_converged(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise dome.ConvergenceError("no")

    monkeypatch.setattr(dome, "simulate_contact", fails)
    (cell,) = cells([dome.Setting("plane", 0.7, 1e9, 4e-4)], lambda _: None)
    assert (cell.outcome, cell.note) == ("not converged", "no")


def test_an_interrupted_map_goes_on_with_the_dome(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    chain = model.Grid(nodes=(21,), stiffness=(160.0,), steps={"implicit": (1e-2,)}, budget=1)
    plan = Grid(("plane",), (0.7,), (1e7, 1e8), (200e-6, 400e-6))
    monkeypatch.setattr(model, "grid", lambda _: chain)
    monkeypatch.setattr(dome, "grid", lambda _: plan)
    out = tmp_path / "map"
    seen: list[str] = []

    def stop_at_the_last(text: str) -> None:
        seen.append(text)
        if "1e+08" in text and "400" in text:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stability_model(True, out, False, stop_at_the_last)
    assert {path.name for path in out.iterdir()} == {"map.unfinished.csv", "dome.unfinished.csv"}
    seen.clear()
    told = stability_model(True, out, False, seen.append)
    assert seen == [
        "dome, plane, n = 0.7, 1e+08 N/m³: fine run",
        "dome, plane, n = 0.7, 1e+08 N/m³, 400 µm a step",
    ]
    names = {"map.csv", "map.png", "dome.csv", "dome.png"}
    assert {path.name for path in out.iterdir()} == names
    assert isinstance(next(iter(dome.cells(settings(plan)[:1], seen.append))), Cell)
    assert {row.subject[0] for row in told.rows} >= {"implicit", "dome"}
