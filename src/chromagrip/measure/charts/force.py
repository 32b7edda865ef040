"""Time per field of each reconstructor against its error."""

from collections.abc import Mapping

import numpy as np

from ...by_name import Choice
from ...tracking import METHODS
from ...tracking.forces import DOME_METHODS
from ..bench.force import BEST, Speed, Times, force_words, measure_force
from ..bench.force_sets import GraspTask, Measured, choose, joined, tasks
from ..study import Asked, Results, Study, study
from ..worlds.force_scores import CONSTANT, UNITS, constant, reads_of, scores
from ..worlds.grasps import LIBRARY
from .chart import CONSTANT_TOLD, Axis, Chart, Point
from .page import chart_study

#: Grasps whose errors are measured, and those of a quick run.
_GRASPS = 48
_QUICK_GRASPS = 8
#: Repeats of the timing, and those of a quick run.
_TURNS = 6
_QUICK_TURNS = 3
#: Reads that are drawn; a contact that is followed has one answer for both.
_READS = ("single", "0.1s")
#: Errors that are drawn, and their labels.
_ERRORS = {"normal_rms": "ΣFn, RMS error [%]", "margin_rms": "Γ, RMS error"}


@study("chart", "force", method="reconstructor", example="--reconstructor sequential --quick")
def force_chart(asked: Asked) -> Study[GraspTask | Speed, Measured | Times]:
    """Time per field of each reconstructor against its error, on the chain's matched library.

    A quick run has few grasps and, unless they are chosen, only reconstructors of the chain.
    """
    # Those of domes refuse nearly all of the chain's pictures, and take long over it.
    quickly = [name for name in METHODS if name not in DOME_METHODS]
    names = choose(asked, quickly if asked.quick else ())
    grasps, turns = (_QUICK_GRASPS, _QUICK_TURNS) if asked.quick else (_GRASPS, _TURNS)
    return chart_study(
        lambda results: _chart(results, names, grasps),
        measure_force,
        Measured | Times,
        settings=tasks({("matched", LIBRARY): grasps}, names, grasps),
        timed=[Speed(names, turns)],
        words=force_words,
    )


def _chart(
    results: Results[GraspTask | Speed, Measured | Times], names: Mapping[str, Choice], grasps: int
) -> Chart:
    found = [one for _, one in results if isinstance(one, Measured)]
    measured = joined(found)
    spent = dict(next(one for _, one in results if not isinstance(one, Measured)))
    known = {name: _scores(measured, name) for name in names}
    axes = [
        Axis(
            key=f"{read}/{score}",
            label=f"{label}, {read}",
            unit=UNITS[score],
            lines={
                CONSTANT: scores(constant(measured.true), measured.true)[score],
                "limit": _limit(measured, read, score),
            },
        )
        for read in _READS
        for score, label in _ERRORS.items()
    ]
    points = [
        Point(
            name=name,
            times=spent[name],
            errors={
                f"{read}/{score}": known[name][read][score] for read in _READS for score in _ERRORS
            },
            ours=name in BEST.values(),
            settings=f"tracks of the default tracker, {grasps} random grasps; "
            f"{known[name]['0.1s']['flagged']:.0f} % flagged, which count as no force",
            command=f"chromagrip chart force --reconstructor {name}",
        )
        for name in names
    ]
    title = f"Reconstructors: sensor thesis, 640×480, noise of 2 levels, {grasps} random grasps"
    levels = {CONSTANT: CONSTANT_TOLD, "limit": "least error that the picture allows"}
    return Chart(part="force", title=title, per="field", points=points, axes=axes, levels=levels)


def _scores(measured: Measured, name: str) -> dict[str, dict[str, float]]:
    """Scores of a reconstructor by the read that is drawn."""
    read = {read: read if read in reads_of(name) else reads_of(name)[-1] for read in _READS}
    return {
        drawn: scores(measured.answers[own][name], measured.true) for drawn, own in read.items()
    }


def _limit(measured: Measured, read: str, score: str) -> float:
    """Root mean square of the information limit, as the score counts errors."""
    normal, _, _, margin = measured.limit[read].T
    bound = 100.0 * normal / measured.true[:, 0] if score == "normal_rms" else margin
    return float(np.sqrt(np.nanmean(bound**2)))
