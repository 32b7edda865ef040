"""Time per field of each reconstructor against its error, on pictures of domes of silicone."""

from collections.abc import Mapping

import numpy as np

from ..bench.force_sets import choose
from ..study import Asked, Study, study
from ..worlds.beyond.scores import beyond_scores
from ..worlds.dome.across import DESIGN
from ..worlds.dome.readings import Reading, constant
from ..worlds.dome.sets import (
    BEST,
    COMPARED,
    DESIGNS,
    NEXT,
    SOFT,
    DomeResult,
    DomeTask,
    by_set,
    measure_scene,
    tasks,
)
from ..worlds.force_scores import CONSTANT
from .chart import CONSTANT_TOLD, Axis, Chart, Peer, Point
from .page import chart_study

#: Scenes of the design that all reconstructors read, those of a quick run, and of each other one.
_SCENES, _QUICK_SCENES, _OF_OTHERS = 4, 1, 2
_TITLE = f"Reconstructors on domes of silicone: sensor {DESIGN}, noise of 2 levels, any direction"
#: Errors that are drawn, their labels and units.
_ERRORS = {"normal_error": ("ΣFn, RMS error [%]", "%"), "margin_error": ("Γ, RMS error", "")}
#: Designs that BEST alone reads, as they are used.
_OTHERS = (*DESIGNS, NEXT)


@study("chart", "force", worlds=("dome",), method="reconstructor")
def dome_chart(asked: Asked) -> Study[DomeTask, DomeResult]:
    """Time per field of each reconstructor against its error, on pictures of domes of silicone.

    All are compared on one design, those of domes on others too. A quick run has few scenes of one
    design.
    """
    methods = choose(asked, COMPARED)
    count = _QUICK_SCENES if asked.quick else _SCENES
    wanted = tasks({(DESIGN, SOFT): count}, methods)
    for design in () if asked.quick or asked.methods else _OTHERS:
        wanted += tasks({(design, "matched"): _OF_OTHERS}, {BEST: BEST})
    return chart_study(
        lambda results: _chart(by_set(results), count),
        measure_scene,
        DomeResult,
        settings=wanted,
        words=lambda task: f"{task.design}, {task.kind}",
    )


def _chart(sets: Mapping[tuple[str, str], DomeResult], count: int) -> Chart:
    result = sets[DESIGN, SOFT]
    guess = beyond_scores(constant(result.true, result.side).answers, result.true)
    peers: dict[str, list[Peer]] = {key: [] for key in _ERRORS}
    for (design, _), other in list(sets.items())[1:]:
        for name, reading in other.readings.items():
            times, found = _times(reading), beyond_scores(reading.answers, other.true)
            for key, of in peers.items():
                of.append(
                    Peer(
                        name=f"{name}, {design.removeprefix('chromatouch-')}",
                        milliseconds=float(np.median(times)),
                        error=found[key],
                        source=f"sensor {design}: {_told(found, '2.4 to 3.6 N', _OF_OTHERS)}",
                    )
                )
    points = []
    for name, reading in result.readings.items():
        found = beyond_scores(reading.answers, result.true)
        points.append(
            Point(
                name=name,
                times=_times(reading),
                errors={key: found[key] for key in _ERRORS},
                ours=name == BEST,
                settings=_told(found, "0.8 to 1.2 N", count),
                command=f"chromagrip chart force --world dome --reconstructor {name}",
            )
        )
    axes = [
        Axis(key=key, label=label, unit=unit, lines={CONSTANT: guess[key]}, peers=tuple(peers[key]))
        for key, (label, unit) in _ERRORS.items()
    ]
    return Chart(
        part="force-dome",
        title=_TITLE,
        per="field",
        points=points,
        axes=axes,
        levels={CONSTANT: CONSTANT_TOLD},
        compared="other sensors, stronger grips",
    )


def _times(reading: Reading) -> list[float]:
    """Time of a field in each scene [ms]."""
    return [1e3 * spent for spent in reading.spent.tolist() if np.isfinite(spent)]


def _told(found: dict[str, float], grips: str, scenes: int) -> str:
    """What was gripped, and what an error does not say: refusals, and how often intervals hold."""
    inside = " and ".join(f"{found[f'{name}_coverage']:.0f}" for name in ("normal", "margin"))
    return (
        f"{scenes} scenes of {grips}; {found['flagged']:.0f} % of the frames flagged; of the rest "
        f"{inside} % of ΣFn and Γ inside their intervals"
    )
