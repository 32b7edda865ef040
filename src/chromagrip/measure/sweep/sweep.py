"""Front door of a sweep: its runs, resumed where they were interrupted, and its files."""

from collections.abc import Callable
from pathlib import Path

from ...output.cells import write_cells
from ...output.page import PageSection
from ...output.report import Report
from ..engine import run_study
from ..stability.panels import picture_section
from ..study import Study
from .picture import draw_sweep
from .report import sweep_report
from .runs import Plan, SweepCell, cell, tasks, words

#: All runs, and the map.
RUNS, MAP = "runs.csv", "map.png"


def sweep(
    plan: Plan,
    out: Path | None,
    overwrite: bool,
    workers: int,
    progress: Callable[[str], None] = lambda text: None,
) -> Report:
    """Make every run of a plan, once.

    Every run is kept as soon as it is done. After an interruption the same call goes on with those
    that are missing: a run is known by its scene with all values, not by the code of a plug-in.

    Parameters
    ----------
    plan: what is varied
    out: folder for `runs.csv`, `map.png`, results.json and index.html; None writes nothing
    overwrite: write over a finished sweep
    workers: processes; one runs in this one
    progress: called with the run that was made last, and how many are done

    Raises
    ------
    UserError
        For a scene, a key or a folder that cannot be used.
    """
    study = Study(
        settings=tasks(plan),
        measure=cell,
        result=SweepCell,
        report=lambda results: sweep_report(plan, [one for _, one in results]),
        words=lambda task: f"{task.name} {task.setting}".strip(),
        show=lambda results, to: _show(plan, [one for _, one in results], to),
    )
    return run_study("sweep", study, out, overwrite, workers, progress)


def _show(plan: Plan, cells: list[SweepCell], out: Path) -> list[PageSection]:
    varied = {words(setting): setting for setting in plan.settings()}
    write_cells(cells, out / RUNS, lambda one: varied[one.setting])
    draw_sweep(plan, cells, out / MAP)
    return [picture_section("map", out / MAP, "Scores over what is varied")]
