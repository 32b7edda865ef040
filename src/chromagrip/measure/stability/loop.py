"""Maps of the closed loop on the chain, with the boundary that the linearised loop predicts.

Runs of the thesis's experiment on the truth path, with stated noise on Γ, over camera rate ×
latency, Kp × Ki, load step × µ, noise × controller and the 27 objects; some through the camera.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...model import GROSS_SLIP
from ...output.cells import write_cells
from ...output.page import PageSection
from ...output.report import Report, Row, reported
from ..study import Asked, Results, Study, controllers_of, study
from .boundaries import Boundary, boundaries, onset, ratio_rows, sentences
from .cells import OUTCOMES, LoopCell, LoopSetting, cell
from .figures import CHAIN, draw_map
from .maps import PRESETS, SHIPPED, Map, maps
from .panels import picture_section, settings_of, shipped_notes


class Disturbance(NamedTuple):
    """A setting whose grasp is disturbed a little, at a range of periods."""

    disturbed: LoopSetting


#: A run and its outcome, or the period at which a disturbance grows [s].
Found = LoopCell | float


@study("stability", "loop", method="controller", example="--world dome --quick")
def loop_map(asked: Asked) -> Study[LoopSetting | Disturbance, Found]:
    """Closed loop of the chain over rates, gains, loads, noise and objects, with predictions.

    Chosen controllers have panels of their own next to ours. A quick map has a few cells of each.
    """
    plan = maps(asked.quick, controllers_of(asked, "camera-100hz", ()))
    disturbed = [
        Disturbance(which.at(panel, panel.x[0], latency))
        for which in [plan["rate-latency"]]
        for panel in which.panels
        if panel.base.predicted
        for latency in panel.y
    ]
    return Study(
        settings=[*dict.fromkeys([*settings_of(plan), *SHIPPED.values()]), *disturbed],
        measure=measured,
        result=Found,
        report=lambda results: _report(plan, results),
        words=lambda one: one.controller if isinstance(one, LoopSetting) else "small disturbances",
        show=lambda results, out: _show(plan, results, out, asked.quick),
    )


def measured(setting: LoopSetting | Disturbance) -> Found:
    """Outcome of a run, or the period at which a disturbance grows [s]."""
    return cell(setting) if isinstance(setting, LoopSetting) else onset(setting.disturbed)


def _runs(results: Results[LoopSetting | Disturbance, Found]) -> dict[LoopSetting, LoopCell]:
    return {
        setting: found
        for setting, found in results
        if isinstance(setting, LoopSetting) and isinstance(found, LoopCell)
    }


def _edges(
    plan: Mapping[str, Map], results: Results[LoopSetting | Disturbance, Found]
) -> list[Boundary]:
    onsets = {
        setting.disturbed: found
        for setting, found in results
        if isinstance(setting, Disturbance) and isinstance(found, float)
    }
    return list(boundaries(plan, _runs(results), onsets))


def _report(plan: Mapping[str, Map], results: Results[LoopSetting | Disturbance, Found]) -> Report:
    edges = _edges(plan, results)
    return Report(
        rows=(*ratio_rows(edges), *_outcome_rows(plan, _runs(results))),
        notes=(
            _PRINTED,
            *shipped_notes(SHIPPED, _runs(results), OUTCOMES),
            *sentences(plan["rate-latency"], edges),
        ),
    )


#: What the panels show.
_PRINTED = (
    "printed: the gains of the thesis, at its 1000 Hz. retuned: those of the scene `camera-100hz`. "
    "margin-inversion: the controller of the scene `margin-60hz`. Grip First is on, as in a run."
)


def _show(
    plan: Mapping[str, Map],
    results: Results[LoopSetting | Disturbance, Found],
    out: Path,
    quick: bool,
) -> list[PageSection]:
    done = _runs(results)
    for name, which in plan.items():
        draw_map(which, CHAIN, done, out, name, quick)
        write_cells([done[one] for one in which.settings()], out / f"{name}.csv")
    write_cells(_edges(plan, results), out / "boundaries.csv")
    return [picture_section(name, out / f"{name}.png", plan[name].title) for name in plan]


def _outcome_rows(plan: Mapping[str, Map], done: Mapping[LoopSetting, LoopCell]) -> Iterator[Row]:
    for name in ("rate-latency", "gains", "load", "objects"):
        truth = [done[one] for one in plan[name].settings() if one.path == "truth"]
        known = [cell for cell in truth if np.isfinite([cell.root, cell.swing]).all()]
        right = np.mean([(cell.root >= 1.0) == cell.swings for cell in known])
        yield reported((name, "cells_predicted_right"), 100.0 * float(right), "%")
    rates = plan["rate-latency"]
    for panel in rates.panels:
        outcomes = [done[one].outcome for one in rates.cells(panel)]
        row = ("rate-latency", panel.title, "holds")
        yield reported(row, outcomes.count("holds"), f"of {len(outcomes)}")
    for title, settings in _by_preset(plan["objects"]).items():
        slipped = sum(done[one].displacement_mm > 1e3 * GROSS_SLIP for one in settings)
        yield reported(("objects", title, "gross_slip"), slipped, f"of {len(settings)}")
    pairs = [(done[one], done[one.on_truth_path()]) for one in plan["rate-latency"].camera]
    same = np.mean([camera.swings == truth.swings for camera, truth in pairs])
    yield reported(("camera", "swings_where_the_truth_path_does"), 100.0 * float(same), "%")
    same = np.mean([camera.outcome == truth.outcome for camera, truth in pairs])
    yield reported(("camera", "same_outcome"), 100.0 * float(same), "%")


def _by_preset(which: Map) -> dict[str, list[LoopSetting]]:
    """Settings of the map of the objects by preset."""
    settings: dict[str, list[LoopSetting]] = {}
    for panel in which.panels:
        title = next(name for name in PRESETS if panel.title.startswith(name))
        settings.setdefault(title, []).extend(which.cells(panel))
    return settings
