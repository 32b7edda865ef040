"""Maps of the closed loop of a dome and of two fingers, with boundaries by analysis."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from ....output.cells import write_cells
from ....output.page import PageSection
from ....output.report import Report, Row, reported
from ...study import Asked, Results, Study, controllers_of, study
from ..figures import GRIPS, draw_map
from ..panels import picture_section, score_of, settings_of, shipped_notes
from .cells import OUTCOMES, SCENES, GripCell, GripSetting, World, cell
from .maps import Map, maps
from .predicted import linear, slowest_rate


@study("stability", "loop", worlds=("dome",), method="controller")
def dome_map(asked: Asked) -> Study[GripSetting, GripCell]:
    """Grips of one dome under a load over camera rate and latency, on the truth path.

    Chosen controllers have panels of their own next to ours. A quick map has a few cells.
    """
    return _grip_map("dome", asked)


@study("stability", "loop", worlds=("pinch",), method="controller")
def pinch_map(asked: Asked) -> Study[GripSetting, GripCell]:
    """Grips of two fingers over rate, latency, mass, friction and offset, on the truth path.

    Chosen controllers have panels of their own next to ours. A quick map has a few cells.
    """
    return _grip_map("pinch", asked)


def _grip_map(world: World, asked: Asked) -> Study[GripSetting, GripCell]:
    plan = maps(world, asked.quick, controllers_of(asked, SCENES[world], ()))
    shipped = GripSetting(world=world)

    def show(results: Results[GripSetting, GripCell], out: Path) -> list[PageSection]:
        done = dict(results)
        for name, which in plan.items():
            draw_map(which, GRIPS, done, out, name, asked.quick)
            write_cells([done[one] for one in which.settings()], out / f"{name}.csv")
        return [picture_section(name, out / f"{name}.png", plan[name].title) for name in plan]

    def report(results: Results[GripSetting, GripCell]) -> Report:
        done = dict(results)
        return Report(
            rows=tuple(_rows(plan, done)),
            notes=(
                f"Scene {SCENES[world]} on the truth path. {_GAINS[world]}",
                *shipped_notes({SCENES[world]: shipped}, done, OUTCOMES),
                *_notes(plan["rate-latency"], done),
            ),
        )

    return Study(
        settings=list(dict.fromkeys([*settings_of(plan), shipped])),
        measure=cell,
        result=GripCell,
        report=report,
        words=lambda one: one.controller,
        show=show,
    )


#: Gains of Safety Margin in a world.
_GAINS: dict[World, str] = {
    "dome": "Safety Margin, which the scene does not use, has the gains of `camera-100hz`.",
    "pinch": "All controllers have the scene's own gains.",
}


def _rows(plan: Mapping[str, Map], done: Mapping[GripSetting, GripCell]) -> Iterator[Row]:
    """Number of cells of each outcome."""
    for name, which in plan.items():
        for panel in which.panels:
            cells = [done[one] for one in which.cells(panel)]
            for outcome in OUTCOMES:
                count = sum(one.outcome == outcome for one in cells)
                if count:
                    subject = (name, panel.title, score_of(outcome))
                    yield reported(subject, count, f"of {len(cells)}")


def _notes(which: Map, done: Mapping[GripSetting, GripCell]) -> Iterator[str]:
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
