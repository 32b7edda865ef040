"""Outcomes of the dome's stability map."""

import math
from pathlib import Path

import pytest

from benchmarks.model import dome_map as dome
from benchmarks.model.dome_map import Grid, cells, draw_dome, outcome, report, settings

SMALL = Grid(("plane", "ball"), (0.7,), (1e9,), (100e-6, 400e-6))


def test_the_worst_outcome_counts() -> None:
    assert outcome(0.01, 0.0, 0) == "accurate"
    assert outcome(0.01, 0.5, 0) == "accurate, steps halved"
    assert outcome(0.03, 0.5, 0) == "inaccurate"
    assert outcome(0.01, 0.5, 1) == "not converged"
    assert outcome(math.nan, 0.0, 0) == "not judged"


def test_long_steps_are_inaccurate_and_short_ones_are_not(tmp_path: Path) -> None:
    plane, ball = settings(SMALL)[:2], settings(SMALL)[2:]
    found = [*cells(plane), *cells(ball)]
    assert [cell.outcome for cell in found] == ["accurate", "inaccurate"] * 2
    short, long = found[2:]
    assert short.error < 0.01 < 0.03 < long.error
    told = report(found)
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
    (cell,) = cells([dome.DomeSetting("plane", 0.7, 1e9, 4e-4)])
    assert (cell.outcome, cell.note) == ("not converged", "no")
