"""Figs. 9 to 11 of the thesis: the friction estimate, and when it is µ (E7)."""

from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ...model import ContactObject, Drive, Fingertip, ForceField, History, contact_forces, simulate
from ...output.figure import WIDTH, finish, new_figure
from ...tracking import THESIS_RULE, FrictionEstimate
from .runs import UNPRINTED
from .statements import SHAPE_ONLY, Section, judged, near, near_share, over, under

Array = NDArray[np.float64]

TIP = Fingertip()
OBJECT = ContactObject()
#: Grip force of the figures [N] (section 4.1).
GRIP = 1.0
#: Time at which the load comes [s].
LOADED = 0.5
#: End of a run [s].
END = 1.5
#: Time step of plant and estimate [s].
STEP = 1e-3
#: Load of Figs. 10 and 11 [N] (section 4.1).
LOAD = 0.1
#: Load that friction 0.5 cannot hold [N].
TOO_MUCH = 0.75
#: Friction coefficients of the figures, and their colours.
FRICTIONS = {0.3: "#e0a100", 0.5: "#c8442e", 0.7: "#1f5fa8"}
#: Marker of each, so that they differ by more than their colour.
MARKERS = {0.3: "o", 0.5: "s", 0.7: "^"}
#: Window of the estimate: 50 samples [s].
_WINDOW = 0.05
#: Share of µ from which on the ratio of a node counts as local slip.
_SLIPS = 0.98


@cache
def grasped(friction: float, load: float) -> History:
    """Press to a steady state, then pull."""
    drive = Drive(
        times=np.array([0.0, LOADED, LOADED]),
        normal=np.full(3, GRIP),
        lateral=np.array([0.0, 0.0, load]),
    )
    obj = replace(OBJECT, friction=friction)
    return simulate(TIP, obj, drive, dt=STEP, duration=END)


def at(friction: float, load: float, time: float) -> ForceField:
    """Contact forces at an instant [s]."""
    obj = replace(OBJECT, friction=friction)
    return contact_forces(TIP, obj, grasped(friction, load).state(round(time / STEP)))


def ratios(field: ForceField) -> tuple[Array, Array]:
    """Position [mm] and |Ff,i|/Fn,i of the nodes in contact."""
    touching = field.contact
    return (
        1e3 * field.position[touching, 0],
        np.abs(field.friction[touching]) / field.normal[touching],
    )


def slipping(field: ForceField, friction: float) -> int:
    """Nodes that slip locally."""
    return int((ratios(field)[1] >= _SLIPS * friction).sum())


@cache
def estimated(friction: float) -> tuple[Array, Array]:
    """ΣFn [N] and µ_est (Eq. 8) at every instant of the press and the pull, shape (T,) each."""
    run, obj = grasped(friction, LOAD), replace(OBJECT, friction=friction)
    estimate = FrictionEstimate(THESIS_RULE, _WINDOW)
    estimates = []
    for k, time in enumerate(run.time):
        field = contact_forces(TIP, obj, run.state(k))
        estimates.append((field.total_normal, estimate.update(float(time), field)[0]))
    normal, mu = np.array(estimates).T
    return normal, mu


def figure_9() -> Section:
    """Contact forces and local friction coefficients, pressed and slipping."""
    states = {"pressed": at(0.5, 0.0, END), "slipping": at(0.5, TOO_MUCH, END)}
    figure = new_figure(
        f"Fig. 9: contact forces and local friction, {GRIP:g} N, µ 0.5", WIDTH, 5.0, UNPRINTED
    )
    panels = figure.subplots(2, 2, sharex=True, sharey="row")
    for column, (name, field) in enumerate(states.items()):
        x, ratio = ratios(field)
        forces, local = panels[:, column]
        forces.plot(x, 1e3 * field.normal[field.contact], "o-", ms=3, label="normal")
        forces.plot(x, 1e3 * field.friction[field.contact], "x-", ms=4, label="friction")
        local.plot(x, ratio, ".-", ms=3, color="#c8442e", label="local |Ff|/Fn")
        local.axhline(0.5, color="0.4", lw=0.8, ls=":", label="µ")
        margin = 100.0 * field.safety_margin(0.5)
        title = f"{'ab'[column]}: {name}, Γ = {abs(margin):.0f} %"
        finish(forces, "force [mN]" if column == 0 else "", title=title)
        finish(local, "local friction" if column == 0 else "", "x [mm]")
    pressed, slips = states["pressed"], states["slipping"]
    checks = [
        near(("figure-9", "pressed", "margin"), pressed.safety_margin(0.5), 0.01),
        under(
            ("figure-9", "pressed", "largest-ratio"), float(ratios(pressed)[1].max()), _SLIPS * 0.5
        ),
        # Γ is 0 but for the last digits.
        near(("figure-9", "slipping", "margin"), round(slips.safety_margin(0.5), 9), 0.01),
        near(("figure-9", "slipping", "smallest-ratio"), float(ratios(slips)[1].min()), 0.01),
    ]
    notes = [
        "Grip and load of Fig. 9 are not printed: the grip of Fig. 10 is used.",
        SHAPE_ONLY,
    ]
    return judged(
        "figure-9", "Forces and local friction at Γ of 100 and 0 %", figure, checks, notes=notes
    )


