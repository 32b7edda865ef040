"""Figures of the world `dome`: rows, targets and tables."""

from collections.abc import Iterator, Mapping, Sequence

from ...output.report import Bounds, Report, Row, Table, measured, number, values
from ...tracking import load_reconstructor
from ..study import Asked, Study, study
from ..worlds.dome.across import DESIGN, WORLDS
from ..worlds.dome.readings import NEAR, UNITS, constant, scores
from ..worlds.dome.scenes import NOMINAL, TURNED
from ..worlds.dome.sets import (
    BEST,
    DOME_GROUPS,
    ELEMENTS,
    NEXT,
    SOFT,
    DomeResult,
    DomeTask,
    by_set,
    counts_of,
    measure_scene,
    tasks,
)
from ..worlds.force_scores import CONSTANT

#: Name of the world.
DOME = "dome"
#: Largest RMS error of Γ near .1, .3 and .6, by design.
_MARGINS = {
    "dome-2020": (0.065, 0.105, 0.18),
    "dome-2022": (0.05, 0.085, 0.10),
    NEXT: (0.05, 0.065, 0.085),
}
#: Quantities of which the interval is held to its coverage, and at most one frame in 200 is wrong,
#: narrow and unflagged.
_COVERED = ("normal", "friction", "margin")


def _bounds(design: str, kind: str) -> dict[str, Bounds]:
    """Targets of BEST in a set, by score."""
    if kind == NOMINAL:  # what a specimen costs that was not calibrated
        return {}
    if kind == "unlike":
        return {"flagged": Bounds(low=90.0)}
    if kind == ELEMENTS:
        return {"normal_share": Bounds(high=8.0)}
    if kind == TURNED:
        return {"normal_share": Bounds(high=6.0), "torque_share": Bounds(high=6.0)}
    honest = {f"{quantity}_coverage": Bounds(85.0, 95.0) for quantity in _COVERED}
    honest |= {f"{quantity}_narrow": Bounds(high=0.5) for quantity in (*_COVERED, "mu")}
    if kind == "light":
        return honest
    if kind == SOFT:
        return honest | {
            "normal_share": Bounds(high=1.5),
            "side_x": Bounds(high=0.01),
            "side_y": Bounds(high=0.01),
            "mu_error": Bounds(high=0.04),
            "margin_30": Bounds(high=0.03),
        }
    near = zip(NEAR, _MARGINS[design], strict=True)
    return {
        "normal_share": Bounds(high=6.0),
        "side_share": Bounds(high=5.0),
        **{f"margin_{name}": Bounds(high=most) for name, most in near},
        **honest,
        **({"rate": Bounds(low=60.0)} if kind == "matched" else {}),
    }


@study(
    "bench",
    "force",
    worlds=(DOME,),
    method="reconstructor",
    parts=DOME_GROUPS,
    of_parts="group",
)
def dome_study(asked: Asked) -> Study[DomeTask, DomeResult]:
    """Reconstructors on pictures of domes of silicone, made without the chain.

    Rows are `dome/DESIGN/SET/score`. Those of another estimator than `contact` have its name before
    the score, as has the constant answer. Rows of all worlds are
    `dome/thesis/WORLD/ESTIMATOR/score`. Unless estimators are chosen, those are measured that have
    targets, and those that are compared.
    """
    own = asked.chosen((), load_reconstructor)
    return Study(
        settings=tasks(counts_of(asked.quick, asked.only), own, asked.beside),
        measure=measure_scene,
        result=DomeResult,
        report=lambda results: report_of(by_set(results)),
        words=lambda task: f"{task.design}, {task.kind}",
    )


def report_of(sets: Mapping[tuple[str, str], DomeResult]) -> Report:
    """Report of measured sets, by design and set."""
    rows = [row for (design, kind), result in sets.items() for row in _rows(design, kind, result)]
    mine = {key: result for key, result in sets.items() if key[0] != DESIGN or key[1] == SOFT}
    both = [set_table(rows, mine), quantity_table(rows, mine), across_table(rows, sets)]
    return Report(
        rows=tuple(rows),
        tables=tuple(table for table in both if table.lines),
        notes=_NOTES,
    )


def _rows(design: str, kind: str, result: DomeResult) -> Iterator[Row]:
    guess = constant(result.true, result.side)
    guessed = scores(guess, result.true, result.side)
    for method, reading in {CONSTANT: guess, **result.readings}.items():
        mine = method == BEST and (design != DESIGN or kind == SOFT)
        bounds = _bounds(design, kind) if mine else {}
        for score, value in scores(reading, result.true, result.side).items():
            target = bounds.get(score)
            passes = target is not None and score != "flagged" and target.hold(guessed[score])
            note = "a constant answer passes" if passes else ""
            name = (*subject(design, kind, method), score)
            yield measured(name, value, UNITS[score], target, note)


def subject(design: str, kind: str, method: str) -> tuple[str, ...]:
    """Name of an estimator's rows in a set, without the score."""
    if design != DESIGN and method == BEST:
        return DOME, design, kind
    return DOME, design, kind, method


