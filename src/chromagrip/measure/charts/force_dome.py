"""Time per field of each reconstructor against its error, on pictures of domes of silicone."""

from collections.abc import Callable

import numpy as np

from ...by_name import Choice
from ..bench.force_sets import choose
from ..beyond.scores import beyond_scores
from ..domes.across import DESIGN
from ..domes.readings import Reading, constant
from ..domes.sets import BEST, COMPARED, DESIGNS, FREE, SOFT, Result, measure_domes
from ..worlds.force_scores import CONSTANT
from .chart import CONSTANT_TOLD, Axis, Chart, Peer, Point

#: Scenes of the design that all reconstructors read, those of a quick run, and of each other one.
_SCENES, _QUICK_SCENES, _OF_OTHERS = 4, 1, 2
_TITLE = f"Reconstructors on domes of silicone: sensor {DESIGN}, noise of 2 levels, any direction"
#: Errors that are drawn, their labels and units.
_ERRORS = {"normal_error": ("ΣFn, RMS error [%]", "%"), "margin_error": ("Γ, RMS error", "")}
#: Designs that fewer reconstructors read, as they are used, with those that do.
_OTHERS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(DESIGNS, (BEST,)),
    "chromatouch-next": (BEST, FREE),
}


def chart_force_dome(
    quick: bool, progress: Callable[[str], None], reconstructors: tuple[str, ...] = ()
) -> Chart:
    """Measure reconstructors on domes: all on one design, those of domes on others beside it.

    Parameters
    ----------
    quick: few scenes of one design
    progress: called with the name of each measurement
    reconstructors: names or module:Class; none are all that are compared across worlds

    Raises
    ------
    UserError
        When there is no such reconstructor.
    """
    methods = choose(reconstructors or COMPARED)
    count = _QUICK_SCENES if quick else _SCENES
    result = _measured(DESIGN, SOFT, count, methods, progress)
    guess = beyond_scores(constant(result.true, result.side).answers, result.true)
    peers: dict[str, list[Peer]] = {key: [] for key in _ERRORS}
    for design, names in {} if quick or reconstructors else _OTHERS.items():
        other = _measured(design, "matched", _OF_OTHERS, {n: n for n in names}, progress)
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
                ours=name in (BEST, FREE),
                settings=_told(found, "0.8 to 1.2 N", count),
                command=f"chromagrip chart force --reconstructor {name}",
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


def _measured(
    design: str,
    kind: str,
    count: int,
    methods: dict[str, Choice] | dict[str, str],
    progress: Callable[[str], None],
) -> Result:
    return measure_domes({(design, kind): count}, methods, progress)[design, kind]


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
