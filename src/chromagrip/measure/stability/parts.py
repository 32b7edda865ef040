"""`chromagrip stability`: maps of the settings at which methods stop working."""

from collections.abc import Callable, Generator, Sequence
from pathlib import Path

from ...by_name import Choice
from ...output.cells import open_unfinished, read_cells, resumed, write_cells
from ...output.processes import map_processes
from ...output.report import Report
from ..bench.track import choose
from . import loop, model, track
from .boundaries import boundaries
from .cells import Cell, Setting, cell
from .figures import draw_map, draw_model, draw_track
from .maps import maps

Progress = Callable[[str], None]


def stability_model(quick: bool, out: Path | None, overwrite: bool, progress: Progress) -> Report:
    """Map the integrators over step, contact stiffness and node count.

    One grasp (press to 1 N, pull to half of what friction holds, hold) is compared with the same
    grasp in fine implicit steps.

    Parameters
    ----------
    quick: a map of under a minute
    out: folder for picture and table, where an interrupted map goes on; None writes nothing
    overwrite: write over what is there
    progress: called with the name of each run

    Returns
    -------
    Figures of the map, with a sentence for each place where the default is not accurate.
    """
    plan = model.grid(quick)
    unfinished = open_unfinished(out, "map.unfinished.csv", overwrite)
    found = resumed(
        unfinished,
        read_cells(unfinished, model.Cell),
        lambda one: one.setting,
        model.settings(plan),
        lambda waiting: model.cells(waiting, plan.budget, progress),
    )
    cells = list(found.values())
    if out is not None and unfinished is not None:
        draw_model(cells, out / "map.png", quick)
        write_cells(cells, out / "map.csv")
        unfinished.unlink()
    return model.report(cells, quick)


def stability_track(
    quick: bool,
    out: Path | None,
    overwrite: bool,
    progress: Progress,
    trackers: Sequence[Choice] = (),
) -> Report:
    """Map the trackers over one condition at a time.

    Parameters
    ----------
    quick: a few values of two dials, fewer frames
    out, overwrite, progress: as of `stability_model`
    trackers: names, module:Class or classes; none are all, beside a constant answer

    Returns
    -------
    Figures of the map, with a sentence for each tracker that loses identity.

    Raises
    ------
    UserError
        When there is no such tracker, or the folder is taken.
    """
    choices = choose(trackers)
    settings = track.settings(choices, quick)
    unfinished = open_unfinished(out, "map.unfinished.csv", overwrite)
    found = resumed(
        unfinished,
        read_cells(unfinished, track.Cell),
        lambda one: one.setting,
        settings,
        lambda waiting: track.cells(waiting, choices, progress),
    )
    cells = list(found.values())
    if out is not None and unfinished is not None:
        draw_track(cells, out / "map.png", quick)
        write_cells(cells, out / "map.csv")
        unfinished.unlink()
    return track.report(cells, quick)


def stability_loop(
    quick: bool, out: Path | None, overwrite: bool, progress: Progress, workers: int
) -> Report:
    """Map the closed loop, with the boundary that the linearised loop predicts.

    Runs of the thesis's experiment on the truth path, with stated noise on Γ, over camera rate ×
    latency, Kp × Ki, load step × µ, noise × controller and the 27 objects; some through the camera.

    Parameters
    ----------
    quick: a few cells of each map
    out, overwrite, progress: as of `stability_model`
    workers: processes; one runs in this one

    Returns
    -------
    Figures of the maps, with a sentence for each panel on its plant and its boundaries.
    """
    plan = maps(quick)
    wanted = list(dict.fromkeys(one for which in plan.values() for one in which.settings()))
    unfinished = open_unfinished(out, "cells.unfinished.csv", overwrite)

    def run(waiting: list[Setting]) -> Generator[Cell]:
        yield from map_processes(cell, waiting, workers)

    found = resumed(
        unfinished,
        read_cells(unfinished, Cell),
        lambda one: one.setting,
        wanted,
        run,
        lambda done, total: progress(f"{done} of {total} runs"),
    )
    edges = list(boundaries(plan, found, progress))
    if out is not None and unfinished is not None:
        for name, which in plan.items():
            draw_map(which, found, out, name, quick)
            write_cells([found[one] for one in which.settings()], out / f"{name}.csv")
        write_cells(edges, out / "boundaries.csv")
        unfinished.unlink()
    return loop.report(plan, found, edges, quick)
