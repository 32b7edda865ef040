"""Fig. 17 of the thesis: the desired margin and the step size, pressure against displacement."""

from itertools import pairwise

import numpy as np
from matplotlib.figure import Figure

from ...output.figure import WIDTH, finish, new_figure
from ...output.report import Row, Table, at_most, reported
from ...thesis import LOADS_N
from .figures_13_to_15 import NONE
from .runs import CONTROLLERS, PLAIN, UNPRINTED, Cell, Job, Runs, Variant, make_job
from .statements import SHAPE_ONLY, Section, judged, near, over

#: Desired margins of Safety Margin Control and steps of React To Slip [N], in increasing order.
MARGINS = (0.09, 0.10, 0.11, 0.12, 0.15, 0.20, 0.25, 0.30, 0.40, 0.50, 0.60, 0.70, 0.80)
STEPS = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0)
_SMALLEST = MARGINS[:2]
#: The same in a quick run.
QUICK_MARGINS = (0.09, 0.10, 0.12, 0.30, 0.60, 0.80)
QUICK_STEPS = (0.25, 0.5, 1.0, 2.0, 3.0)
#: Step of React To Slip in the experiment [N].
_STEP = 2.0
#: Smallest slip of the whole contact that counts as slip [mm].
_SLIP = 0.1
_REASON = "it slips as far as it overshoots, which depends on the unprinted drag (Fig. 14)"
#: Share of a pressure by which it may fall as a node joins the contact.
_BUMP = 0.01
#: Friction coefficient of the object.
_FRICTION = 0.5
#: Grip force of React To Slip before its first step [N].
_START = 0.5


def margin_job(margin: float, variant: Variant = PLAIN) -> Job:
    """Job of Safety Margin Control with another desired margin."""
    changes = {"safety_margin.desired_margin": margin, **variant.changes}
    return make_job("safety-margin", changes)


def step_job(step: float) -> Job:
    """Job of React To Slip with another step [N]."""
    return make_job("react-to-slip", {"react_to_slip.step_n": step})


def setting_jobs(quick: bool, sweep: list[Variant]) -> list[Job]:
    """Every setting, and the smallest margins with each unprinted parameter changed."""
    margins, steps = (QUICK_MARGINS, QUICK_STEPS) if quick else (MARGINS, STEPS)
    turned = [margin_job(margin, variant) for variant in sweep for margin in _SMALLEST]
    return [*map(margin_job, margins), *map(step_job, steps), *turned]


def figure_17(runs: Runs, quick: bool, sweep: list[Variant]) -> Section:
    """Pressure and displacement over both settings."""
    margins, steps = (QUICK_MARGINS, QUICK_STEPS) if quick else (MARGINS, STEPS)
    safe = {margin: runs.cells[margin_job(margin)] for margin in margins}
    react = {step: runs.cells[step_job(step)] for step in steps}
    nine, ten, usual = safe[0.09], safe[0.10], react[_STEP]
    held = LOADS_N[1] / _FRICTION - _START
    checks = [
        near(("figure-17", "margin", "pressure-falls"), _falling(safe), 0.0),
        over(("figure-17", "margin", "slips-at-9"), nine.rigid_slip, _SLIP, _REASON),
        over(("figure-17", "margin", "slips-at-10"), ten.rigid_slip, _SLIP, _REASON),
        near(
            ("figure-17", "margin", "slips-above"),
            float(np.max([cell.rigid_slip for margin, cell in safe.items() if margin > 0.105])),
            _SLIP,
        ),
        over(
            ("figure-17", "margin", "more-displacement-at-9"),
            nine.displacement - usual.displacement,
            NONE,
            _REASON,
        ),
        over(
            ("figure-17", "margin", "more-pressure-at-9"),
            nine.pressure_pitch - usual.pressure_pitch,
            0.0,
            _REASON,
        ),
        near(("figure-17", "step", "pressure-falls"), _falling(react), 0.0),
        over(
            ("figure-17", "step", "displacement-grows"),
            react[0.25].displacement - react[0.5].displacement,
            NONE,
        ),
        over(
            ("figure-17", "step", "lowest-pressure"),
            min(cell.pressure_pitch for cell in safe.values())
            - float(np.max([react[step].pressure_pitch for step in (0.25, 0.5)])),
            0.0,
        ),
    ]
    return judged(
        "figure-17",
        "Desired margin and step size",
        _drawn(safe, react),
        checks,
        rows=_rows(safe, react),
        tables=[_sweep_table(runs, sweep)] if sweep else [],
        notes=[
            f"Slip is the sliding of the whole contact, above {_SLIP:g} mm.",
            "Which settings were run is not printed beyond their range; compared with React To "
            f"Slip's step of {_STEP:g} N.",
            f"Coulomb: a step of {held:g} N or more makes the grip hold {LOADS_N[1]:g} N; "
            "after a smaller one the object slides on.",
            SHAPE_ONLY,
        ],
    )


