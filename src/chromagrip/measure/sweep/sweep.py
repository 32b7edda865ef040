"""Front door of a sweep: its runs, resumed where they were interrupted, and its files."""

from collections.abc import Callable, Generator
from pathlib import Path

from ...output.cells import read_cells, resumed, unfinished_in, write_cells
from ...output.report import Report
from .report import sweep_report
from .runs import Cell, Plan, cells, tasks

#: Runs that are done, while others are not.
UNFINISHED = "runs.unfinished.csv"
#: All runs, and the map.
RUNS, MAP = "runs.csv", "map.png"


def sweep(
    plan: Plan,
    out: Path | None,
    overwrite: bool,
    workers: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Report:
    """Make every run of a plan, once.

    Every run is kept as soon as it is done. After an interruption the same call goes on with those
    that are missing: a run is known by its scene with all values, not by the code of a plug-in.

    Parameters
    ----------
    plan: what is varied
    out: folder for `runs.csv` and `map.png`; None writes nothing
    overwrite: write over a finished sweep
    workers: processes; one runs in this one
    progress: called with the numbers of runs that are done and wanted

    Raises
    ------
    UserError
        For a scene, a key or a folder that cannot be used.
    """
    wanted = {task.key: task for task in tasks(plan)}

    def run(waiting: list[str]) -> Generator[Cell]:
        yield from cells([wanted[key] for key in waiting], workers)

    with unfinished_in(out, UNFINISHED, overwrite) as unfinished:
        done = read_cells(unfinished, Cell)
        found = resumed(unfinished, done, lambda one: one.key, list(wanted), run, progress)
        made = list(found.values())
        if out is not None and unfinished is not None:
            from .picture import draw_sweep  # matplotlib

            draw_sweep(plan, made, out / MAP)
            write_cells(made, out / RUNS)
            unfinished.unlink(missing_ok=True)
    return sweep_report(plan, made)
