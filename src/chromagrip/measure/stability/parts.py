"""`chromagrip stability`: maps of the settings at which methods stop working."""

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...by_name import Choice
from ...model import GROSS_SLIP
from ...output.cells import read_cells, resumed, unfinished_in, write_cells
from ...output.report import Report, Row, reported
from ..bench.track import choose
from . import dome, force, model, track
from .boundaries import boundaries, ratio_rows, sentences
from .cells import Cell, Setting, cell
from .figures import CHAIN, draw_dome, draw_force, draw_map, draw_model, draw_track
from .maps import PRESETS, Map, maps
from .panels import run_maps

Progress = Callable[[str], None]


def stability_model(quick: bool, out: Path | None, overwrite: bool, progress: Progress) -> Report:
    """Map the integrators over step, contact stiffness and node count, and the dome's steps.

    One grasp of the chain (press to 1 N, pull to half of what friction holds, hold) is compared
    with the same grasp in fine implicit steps; one contact of the dome (press, then slide) over
    travel in a step, stiffness of the object and Dahl exponent, with the same in fine steps.

    Parameters
    ----------
    quick: maps of under a minute
    out: folder for pictures and tables, where an interrupted map goes on; None writes nothing
    overwrite: write over what is there
    progress: called with the name of each run

    Returns
    -------
    Figures of the maps, with a sentence for each place where the default is not accurate.
    """
    plan, dome_plan = model.grid(quick), dome.grid(quick)
    with unfinished_in(out, "map.unfinished.csv", overwrite) as unfinished:
        run = partial(model.cells, budget=plan.budget, progress=progress)
        of_chain = _cells(unfinished, model.Cell, model.settings(plan), run)
        # The chain's cells stay unfinished while the dome's are made: the folder is still in work.
        beside = None if out is None else out / "dome.unfinished.csv"
        run_dome = partial(dome.cells, progress=progress)
        of_dome = _cells(beside, dome.Cell, dome.settings(dome_plan), run_dome)
        _finish(out, "dome", of_dome, partial(draw_dome, quick=quick))
        _finish(out, "map", of_chain, partial(draw_model, quick=quick))
    chain_told, dome_told = model.report(of_chain, quick), dome.report(of_dome, quick)
    return Report(
        rows=chain_told.rows + dome_told.rows,
        notes=chain_told.notes + dome_told.notes,
        quick=quick,
    )


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
    run = partial(track.cells, trackers=choices, progress=progress)
    draw = partial(draw_track, quick=quick)
    with unfinished_in(out, "map.unfinished.csv", overwrite) as unfinished:
        cells = _cells(unfinished, track.Cell, track.settings(choices, quick), run)
        _finish(out, "map", cells, draw)
    return track.report(cells, quick)


def stability_force(
    quick: bool, out: Path | None, overwrite: bool, progress: Progress, workers: int
) -> Report:
    """Map the reconstructors on domes over one condition at a time.

    Parameters
    ----------
    quick: a few values of two dials, one design
    out, overwrite, progress: as of `stability_model`
    workers: processes; one runs in this one

    Returns
    -------
    Outcomes of each reconstructor, with a sentence for each place where one that was made for domes
    is wrong, narrow and unflagged.
    """
    run = partial(force.cells, workers=workers, progress=progress)
    with unfinished_in(out, "map.unfinished.csv", overwrite) as unfinished:
        cells = _cells(unfinished, force.Cell, force.settings(quick), run)
        _finish(out, "map", cells, partial(draw_force, quick=quick))
    return force.report(cells, quick)


def _cells(
    unfinished: Path | None,
    kind: type[Any],
    wanted: Sequence[Any],
    run: Callable[[list[Any]], Generator[Any]],
) -> list[Any]:
    """Cells of one map, in the order of their settings; those of a file need no run."""
    done = read_cells(unfinished, kind)
    return list(resumed(unfinished, done, lambda one: one.setting, wanted, run).values())


def _finish(
    out: Path | None, name: str, cells: list[Any], draw: Callable[[list[Any], Path], None]
) -> None:
    """Write picture and table of a map into a folder, and drop what was unfinished."""
    if out is not None:
        draw(cells, out / f"{name}.png")
        write_cells(cells, out / f"{name}.csv")
        (out / f"{name}.unfinished.csv").unlink()


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
    with unfinished_in(out, "cells.unfinished.csv", overwrite) as unfinished:
        results = run_maps(plan, Cell, cell, unfinished, progress, workers)
        edges = list(boundaries(plan, results, progress))
        if out is not None and unfinished is not None:
            for name, which in plan.items():
                draw_map(which, CHAIN, results, out, name, quick)
                write_cells([results[one] for one in which.settings()], out / f"{name}.csv")
            write_cells(edges, out / "boundaries.csv")
            unfinished.unlink()
    return Report(
        rows=(*ratio_rows(edges), *_outcome_rows(plan, results)),
        notes=tuple(sentences(plan["rate-latency"], edges)),
        quick=quick,
    )


def _outcome_rows(plan: Mapping[str, Map], done: Mapping[Setting, Cell]) -> Iterator[Row]:
    for name in ("rate-latency", "gains", "load", "objects"):
        truth = [done[one] for one in plan[name].settings() if one.path == "truth"]
        known = [cell for cell in truth if np.isfinite([cell.root, cell.swing]).all()]
        right = np.mean([(cell.root >= 1.0) == cell.swings for cell in known])
        yield reported((name, "cells_predicted_right"), 100.0 * float(right), "%")
    for title, settings in _by_preset(plan["objects"]).items():
        slipped = sum(done[one].displacement_mm > 1e3 * GROSS_SLIP for one in settings)
        yield reported(("objects", title, "gross_slip"), slipped, f"of {len(settings)}")
    pairs = [(done[one], done[one.on_truth_path()]) for one in plan["rate-latency"].camera]
    same = np.mean([camera.swings == truth.swings for camera, truth in pairs])
    yield reported(("camera", "swings_where_the_truth_path_does"), 100.0 * float(same), "%")
    same = np.mean([camera.outcome == truth.outcome for camera, truth in pairs])
    yield reported(("camera", "same_outcome"), 100.0 * float(same), "%")


def _by_preset(which: Map) -> dict[str, list[Setting]]:
    """Settings of the map of the objects by preset."""
    settings: dict[str, list[Setting]] = {}
    for panel in which.panels:
        title = next(name for name in PRESETS if panel.title.startswith(name))
        settings.setdefault(title, []).extend(which.cells(panel))
    return settings
