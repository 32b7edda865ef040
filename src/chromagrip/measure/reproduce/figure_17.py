"""Fig. 17 of the thesis: the desired margin and the step size, pressure against displacement."""

from itertools import pairwise

from matplotlib.figure import Figure

from ...output.figure import CONTROLLERS, finish, new_figure
from ...output.rows import Row, at_most, reported
from .figures_13_to_15 import NONE
from .runs import Cell, Job, Runs, largest, make_job
from .statements import Section, judged, near, over
from .sweep import PLAIN, Variant

#: Desired margins of Safety Margin Control and steps of React To Slip [N], in increasing order.
MARGINS = (0.09, 0.10, 0.11, 0.12, 0.15, 0.20, 0.25, 0.30, 0.40, 0.50, 0.60, 0.70, 0.80)
STEPS = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0)
_SMALLEST = MARGINS[:2]
QUICK_MARGINS, QUICK_STEPS = (0.09, 0.10, 0.12, 0.30, 0.60, 0.80), (0.25, 0.5, 1.0, 2.0, 3.0)
#: The experiment's step [N], and the slip of the whole contact that counts as slip [mm].
_STEP, _SLIP = 2.0, 0.1
_REASON = "it slips as far as it overshoots, which the unprinted drag decides (Fig. 14)"
#: Share of a pressure by which it may fall as a node joins the contact.
_BUMP = 0.01
_FRICTION, _LOAD, _START = 0.5, 0.65, 0.5  # µ, load and first grip [N]


def margin_job(margin: float, variant: Variant = PLAIN) -> Job:
    """Job of Safety Margin Control with another desired margin."""
    changes = {"safety_margin.desired_margin": margin, **variant.changes}
    return make_job("safety-margin", changes)


def step_job(step: float) -> Job:
    """Job of React To Slip with another step [N]."""
    return make_job("react-to-slip", {"react_to_slip.step_n": step})


def setting_jobs(quick: bool, sweep: list[Variant]) -> list[Job]:
    """Every setting, and the smallest margins with what is not printed turned."""
    margins, steps = (QUICK_MARGINS, QUICK_STEPS) if quick else (MARGINS, STEPS)
    turned = [margin_job(margin, variant) for variant in sweep for margin in _SMALLEST]
    return [*map(margin_job, margins), *map(step_job, steps), *turned]


def figure_17(runs: Runs, quick: bool, sweep: list[Variant]) -> Section:
    """Pressure and displacement over both settings."""
    margins, steps = (QUICK_MARGINS, QUICK_STEPS) if quick else (MARGINS, STEPS)
    safe = {margin: runs.cells[margin_job(margin)] for margin in margins}
    react = {step: runs.cells[step_job(step)] for step in steps}
    nine, ten, usual = safe[0.09], safe[0.10], react[_STEP]
    held = _LOAD / _FRICTION - _START
    checks = [
        near("figure-17/margin/pressure-falls", _falling(safe), 0.0),
        over("figure-17/margin/slips-at-9", nine.rigid_slip, _SLIP, _REASON),
        over("figure-17/margin/slips-at-10", ten.rigid_slip, _SLIP, _REASON),
        near(
            "figure-17/margin/slips-above",
            largest(cell.rigid_slip for margin, cell in safe.items() if margin > 0.105),
            _SLIP,
        ),
        over(
            "figure-17/margin/more-displacement-at-9",
            nine.displacement - usual.displacement,
            NONE,
            _REASON,
        ),
        over(
            "figure-17/margin/more-pressure-at-9",
            nine.pressure_pitch - usual.pressure_pitch,
            0.0,
            _REASON,
        ),
        near("figure-17/step/pressure-falls", _falling(react), 0.0),
        over(
            "figure-17/step/displacement-grows",
            react[0.25].displacement - react[0.5].displacement,
            NONE,
        ),
        over(
            "figure-17/step/lowest-pressure",
            min(cell.pressure_pitch for cell in safe.values())
            - largest(react[step].pressure_pitch for step in (0.25, 0.5)),
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
            f"Coulomb: after one step the grip holds {_LOAD:g} N from a step of {held:g} N on; "
            "below, the object slides on after the step.",
            "Curves: shape only.",
        ],
    )


def _falling(found: dict[float, Cell]) -> int:
    """Neighbours where a larger setting presses less, beyond the bumps of the pressure."""
    line = [cell.pressure_pitch for cell in found.values()]
    return sum(not after > (1.0 - _BUMP) * before for before, after in pairwise(line))


def _rows(safe: dict[float, Cell], react: dict[float, Cell]) -> list[Row]:
    slips = [margin for margin, cell in safe.items() if cell.rigid_slip > _SLIP]
    most = 100.0 * max(slips, default=0.0)
    rows = [at_most("figure-17/largest_margin_that_slips", most, "%", 10.0)]
    for start, found in (("margin", safe), ("step", react)):
        for setting, cell in found.items():
            name = f"figure-17/{start}/{setting:g}"
            rows.append(reported(f"{name}/pressure", cell.pressure_pitch, "N/m"))
            rows.append(reported(f"{name}/displacement", cell.displacement, "mm"))
            rows.append(reported(f"{name}/rigid_slip", cell.rigid_slip, "mm"))
    return rows


def _sweep_table(runs: Runs, sweep: list[Variant]) -> list[list[str]]:
    """What each unprinted parameter does to slip at the smallest margins."""
    lines = [["slip of the whole contact [mm]", *(f"{100 * m:g} %" for m in _SMALLEST)]]
    for variant in (PLAIN, *sweep):
        slips = [runs.cells[margin_job(margin, variant)].rigid_slip for margin in _SMALLEST]
        lines.append([variant.text, *(f"{slip:.3f}" for slip in slips)])
    return lines


def _drawn(safe: dict[float, Cell], react: dict[float, Cell]) -> Figure:
    figure = new_figure("Fig. 17: desired margin and step size, µ 0.5, 200 kPa, flat", 9.0, 5.4)
    panels = figure.subplots(2, 2, sharey="row", sharex="col")
    for column, (name, found, scale, across) in enumerate(
        (
            ("safety-margin", safe, 100.0, "desired margin [%]"),
            ("react-to-slip", react, 1.0, "step [N]"),
        )
    ):
        label, colour = CONTROLLERS[name]
        pressed, moved = panels[:, column]
        x = [scale * setting for setting in found]
        pressed.plot(x, [c.pressure_pitch for c in found.values()], "o-", color=colour)
        moved.plot(x, [c.displacement for c in found.values()], "o-", color=colour, label="lateral")
        moved.plot(
            x, [c.rigid_slip for c in found.values()], "x:", color=colour, label="rigid slip"
        )
        pressed.set_title(label, fontsize=9)
        finish(pressed, "pressure [N/m]" if column == 0 else "", legend=False)
        finish(moved, "displacement [mm]" if column == 0 else "", across)
    return figure
