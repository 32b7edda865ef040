"""Figs. 13 to 15 of the thesis: one object, three controllers, over time."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ...loop.trace import Trace
from ...output.figure import WIDTH, finish, legend_below, new_figure
from ...output.report import Row, Table, at_most, reported
from ...thesis import DESIRED_MARGIN, DURATION_S, LOAD_TIMES_S, LOADS_N
from .runs import CONTROLLERS, MARKERS, PLAIN, UNPRINTED, Job, Runs, Variant, make_job
from .statements import SHAPE_ONLY, Section, judged, near, number, over

Array = NDArray[np.float64]

#: Times at which the controller is switched on with the first load, and of the second load [s].
FIRST, SECOND = LOAD_TIMES_S
#: End of the run [s].
END = DURATION_S
#: Settled: within this share of the plateau for good. The thesis does not define it.
_SETTLED = 0.05
#: Precision of times in a sentence such as "0.1, 0.5 and 0.7 seconds" [s].
_READ = 0.1
#: Smallest swing of Γ that is visible in a plot: 1 % of its full height.
_VISIBLE = 0.01
#: Smallest swing of the command that is visible in a plot [N].
_VISIBLE_N = 0.05
#: Reason for a different overshoot.
_DRAG = "of the unprinted parameters, the drag changes it most"
#: Largest displacement that is drawn as none [mm].
NONE = 0.05


def validation_jobs(camera: str | None, sweep: list[Variant]) -> list[Job]:
    """The experiment with each controller, on the truth path and through a camera."""
    jobs = [make_job(name, v.changes) for v in (PLAIN, *sweep) for name in CONTROLLERS]
    return jobs + [make_job(name, camera=camera) for name in CONTROLLERS if camera]


def between(trace: Trace, name: str, start: float, stop: float) -> Array:
    """Column of a trace from an instant on, up to before another [s]."""
    time = trace["time_s"]
    return trace[name][(time > start - 1e-9) & (time < stop - 1e-9)]


def turns(values: Array, swing: float) -> int:
    """Number of turning points of a curve, of swings of at least `swing`."""
    count, side, extreme = 0, 0, values[0]
    for value in values:
        ahead = value - extreme
        if side and ahead * side > 0.0:
            extreme = value
        elif abs(ahead) >= swing:
            count, side, extreme = count + (side != 0), int(np.sign(ahead)), value
    return count


def settling(trace: Trace, goal: float, start: float, stop: float) -> float:
    """Time until ΣFf stays within a share of its plateau [s]; NaN if it does not."""
    force = between(trace, "friction_true_n", start, stop)
    (off,) = np.nonzero(np.abs(force - goal) > _SETTLED * goal)
    time = between(trace, "time_s", start, stop)
    if len(off) == 0:
        return 0.0
    return math.nan if off[-1] + 1 == len(force) else float(time[off[-1] + 1]) - start


def step_time(trace: Trace) -> float:
    """Time at which the grip force rises by its largest step [s]; NaN if it never rises."""
    rise = np.diff(trace["grip_n"])
    k = int(rise.argmax())
    return float(trace["time_s"][k + 1]) if rise[k] > 0.0 else math.nan


def _curves(axes: Axes, runs: Runs, camera: str | None, column: str) -> None:
    """A column of every controller, marked here and there; dashed and hollow through the camera."""
    for k, (name, (label, colour)) in enumerate(CONTROLLERS.items()):
        look: dict[str, Any] = {"color": colour, "marker": MARKERS[name], "ms": 5.0}
        trace = runs.traces[make_job(name)]
        each = len(trace["time_s"]) // 8
        there = (each // 4 * (k + 1), each)
        axes.plot(trace["time_s"], trace[column], lw=1.4, label=label, markevery=there, **look)
        if camera:
            trace = runs.traces[make_job(name, camera=camera)]
            look |= {"ls": "--", "lw": 1.0, "mfc": "white"}
            between_those = (there[0] + each // 2, each)
            axes.plot(trace["time_s"], trace[column], markevery=between_those, **look)
    if camera:
        look = {"color": "0.4", "lw": 1.0, "marker": "o", "mfc": "white", "ms": 5.0}
        axes.plot([], [], "--", label=f"through the camera, scene {camera}", **look)
    axes.axvline(SECOND, color="0.6", lw=0.8, label="second load")


def _legend(figure: Figure, axes: Axes) -> None:
    """One legend for all panels, of the lines of one of them."""
    legend_below(figure, axes.get_legend_handles_labels()[0], 3)


def figure_13(runs: Runs, camera: str | None) -> Section:
    """Load and grip force."""
    figure = new_figure("Fig. 13: load and grip force, µ 0.5, 200 kPa, flat", WIDTH, 5.4, UNPRINTED)
    load, grip = figure.subplots(2, 1, sharex=True, height_ratios=(1, 3))
    safe, hold, slip = (runs.traces[make_job(name)] for name in CONTROLLERS)
    load.step(safe["time_s"], safe["load_n"], where="post", color="0.3", label="load")
    finish(load, "load [N]", legend=False)
    _curves(grip, runs, camera, "grip_n")
    finish(grip, "grip force [N]", "time [s]", legend=False)
    _legend(figure, grip)
    at = step_time(slip)
    before, after = (between(slip, "grip_n", a, b) for a, b in ((0.0, at), (at, END)))
    gripped = safe["grip_n"][safe["time_s"] >= FIRST - 1e-9]
    checks = [
        near(("figure-13", "safety-margin", "lowest-grip"), float(gripped.min()), 1e-6),
        over(
            ("figure-13", "safety-margin", "first-turns"),
            turns(between(safe, "grip_n", FIRST, 0.5), _VISIBLE_N),
            2.0,
        ),
        near(
            ("figure-13", "safety-margin", "second-turns"),
            turns(between(safe, "grip_n", SECOND, END), _VISIBLE_N),
            0.0,
        ),
        near(("figure-13", "conservative", "grip"), _constant(hold["grip_n"]), 1e-9),
        near(("figure-13", "react-to-slip", "grip"), _constant(before), 1e-9),
        near(("figure-13", "react-to-slip", "step"), float(after[0] - before[-1]), 1e-9),
        near(("figure-13", "react-to-slip", "step-time"), at, 0.05),
    ]
    rows = _camera_rows("figure-13", runs, camera)
    if camera:
        time = step_time(runs.traces[make_job("react-to-slip", camera=camera)])
        name = ("figure-13", "camera", camera, "react-to-slip", "step_time")
        rows.append(reported(name, time, "s"))
    return judged(
        "figure-13",
        "Grip force during controller validation",
        figure,
        checks,
        rows=rows,
        notes=[
            f"A turn counts where the force swings by {_VISIBLE_N:g} N or more, 1 % of the axis.",
            SHAPE_ONLY,
        ],
    )


def _constant(values: Array) -> float:
    """The value of a curve that has only one; NaN of others."""
    return float(values[0]) if len(values) and np.ptp(values) == 0.0 else math.nan


def figure_14(runs: Runs, camera: str | None, sweep: list[Variant]) -> Section:
    """Normal force, friction force and safety margin."""
    figure = new_figure("Fig. 14: contact forces and safety margin", WIDTH, 8.0, UNPRINTED)
    panels = figure.subplots(3, 1, sharex=True)
    columns = {"normal_true_n": "ΣFn [N]", "friction_true_n": "ΣFf [N]", "margin_true": "Γ"}
    for axes, (column, label) in zip(panels, columns.items(), strict=True):
        _curves(axes, runs, camera, column)
        finish(axes, label, "time [s]" if axes is panels[-1] else "", legend=False)
    panels[-1].axhline(DESIRED_MARGIN, color="0.2", lw=1.0, ls=":", label="desired Γ")
    panels[-1].set_ylim(-0.1, 1.05)
    _legend(figure, panels[-1])
    traces = {name: runs.traces[make_job(name)] for name in CONTROLLERS}
    safe, slip = traces["safety-margin"], traces["react-to-slip"]
    ends = [between(t, "friction_true_n", 0.0, SECOND)[-1] for t in traces.values()]
    last = [t["friction_true_n"][-1] for t in traces.values()]
    initial = [between(trace, "margin_true", 0.0, FIRST)[-1] for trace in traces.values()]
    early = between(safe, "margin_true", 0.1, 0.2)
    slipping = _off(slip, 0.0, 0.8, step_time(slip))
    checks = [
        near(("figure-14", "plateau", "first"), _farthest(ends, LOADS_N[0]), 0.01),
        near(("figure-14", "plateau", "second"), _farthest(last, LOADS_N[1]), 0.01),
        *(
            near(("figure-14", "settling", name), settling(trace, LOADS_N[0], FIRST, SECOND), _READ)
            for name, trace in traces.items()
        ),
        near(("figure-14", "react-to-slip", "friction-rises"), _rises(slip), 0.05),
        near(("figure-14", "initial-margin"), _farthest(initial, 1.0), 0.01),
        *(
            near(
                ("figure-14", "safety-margin", name), _off(safe, DESIRED_MARGIN, start, stop), 0.02
            )
            for name, start, stop in (
                ("after-first-load", FIRST + 0.5, SECOND),
                ("after-second-load", SECOND + 0.5, END),
            )
        ),
        near(("figure-14", "safety-margin", "overshoot"), overshoot(safe), 2.0, _DRAG),
        over(("figure-14", "safety-margin", "fluctuates"), turns(early, _VISIBLE), 1.0),
        near(("figure-14", "react-to-slip", "slipping"), slipping, _SETTLED),
    ]
    rows = [at_most(("figure-14", "overshoot_target"), overshoot(safe), "points", 10.0)]
    rows += _camera_rows("figure-14", runs, camera)
    notes = [
        f"Settled: ΣFf within {100 * _SETTLED:g} % of its plateau for good, counted from the load. "
        f"The thesis does not define it: ±{_READ:g} s are allowed.",
        "Overshoot: depth of Γ below 0.30, after either load.",
        SHAPE_ONLY,
    ]
    return judged(
        "figure-14",
        "Contact forces and safety margin",
        figure,
        checks,
        rows=rows,
        tables=[_sweep_table(runs, sweep)] if sweep else [],
        notes=notes,
    )


def _sweep_table(runs: Runs, sweep: list[Variant]) -> Table:
    """Effect of each unprinted parameter on overshoot, slip and settling."""
    settled = [f"{label} settles [s]" for label, _ in CONTROLLERS.values()]
    names = [
        ("figure-14", "safety-margin", "overshoot"),
        ("figure-13", "react-to-slip", "step-time"),
    ]
    names += [("figure-14", "settling", name) for name in CONTROLLERS]
    lines = [("thesis", *(f"{number(*name):g}" for name in names))]
    for variant in (PLAIN, *sweep):
        traces = {name: runs.traces[make_job(name, variant.changes)] for name in CONTROLLERS}
        values = [overshoot(traces["safety-margin"]), step_time(traces["react-to-slip"])]
        values += [settling(trace, LOADS_N[0], FIRST, SECOND) for trace in traces.values()]
        # NaN: not within the experiment.
        lines.append((variant.text, *(f"{v:.3g}" if math.isfinite(v) else "–" for v in values)))
    header = ("", "overshoot [points]", "React To Slip steps at [s]", *settled)
    return Table(header, tuple(lines))


def overshoot(trace: Trace) -> float:
    """Largest depth of Γ below the desired margin [points]."""
    return 100.0 * (DESIRED_MARGIN - float(np.nanmin(between(trace, "margin_true", FIRST, END))))


def _rises(trace: Trace) -> float:
    """Time at which ΣFf has risen by a tenth of the way from plateau to plateau [s]."""
    level = LOADS_N[0] + 0.1 * (LOADS_N[1] - LOADS_N[0])
    (above,) = np.nonzero(trace["friction_true_n"] > level)
    return float(trace["time_s"][above[0]]) if len(above) else math.nan


def _farthest(values: Iterable[float], goal: float) -> float:
    """The value that is farthest from the goal."""
    return float(max(values, key=lambda value: abs(value - goal)))


def _off(trace: Trace, goal: float, start: float, stop: float) -> float:
    """Γ farthest from a goal between two times [s]."""
    values = between(trace, "margin_true", start, stop)
    return _farthest(values, goal) if len(values) and math.isfinite(values.sum()) else math.nan


def figure_15(runs: Runs, camera: str | None) -> Section:
    """Pressure and lateral displacement."""
    figure = new_figure("Fig. 15: pressure and lateral displacement", WIDTH, 6.2, UNPRINTED)
    pressed, moved = figure.subplots(2, 1, sharex=True)
    _curves(pressed, runs, camera, "pressure_n_per_m")
    _curves(moved, runs, camera, "lateral_displacement_mm")
    finish(pressed, "pressure [N/m]", legend=False)
    finish(moved, "displacement [mm]", "time [s]", legend=False)
    _legend(figure, pressed)
    safe, hold, slip = (runs.traces[make_job(name)] for name in CONTROLLERS)
    pressures = [between(t, "pressure_n_per_m", FIRST, END) for t in (safe, hold, slip)]
    highest = np.mean(pressures[1] > np.fmax(pressures[0], pressures[2]))
    at = step_time(slip)
    checks = [
        near(("figure-15", "displacement", "react-to-slip"), _displaced(slip), 0.05),
        near(("figure-15", "displacement", "safety-margin"), _displaced(safe), NONE),
        near(("figure-15", "displacement", "conservative"), _displaced(hold), NONE),
        near(("figure-15", "constant-rate"), _bend(slip, SECOND, at), 5.0),
        near(("figure-15", "conservative-highest"), 100.0 * float(highest), 1e-9),
        over(
            ("figure-15", "react-over-safety-margin"),
            float(np.nanmax(pressures[2]) - np.nanmax(pressures[0])),
            0.0,
        ),
        over(("figure-15", "bumps"), _bumps(slip, at, at + 0.1), 1.0),
    ]
    rows = _camera_rows("figure-15", runs, camera)
    notes = [
        "The thesis's Pa is N/m: its contact has a width and no area (E3).",
        "Constant rate: a straight line is fitted to the displacement between the second load and "
        "the step; its largest error is given as a share of the growth of the displacement.",
        SHAPE_ONLY,
    ]
    return judged(
        "figure-15", "Pressure and lateral displacement", figure, checks, rows=rows, notes=notes
    )


def _displaced(trace: Trace) -> float:
    return float(trace["lateral_displacement_mm"][-1])


def _bend(trace: Trace, start: float, stop: float) -> float:
    """Largest distance of a displacement from a straight line while it slips [% of its growth].

    The skin is sheared before all of it slips: only displacements over 0.05 mm are used.
    """
    if not math.isfinite(stop):
        return math.nan
    time = between(trace, "time_s", start, stop)
    moved = between(trace, "lateral_displacement_mm", start, stop)
    time, moved = time[moved > NONE], moved[moved > NONE]
    if len(time) < 3:
        return math.nan
    line = np.polyval(np.polyfit(time, moved, 1), time)
    return float(100.0 * np.abs(moved - line).max() / np.ptp(moved))


def _bumps(trace: Trace, start: float, stop: float) -> int:
    """Falls of the pressure while ΣFn rises."""
    if not math.isfinite(start):
        return 0
    press, normal = (
        np.diff(between(trace, name, start, stop)) for name in ("pressure_n_per_m", "normal_true_n")
    )
    return int(((press < 0.0) & (normal > 0.0)).sum())


def _camera_rows(part: str, runs: Runs, camera: str | None) -> list[Row]:
    """Quantities of a figure through the camera, and the error of the estimated Γ."""
    rows = []
    for name in CONTROLLERS if camera else ():
        job = make_job(name, camera=camera)
        trace = runs.traces[job]
        largest_step = max(float(np.diff(trace["grip_n"]).max()), 0.0)
        scores: dict[str, dict[str, tuple[float | None, str]]] = {
            "figure-13": {
                "largest_grip": (float(trace["grip_n"].max()), "N"),
                "largest_step": (largest_step, "N"),
            },
            "figure-14": {
                "after_first_load": (_off(trace, DESIRED_MARGIN, FIRST + 0.5, SECOND), ""),
                "after_second_load": (_off(trace, DESIRED_MARGIN, SECOND + 0.5, END), ""),
            },
            "figure-15": {
                "largest_pressure": (float(np.nanmax(trace["pressure_n_per_m"])), "N/m"),
                "displacement": (_displaced(trace), "mm"),
            },
        }
        scores[part]["margin_rmse"] = (runs.cells[job].margin_rmse, "")
        for score, (value, unit) in scores[part].items():
            rows.append(reported((part, "camera", str(camera), name, score), value, unit))
    return rows