def figure_10() -> Section:
    """The estimate on first contact, and once there is a load."""
    figure = new_figure(
        f"Fig. 10: estimated friction, {GRIP:g} N, then a load of {LOAD} N", WIDTH, 3.8, UNPRINTED
    )
    over_normal, over_time = figure.subplots(1, 2, sharey=True)
    checks = []
    before = round(LOADED / STEP) - 1
    for mu, colour in FRICTIONS.items():
        normal, estimate = estimated(mu)
        look = {"color": colour, "marker": MARKERS[mu], "markevery": 0.12, "label": f"µ = {mu}"}
        over_normal.plot(normal, estimate, **look)
        over_time.plot(STEP * np.arange(len(estimate)), estimate, **look)
        for axes in (over_normal, over_time):
            axes.axhline(mu, color=colour, lw=0.9, ls=":", label="true µ" if mu == 0.7 else None)
        checks.append(
            near_share(("figure-10", "first-contact", str(mu)), float(estimate[before]), 0.05)
        )
        checks.append(near_share(("figure-10", "loaded", str(mu)), float(estimate[-1]), 0.05))
    over_time.axvline(LOADED, color="0.4", lw=0.8)
    finish(over_normal, "µ_est", "ΣFn [N]", legend=False)
    finish(over_time, "", "time [s], load from 0.5 s", legend=False)
    # In a place that no curve crosses.
    over_normal.legend(fontsize=8, frameon=False, loc="upper center", bbox_to_anchor=(0.5, 0.92))
    notes = [
        "The ceiling of 0.4 on first contact is the tissue's Poisson factor, an artefact of the "
        "model (E7).",
        "Curves: shape only; the one over time is not in the thesis.",
    ]
    return judged("figure-10", "Estimated friction over ΣFn", figure, checks, notes=notes)


def figure_11() -> Section:
    """Local friction coefficients in a steady state."""
    figure = new_figure(f"Fig. 11: local friction, {GRIP:g} N, steady", WIDTH, 3.8, UNPRINTED)
    panels = figure.subplots(1, 2, sharey=True)
    loads = (0.0, LOAD)
    slips = {}
    for axes, load, letter in zip(panels, loads, "ab", strict=True):
        for mu in (0.3, 0.7):
            field = at(mu, load, END)
            slips[mu, load] = float(slipping(field, mu))
            look = {"color": FRICTIONS[mu], "marker": MARKERS[mu], "ms": 3.5}
            axes.plot(*ratios(field), label=f"µ = {mu}", **look)
            told = "true µ" if mu == 0.7 else None
            axes.axhline(mu, color=FRICTIONS[mu], lw=0.9, ls=":", label=told)
        title = f"{letter}: load {load:g} N"
        finish(axes, "local |Ff|/Fn" if load == 0.0 else "", "x [mm]", title=title)
    checks = [
        over(("figure-11", "pressed", "0.3"), slips[0.3, 0.0], 1.0),
        near(("figure-11", "pressed", "0.7"), slips[0.7, 0.0], 0.0),
        over(("figure-11", "loaded", "0.7"), slips[0.7, LOAD], 1.0),
    ]
    notes = [f"A node slips where its ratio is at least {_SLIPS:g} µ.", SHAPE_ONLY]
    return judged("figure-11", "Local friction, pressed and loaded", figure, checks, notes=notes)
