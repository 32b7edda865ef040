"""Stability maps of the closed loop: where a controller holds, slips, swings or crushes.

Runs of the thesis's experiment on the truth path, with stated noise on Γ, over camera rate ×
latency, Kp × Ki, load step × µ, noise × controller and the 27 objects; some through the camera.
The linearised loop predicts the boundary, and how well it does is measured.
"""

from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, wait
from contextlib import closing
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from ...model import GROSS_SLIP
from ...output.cells import read_cells, write_cells
from ...output.folder import prepare
from ...output.processes import start_worker
from ...output.rows import Row, report, reported, within
from .cells import Cell, Setting, cell
from .chart import draw
from .linear import critical_gain, critical_period
from .maps import PRESETS, Map, boundary, maps, plant_text
from .onset import onset

#: The prediction agrees within this share.
AGREES = 0.30
#: Cells after which they are written down; an interruption loses none, a crash these.
_KEPT_EVERY = 20
#: Time after which a running pool is asked whether it was interrupted [s].
_ASK = 1.0


@dataclass(frozen=True, kw_only=True)
class Boundary:
    """Where one line of a map crosses from rest to swinging; NaN where it does not.

    Attributes
    ----------
    map, panel: of it
    at: latency [frames] or Kp [N] of the line
    predicted: by the linearised loop: delay (L + 1)·T [s], or both gains as a multiple of those
        half-way between the two cells
    small: delay at which a small disturbance of a held grasp grows, on the node model [s]
    rests, swings: the same of the map's last cell at rest and first that swings
    """

    map: str
    panel: str
    at: float
    predicted: float
    small: float
    rests: float
    swings: float

    @property
    def found(self) -> float:
        """Half-way between the two cells."""
        return float(np.sqrt(self.rests * self.swings))


def stability_loop(
    quick: bool, out: Path | None, force: bool, progress: Callable[[str], None], workers: int
) -> tuple[dict[str, Any], list[str]]:
    """Run the maps; pictures and tables go to a folder, where an interrupted run goes on.

    Parameters
    ----------
    quick: a few cells of each map
    out: folder; None writes nothing
    force: write over what is there
    progress: told what is being run
    workers: processes; one runs in this one

    Returns
    -------
    Report of the rows, and a sentence for each panel: its plant, and where prediction and map part.
    """
    plan = maps(quick)
    wanted = list(dict.fromkeys(one for which in plan.values() for one in which.settings()))
    done: dict[Setting, Cell] = {}
    part = None if out is None else out / "cells.unfinished.csv"
    if out is not None and part is not None:
        prepare(out, force or part.exists())
        asked = set(wanted)
        done = {c.setting: c for c in read_cells(part, Cell) if c.setting in asked}
    try:
        with closing(cells([one for one in wanted if one not in done], workers)) as running:
            for found in running:
                done[found.setting] = found
                if part is not None and len(done) % _KEPT_EVERY == 0:
                    write_cells(list(done.values()), part)
                progress(f"{len(done)} of {len(wanted)} runs")
    finally:
        if part is not None and done:
            write_cells(list(done.values()), part)
    edges = list(boundaries(plan, done, progress))
    if out is not None and part is not None:
        for name, which in plan.items():
            draw(which, done, out, name, quick)
            write_cells([done[one] for one in which.settings()], out / f"{name}.csv")
        write_cells(edges, out / "boundaries.csv")
        part.unlink()
    return report(rows_of(plan, done, edges), quick), sentences(plan, edges)


def cells(wanted: list[Setting], workers: int) -> Generator[Cell, None, None]:
    """Run settings, in several processes; in whatever order they end."""
    if workers == 1 or len(wanted) < 2:
        yield from map(cell, wanted)
        return
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=start_worker)
    try:
        waiting: set[Future[Cell]] = {pool.submit(cell, setting) for setting in wanted}
        while waiting:
            ended, waiting = wait(waiting, timeout=_ASK, return_when="FIRST_COMPLETED")
            for job in ended:
                yield job.result()
    finally:
        pool.shutdown(cancel_futures=True)


def boundaries(
    plan: Mapping[str, Map], done: Mapping[Setting, Cell], progress: Callable[[str], None]
) -> Iterator[Boundary]:
    """Boundaries of the maps of rate and latency, and of gains."""
    which = plan["rate-latency"]
    for panel in which.panels:
        for late in panel.y:
            progress(f"small disturbances, {panel.title}, latency {late}")
            setting = which.at(panel, panel.x[0], late)
            found = boundary([done[which.at(panel, x, late)] for x in panel.x])
            delays = [one.linear().delay for one in found] if found else [np.nan, np.nan]
            delay = setting.latency_frames + 1
            yield Boundary(
                map="rate-latency",
                panel=panel.title,
                at=float(late),
                predicted=delay * critical_period(setting.linear()),
                small=delay * onset(setting),
                rests=delays[0],
                swings=delays[1],
            )
    which = plan["gains"]
    for panel in which.panels:
        rows = [[done[which.at(panel, x, y)] for x in panel.x] for y in panel.y]
        for line in (*rows, *map(list, zip(*rows, strict=True))):
            found = boundary(line)
            if found is not None:
                yield _between(panel.title, *found)