#: Columns of the table of sets: heading, score, format.
_SETS = (
    ("ΣFn %", "normal_share", ".1f"),
    ("Fx N", "side_x", ".3f"),
    ("Fy N", "side_y", ".3f"),
    ("along the skin %", "side_share", ".1f"),
    ("µ", "mu_error", ".3f"),
    ("Γ≈.1", "margin_10", ".3f"),
    ("Γ≈.3", "margin_30", ".3f"),
    ("Γ≈.6", "margin_60", ".3f"),
    ("flagged %", "flagged", ".0f"),
    ("fields/s", "rate", ".0f"),
    ("late %", "late", ".0f"),
    ("frames", "frames", ".0f"),
)


def set_table(rows: Sequence[Row], sets: Mapping[tuple[str, str], DomeResult]) -> Table:
    """RMS errors of each set of the designs that `contact` reads."""
    found = values(rows)
    lines = [
        (
            f"{design}, {kind}, {method}",
            *(number(found.get((*subject(design, kind, method), s)), f) for _, s, f in _SETS),
        )
        for (design, kind), result in sets.items()
        for method in (CONSTANT, *result.readings)
    ]
    title = "Pictures of domes: RMS errors of the frames that are read"
    return Table(("design, set", *(heading for heading, *_ in _SETS)), tuple(lines), title)


def quantity_table(rows: Sequence[Row], sets: Mapping[tuple[str, str], DomeResult]) -> Table:
    """Whether the intervals of each set hold."""
    found = values(rows)
    quantities = {"normal": "ΣFn", "friction": "ΣFf", "mu": "µ", "margin": "Γ"}

    def cell(start: tuple[str, ...], quantity: str) -> str:
        pair = (found.get((*start, f"{quantity}_{s}")) for s in ("coverage", "narrow"))
        return " / ".join(number(value, ".1f") for value in pair)

    lines = [
        (
            f"{design}, {kind}, {method}",
            *(cell(subject(design, kind, method), quantity) for quantity in quantities),
        )
        for (design, kind), result in sets.items()
        for method in result.readings
    ]
    title = "Inside the 90 % interval / wrong, narrow and unflagged [%]"
    return Table(("design, set", *quantities.values()), tuple(lines), title)


#: Scores of a cell of the table of worlds, with their formats.
_ACROSS = (
    ("normal_share", ".0f"),
    ("margin_30", ".2f"),
    ("normal_coverage", ".0f"),
    ("margin_coverage", ".0f"),
    ("flagged", ".0f"),
    ("normal_narrow", ".0f"),
    ("margin_narrow", ".0f"),
)


def across_table(rows: Sequence[Row], sets: Mapping[tuple[str, str], DomeResult]) -> Table:
    """All estimators in all worlds, of the design of the thesis."""
    found = values(rows)
    worlds = [world for world in WORLDS if (DESIGN, world) in sets]
    names = dict.fromkeys(name for world in worlds for name in sets[DESIGN, world].readings)

    def cell(world: str, name: str) -> str:
        start = subject(DESIGN, world, name)
        return " / ".join(number(found.get((*start, s)), form) for s, form in _ACROSS)

    lines = [
        (name, *(cell(world, name) for world in worlds))
        for name in ((CONSTANT, *names) if worlds else ())
    ]
    title = (
        "Who draws (columns) and who reads (rows), design of the thesis: error of ΣFn [%] / of "
        "Γ≈.3 / inside the interval of ΣFn [%] / of Γ [%] / flagged [%] / wrong, narrow and "
        "unflagged in ΣFn [%] / in Γ [%]"
    )
    return Table(("", *worlds), tuple(lines), title)


#: Explanation of the tables.
_NOTES = (
    "Pictures of domes of silicone. Objects are planes, tilted planes, balls and rods in turns, "
    "pressed by 2.4 to 3.6 N and loaded in any direction to Γ ≈ .6, .3 and .1; `light`: a third. "
    "Specimens have the defects of their design, the camera's noise is 2 levels. `mismatched`: "
    "another renderer, a finer mesh, E ± 10 %, thickness ± 3 %, depths ± .05 mm, ν ± .01, image "
    "± .5 px, roll ± .5°. Each of eight such specimens (of `chromatouch-next`: two) was "
    "calibrated from eight noisy presses, and estimators are told that; `mismatched-nominal`: some "
    "of these scenes, read as if the specimens were as designed. `unlike`: a bumpy mesh, two "
    "balls, an edge of a box below and beside, a ring. `soft`: `thesis` at 0.8 to 1.2 N. "
    "`elements`: presses of Neo-Hookean finite elements at 1, 2 and 3 N, without a load. `turned`: "
    "as `mismatched`, without a load, and turned by 5 to 25°.",
    "Each scene is read frame by frame from before the touch, and scored where grip and load are "
    "held. `along the skin`: error of the vector ΣFf over its size. Wrong, narrow and unflagged: "
    "the truth lies further off than twice the half-width. `fields/s` are of processor time, the "
    "median of the scenes. Late: scenes that took more than 15 s, of which from then on only the "
    "scored frames are read. Rows without an estimator's name are of `contact`.",
)
