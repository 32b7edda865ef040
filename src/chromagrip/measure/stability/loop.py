"""Figures of the stability maps of the closed loop."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ...model import GROSS_SLIP
from ...output.report import Report, Row, reported
from .boundaries import Boundary, ratio_rows, sentences
from .cells import Cell, Setting
from .maps import PRESETS, Map


def report(
    plan: Mapping[str, Map],
    done: Mapping[Setting, Cell],
    edges: Sequence[Boundary],
    quick: bool,
) -> Report:
    """Accuracy of the prediction, gross slip, and agreement of the camera with the truth path.

    The notes give the plant and the boundaries of each panel.
    """
    rows = (*ratio_rows(edges), *_outcome_rows(plan, done))
    return Report(rows=rows, notes=tuple(sentences(plan["rate-latency"], edges)), quick=quick)


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
        settings.setdefault(title, []).extend(
            which.at(panel, x, y) for y in panel.y for x in panel.x
        )
    return settings
