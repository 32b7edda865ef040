"""Commands around the node models: Appendix B, stability maps, bench rows."""

import json
from pathlib import Path

import pytest

from benchmarks.model.chain_map import ChainCell, ChainGroup, Grid, cells, settings
from chromagrip.errors import UserError
from chromagrip.measure.reproduce.parts import Plan, reproduce
from chromagrip.model import ContactObject, Fingertip
from chromagrip.output.report import values


@pytest.mark.studies
def test_appendix_b_leaves_a_page_with_every_figure(tmp_path: Path) -> None:
    out, plan = tmp_path / "b", Plan(quick=True, camera=None)
    report, sections = reproduce(["appendix-b"], plan, out, False, 1, lambda _: None)
    assert [s.part.removeprefix("figure-") for s in sections] == [
        "20",
        "21",
        "22",
        "24",
        "26",
        "27",
    ]
    page = (out / "index.html").read_text(encoding="utf-8")
    for section in sections:
        assert f'<section id="{section.part}">' in page
        assert (out / f"{section.part}.png").stat().st_size > 5000
    # What the text says and statics must give; Fig. 27's Sensor Model is the known difference.
    assert {section.part for section in sections if not section.agrees} <= {"figure-27"}
    found = values(report.rows)
    ratio = (
        found["fig22", "fingertip", "largest_lateral"]
        / found["fig22", "fingertip", "largest_normal"]
    )  # type: ignore[operator]
    assert ratio == pytest.approx(0.4, rel=0.03)
    json.dumps(report.as_json(), allow_nan=False)
    with pytest.raises(UserError, match="is not empty"):
        reproduce(["appendix-b"], plan, out, False, 1, lambda _: None)


@pytest.mark.parametrize("method", ["euler", pytest.param("rk4", marks=pytest.mark.studies)])
def test_explicit_methods_fail_where_theory_says_and_the_default_does_not(method: str) -> None:
    small = Grid(
        nodes=(21,),
        stiffness=(160.0,),
        steps={"implicit": (1e-3, 1e-2), method: (0.9, 1.5)},
        budget=20_000,
    )
    group = ChainGroup(tuple(settings(small)), small.budget)
    found = {(cell.method, cell.step_s < cell.limit_s): cell for cell in cells(group)}
    assert found[method, True].outcome == "accurate"
    assert found[method, False].outcome in ("chattering", "diverged", "inaccurate")
    assert found["implicit", False].outcome == "accurate"
    assert found["implicit", False].step_s == 1e-2


def test_a_cell_too_costly_for_the_budget_is_not_run() -> None:
    plan = Grid(nodes=(21,), stiffness=(1e6,), steps={"rk4": (0.5,)}, budget=10)
    (cell,) = cells(ChainGroup(tuple(settings(plan)), plan.budget))
    assert isinstance(cell, ChainCell)
    assert cell.outcome == "not run"
    assert "too many evaluations" in cell.note


def test_objects_of_the_bench_are_the_27_of_the_thesis() -> None:
    from benchmarks.model.bench import OBJECTS

    assert len(set(OBJECTS)) == 27
    assert all(isinstance(obj, ContactObject) for obj in OBJECTS)
    assert Fingertip.graded().nodes <= 100
