"""Time per field of each reconstructor against its error."""

from collections.abc import Callable

import numpy as np

from ...tracking import METHODS
from ...tracking.forces import DOME_METHODS
from ..bench.force import BEST, timed_scenes
from ..bench.force_sets import Measured, choose, measure
from ..worlds.force_scores import CONSTANT, READ, UNITS, constant, scores, times
from ..worlds.grasps import LIBRARY
from .chart import CONSTANT_TOLD, Axis, Chart, Point

#: Grasps whose errors are measured, and those of a quick run.
_GRASPS = 48
_QUICK_GRASPS = 8
#: Repeats of the timing, and those of a quick run.
_TURNS = 6
_QUICK_TURNS = 3
#: Errors that are drawn, and their labels.
_ERRORS = {"normal_rms": "ΣFn, RMS error [%]", "margin_rms": "Γ, RMS error"}


def chart_force(
    quick: bool, progress: Callable[[str], None], reconstructors: tuple[str, ...] = ()
) -> Chart:
    """Measure reconstructors on the matched library.

    Parameters
    ----------
    quick: few grasps, and only reconstructors of the chain where none are chosen
    progress: called with the name of each measurement
    reconstructors: names or module:Class; none are all of ours

    Raises
    ------
    UserError
        When there is no such reconstructor.
    """
    # Those of domes refuse nearly all of the chain's pictures, and take long over it.
    quickly = [name for name in METHODS if name not in DOME_METHODS]
    names = choose(reconstructors or (quickly if quick else ()))
    grasps, turns = (_QUICK_GRASPS, _QUICK_TURNS) if quick else (_GRASPS, _TURNS)
    measured = measure({("matched", LIBRARY): grasps}, names, grasps, progress)["matched"]
    progress("speed")
    spent = times(names, timed_scenes(), turns)
    known = {
        name: {read: scores(measured.answers[name, read], measured.true) for read in READ}
        for name in names
    }
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
        for read in READ
        for score, label in _ERRORS.items()
    ]
    points = [
        Point(
            name=name,
            times=spent[name],
            errors={
                f"{read}/{score}": known[name][read][score] for read in READ for score in _ERRORS
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


def _limit(measured: Measured, read: str, score: str) -> float:
    """Root mean square of the information limit, as the score counts errors."""
    normal, _, _, margin = measured.limit[read].T
    bound = 100.0 * normal / measured.true[:, 0] if score == "normal_rms" else margin
    return float(np.sqrt(np.nanmean(bound**2)))