def _falling(results: dict[float, Cell]) -> int:
    """Neighbours where a larger setting presses less, beyond the bumps of the pressure."""
    line = [cell.pressure_pitch for cell in results.values()]
    return sum(not after > (1.0 - _BUMP) * before for before, after in pairwise(line))


def _rows(safe: dict[float, Cell], react: dict[float, Cell]) -> list[Row]:
    slips = [margin for margin, cell in safe.items() if cell.rigid_slip > _SLIP]
    most = 100.0 * max(slips, default=0.0)
    rows = [at_most(("figure-17", "largest_margin_that_slips"), most, "%", 10.0)]
    for start, results in (("margin", safe), ("step", react)):
        for setting, cell in results.items():
            subject = ("figure-17", start, f"{setting:g}")
            rows.append(reported((*subject, "pressure"), cell.pressure_pitch, "N/m"))
            rows.append(reported((*subject, "displacement"), cell.displacement, "mm"))
            rows.append(reported((*subject, "rigid_slip"), cell.rigid_slip, "mm"))
    return rows


def _sweep_table(runs: Runs, sweep: list[Variant]) -> Table:
    """Effect of each unprinted parameter on slip at the smallest margins."""
    lines = []
    for variant in (PLAIN, *sweep):
        slips = [runs.cells[margin_job(margin, variant)].rigid_slip for margin in _SMALLEST]
        lines.append((variant.text, *(f"{slip:.3f}" for slip in slips)))
    header = ("slip of the whole contact [mm]", *(f"{100 * m:g} %" for m in _SMALLEST))
    return Table(header, tuple(lines))


def _drawn(safe: dict[float, Cell], react: dict[float, Cell]) -> Figure:
    figure = new_figure(
        "Fig. 17: desired margin and step size, µ 0.5, 200 kPa, flat", WIDTH, 5.4, UNPRINTED
    )
    panels = figure.subplots(2, 2, sharey="row", sharex="col")
    for column, (name, results, scale, across) in enumerate(
        (
            ("safety-margin", safe, 100.0, "desired margin [%]"),
            ("react-to-slip", react, 1.0, "step [N]"),
        )
    ):
        label, colour = CONTROLLERS[name]
        pressed, moved = panels[:, column]
        x = [scale * setting for setting in results]
        pressed.plot(x, [c.pressure_pitch for c in results.values()], "o-", color=colour)
        moved.plot(
            x, [c.displacement for c in results.values()], "o-", color=colour, label="lateral"
        )
        moved.plot(
            x, [c.rigid_slip for c in results.values()], "x:", color=colour, label="rigid slip"
        )
        y_label = "pressure [N/m]" if column == 0 else ""
        finish(pressed, y_label, legend=False, title=label)
        finish(moved, "displacement [mm]" if column == 0 else "", across)
    return figure
