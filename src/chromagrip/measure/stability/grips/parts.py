"""`chromagrip stability loop --world dome|pinch`: the maps, resumed where they were interrupted."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from ....output.cells import unfinished_in, write_cells
from ....output.report import Report, Row, reported
from ..figures import GRIPS, draw_map
from ..panels import run_maps, score_of
from .cells import OUTCOMES, SCENES, Cell, Setting, World, cell
from .maps import Map, maps
from .predicted import linear, slowest_rate


def stability_grips(
    world: World,
    quick: bool,
    out: Path | None,
    overwrite: bool,
    progress: Callable[[str], None],
    workers: int,
) -> Report:
    """Map grips on the truth path over camera rate × latency; of a pinch also mass, µ and offset.

    Parameters
    ----------
    world: one dome and a load, or two of them and an object with a weight
    quick: a few cells of each map
    out: folder for pictures and tables, where an interrupted map goes on; None writes nothing
    overwrite: write over what is there
    progress: called with the number of runs that are done
    workers: processes; one runs in this one

    Returns
    -------
    Outcomes of each panel, with a sentence for each about its boundary.
    """
    plan = maps(world, quick)
    with unfinished_in(out, "cells.unfinished.csv", overwrite) as unfinished:
        results = run_maps(plan, Cell, cell, unfinished, progress, workers)
        if out is not None and unfinished is not None:
            for name, which in plan.items():
                draw_map(which, GRIPS, results, out, name, quick)
                write_cells([results[one] for one in which.settings()], out / f"{name}.csv")
            unfinished.unlink()
    return Report(
        rows=tuple(_rows(plan, results)),
        notes=(f"Scene {SCENES[world]} on the truth path.", *_notes(plan["rate-latency"], results)),
        quick=quick,
    )


def _rows(plan: Mapping[str, Map], done: Mapping[Setting, Cell]) -> Iterator[Row]:
    """Number of cells of each outcome."""
    for name, which in plan.items():
        for panel in which.panels:
            cells = [done[one] for one in which.cells(panel)]
            for outcome in OUTCOMES:
                count = sum(one.outcome == outcome for one in cells)
                if count:
                    subject = (name, panel.title, score_of(outcome))
                    yield reported(subject, count, f"of {len(cells)}")


def _notes(which: Map, done: Mapping[Setting, Cell]) -> Iterator[str]:
    """Boundary of Safety Margin at each latency, by the linearised loop and in the map."""
    for panel in which.panels:
        if panel.base.controller != "safety-margin":
            continue
        plant = linear(panel.base).plant
        told = []
        for latency in panel.y:
            line = [done[which.at(panel, rate, latency)] for rate in panel.x]
            first = next((one.rate_hz for one in line if one.outcome != "holds"), np.nan)
            bound = slowest_rate(line[0].setting)
            seen = "at none" if np.isnan(first) else f"from {first:g} Hz on"
            told.append(f"latency {latency:g}: {bound:.3g} Hz by the loop, {seen} in the map")
        yield (
            f"{panel.title} (g = {plant.gain:.2f} /N, τ = {1e3 * plant.lag:.1f} ms) stops holding "
            f"as the rate falls: {'; '.join(told)}"
        )