def _between(panel: str, rests: Cell, swings: Cell) -> Boundary:
    """Boundary half-way between two cells of the map of gains."""
    step = np.sqrt(
        max(
            swings.proportional_n / rests.proportional_n,
            swings.integral_n_per_s / rests.integral_n_per_s,
        )
    )
    middle = replace(
        rests.setting,
        proportional_n=float(np.sqrt(rests.proportional_n * swings.proportional_n)),
        integral_n_per_s=float(np.sqrt(rests.integral_n_per_s * swings.integral_n_per_s)),
    ).linear()
    return Boundary(
        map="gains",
        panel=panel,
        at=middle.proportional,
        # Both gains times something are the plant's gain times it.
        predicted=critical_gain(middle) / middle.plant.gain,
        small=np.nan,
        rests=float(1.0 / step),
        swings=float(step),
    )


def rows_of(
    plan: Mapping[str, Map], done: Mapping[Setting, Cell], edges: list[Boundary]
) -> list[Row]:
    """How well the boundary is predicted, what slips where, and whether the camera agrees."""
    rows = []
    for name, panel in dict.fromkeys((edge.map, edge.panel) for edge in edges):
        mine = [edge for edge in edges if (edge.map, edge.panel) == (name, panel)]
        ratios = {
            "small": [edge.small / edge.predicted for edge in mine],
            "map": [edge.found / edge.predicted for edge in mine],
        }
        for kind, values in ratios.items():
            known = np.array(values)[np.isfinite(values)]
            for word, value in (("least", np.min), ("largest", np.max)) if known.size else ():
                label = f"{name}/{panel}/{kind}_over_predicted_{word}"
                rows.append(within(label, float(value(known)), "", 1.0 - AGREES, 1.0 + AGREES))
    for name in ("rate-latency", "gains", "load", "objects"):
        mine_ = [c for c in _truth(plan[name], done) if np.isfinite([c.root, c.swing]).all()]
        right = np.mean([(c.root >= 1.0) == c.swings for c in mine_])
        rows.append(reported(f"{name}/cells_predicted_right", 100.0 * float(right), "%"))
    for title, preset in _shown(plan["objects"]).items():
        slipped = sum(done[one].displacement_mm > 1e3 * GROSS_SLIP for one in preset)
        row = reported(f"objects/{title}/gross_slip", float(slipped), f"of {len(preset)}")
        rows.append(row)
    seen = [(done[one], done[_truthful(one)]) for one in plan["rate-latency"].camera]
    same = np.mean([a.swings == b.swings for a, b in seen])
    rows.append(reported("camera/swings_where_the_truth_path_does", 100.0 * float(same), "%"))
    same = np.mean([a.outcome == b.outcome for a, b in seen])
    rows.append(reported("camera/same_outcome", 100.0 * float(same), "%"))
    return rows


def _truth(which: Map, done: Mapping[Setting, Cell]) -> list[Cell]:
    return [done[one] for one in which.settings() if one.path == "truth"]


def _truthful(setting: Setting) -> Setting:
    """The same on the truth path."""
    return replace(setting, path="truth", margin_noise=Setting().margin_noise)


def _shown(which: Map) -> dict[str, list[Setting]]:
    """Settings of all objects by preset."""
    found: dict[str, list[Setting]] = {}
    for panel in which.panels:
        title = next(name for name in PRESETS if panel.title.startswith(name))
        found.setdefault(title, []).extend(which.at(panel, x, y) for y in panel.y for x in panel.x)
    return found


def sentences(plan: Mapping[str, Map], edges: list[Boundary]) -> list[str]:
    """Of each panel with a predicted boundary, what was found."""
    told = []
    for panel in plan["rate-latency"].panels:
        mine = [edge for edge in edges if edge.panel == panel.title]
        told.append(
            f"{panel.title} ({plant_text(panel.base)}): (latency + 1)·T may be "
            f"{_range([1e3 * edge.predicted for edge in mine])} ms by the linearised loop, "
            f"{_range([1e3 * edge.small for edge in mine])} ms for a small disturbance, "
            f"{_range([1e3 * edge.found for edge in mine])} ms in the map"
        )
    return told


def _range(values: list[float]) -> str:
    known = [value for value in values if np.isfinite(value)]
    if not known:
        return "beyond what was run"
    low, high = min(known), max(known)
    return f"{low:.3g}" if f"{low:.3g}" == f"{high:.3g}" else f"{low:.3g} to {high:.3g}"
