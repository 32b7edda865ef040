"""Appendix B of the thesis: Fingertip Model and Sensor Model side by side, figure by figure."""

import html
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from ...model import (
    ContactObject,
    Fingertip,
    State,
    contact_forces,
    equilibrium,
    spring_force,
    spring_forces,
)
from ...output.folder import prepare
from ...output.rows import Row, report, reported, within

Array = NDArray[np.float64]

FINGERTIP = Fingertip()
SENSOR = replace(FINGERTIP, law="axial")
INVERSE = replace(FINGERTIP, law="inverse-poisson")
COLOURS = {"Fingertip Model": "#1f3b73", "Sensor Model": "#e76f51", "inverse Poisson": "#2a9d8f"}
#: Single springs (Figs. 20, 21): stiffness, length, damping as printed; the force is not printed.
SPRING, LENGTH, DAMPING, PUSH = 314.0, 8e-3, 0.1, 0.2
#: As rigid as matters; the appendix presses on a surface without a stiffness. Grip not printed:
#: 1 N gives its largest nodal force of 0.05 N.
SURFACE, GRIP, LOAD = 1e5, 1.0, 0.2
STIFF_MEMBRANE = 30e3


@dataclass(frozen=True)
class Verdict:
    """How a figure of the thesis compares.

    Attributes
    ----------
    figure: number in the thesis
    title, sentence: what it shows, and whether it comes out here
    agrees: whether every statement of the text about it holds here
    """

    figure: str
    title: str
    sentence: str
    agrees: bool


Result = tuple[Verdict, list[Row], Figure]


def appendix_b(
    out: Path | None, force: bool, progress: Callable[[str], None]
) -> tuple[dict[str, Any], list[Verdict]]:
    """Reproduce every figure of the appendix that holds a result.

    Parameters
    ----------
    out: folder for pictures, numbers and page; None writes nothing
    force: write over what is there
    progress: told what is being done

    Returns
    -------
    Report of the rows, and the verdict on each figure.
    """
    if out is not None:
        prepare(out, force)
    results = []
    for figure, make in FIGURES.items():
        progress(f"Fig. {figure}")
        results.append(make())
    if out is not None:
        _write(results, out)
    rows = [row for _, part, _ in results for row in part]
    return report(rows), [verdict for verdict, _, _ in results]


def _figure(columns: int, title: str) -> tuple[Figure, Array]:
    figure = Figure(figsize=(4.0 * columns, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=10)
    return figure, figure.subplots(1, columns, squeeze=False)[0]


def _finish(axes: Axes, across: str, up: str) -> None:
    axes.set_xlabel(across, fontsize=8)
    axes.set_ylabel(up, fontsize=8)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.25, lw=0.5)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(fontsize=7, frameon=False)


def _settle_spring(law: str, rest: tuple[float, float]) -> Array:
    """Ends of one pushed spring once nothing moves: upper (x, z), lower x [m], shape (3,).

    The lower end slides on the surface z = 0, which the upper one cannot cross either.
    """

    def rates(_: float, y: Array) -> Array:
        d = y[:2] - [y[2], 0.0]
        f_x, f_z = spring_force(law, rest, (d[0], d[1]), SPRING, FINGERTIP.poisson_tissue)  # type: ignore[arg-type]
        wall = 1e4 * max(0.0, -(rest[1] + y[1]))
        return np.array([-f_x, -PUSH - f_z + wall, f_x]) / DAMPING

    end = solve_ivp(rates, (0.0, 20.0), np.zeros(3), method="LSODA", rtol=1e-8, atol=1e-12)
    return end.y[:, -1]


def _spring_figure(title: str, rest: tuple[float, float]) -> tuple[dict[str, Array], Figure]:
    ends = {
        name: _settle_spring(law, rest)
        for name, law in (("Fingertip Model", "split"), ("Sensor Model", "axial"))
    }
    figure, (axes,) = _figure(1, title)
    axes.plot([0, 1e3 * rest[0]], [0, 1e3 * rest[1]], "o:", color="grey", label="at rest")
    for name, y in ends.items():
        x, z = [1e3 * y[2], 1e3 * (rest[0] + y[0])], [0.0, 1e3 * (rest[1] + y[1])]
        axes.plot(x, z, "o-", color=COLOURS[name], label=name)
    axes.axhline(0.0, color="black", lw=0.8)
    axes.set_aspect("equal")
    axes.set_xlim(-5.0, 9.0)
    axes.set_ylim(-1.0, 9.0)
    _finish(axes, "x [mm]", "z [mm]")
    return ends, figure


def _tilt(y: Array, rest: tuple[float, float]) -> float:
    """Angle of a spring from the vertical [°]."""
    return float(np.degrees(np.arctan2(rest[0] + y[0] - y[2], rest[1] + y[1])))


def figure_20() -> Result:
    """A vertical spring, pushed along itself."""
    rest = (0.0, LENGTH)
    ends, figure = _spring_figure("Fig. 20: vertical spring pushed down", rest)
    tilt = {name: _tilt(y, rest) for name, y in ends.items()}
    rows = [
        reported("fig20/fingertip/tilt", tilt["Fingertip Model"], "°"),
        within("fig20/sensor/tilt", tilt["Sensor Model"], "°", -0.01, 0.01),
    ]
    agrees = abs(tilt["Fingertip Model"]) > 1.0 and rows[1].met
    sentence = (
        f"As in the thesis, the Fingertip Model's spring rotates (by {tilt['Fingertip Model']:.1f}°"
        f" under {PUSH} N) while the Sensor Model's stays upright; the force is not printed."
    )
    return Verdict("20", "Vertical spring under compression", sentence, agrees), rows, figure


def figure_21() -> Result:
    """A spring at 45°, pushed down."""
    rest = (LENGTH / np.sqrt(2), LENGTH / np.sqrt(2))
    ends, figure = _spring_figure("Fig. 21: spring at 45° pushed down", rest)
    height = {name: 1e3 * float(rest[1] + y[1]) for name, y in ends.items()}
    rows = [
        reported("fig21/fingertip/height", height["Fingertip Model"], "mm"),
        within("fig21/sensor/height", height["Sensor Model"], "mm", -0.1, 0.1),
    ]
    agrees = height["Fingertip Model"] > 1.0 and rows[1].met
    flat, up = height["Sensor Model"], height["Fingertip Model"]
    sentence = (
        f"Under {PUSH} N the Sensor Model's spring ends at a height of {abs(flat):.1f} mm (thesis: "
        "flat on the surface, nothing holds it up), the Fingertip Model's at "
        f"{up:.1f} mm, carried by its vertical part (thesis: another steady state)."
    )
    return Verdict("21", "Spring at 45° under compression", sentence, agrees), rows, figure


def figure_22() -> Result:
    """Spring forces of the nodes in contact, without friction."""
    obj = ContactObject(stiffness=SURFACE, friction=1e-9)
    figure, panels = _figure(5, f"Fig. 22: frictionless rigid surface, {GRIP} N")
    peak, lateral, sums = {}, {}, {}
    for name, tip in (("Fingertip Model", FINGERTIP), ("Sensor Model", SENSOR)):
        state = equilibrium(tip, obj, GRIP)
        field = contact_forces(tip, obj, state)
        tissue, membrane = spring_forces(tip, state.deformation.seen)
        (inside,) = np.nonzero(field.contact)
        x = 1e3 * field.position[inside, 0]
        curves = (
            field.normal, -tissue[:, 1], -tissue[:, 0], -membrane[:, 1], -membrane[:, 0],
        )  # fmt: skip
        for axes, values in zip(panels, curves, strict=True):
            axes.plot(x, 1e3 * values[inside], ".-", ms=3, color=COLOURS[name], label=name)
        peak[name] = 1e3 * field.normal.max()
        lateral[name] = 1e3 * abs(tissue[inside, 0]).max()
        sums[name] = (
            abs(tissue[inside, 0] + membrane[inside, 0]).max() / abs(tissue[inside, 0]).max()
        )
    titles = ("b: contact normal", "d: tissue normal", "c: tissue lateral", "f: membrane normal",
              "e: membrane lateral")  # fmt: skip
    for axes, title in zip(panels, titles, strict=True):
        axes.set_title(title, fontsize=8)
        _finish(axes, "x [mm]", "force [mN]")
    ratio = lateral["Fingertip Model"] / lateral["Sensor Model"]
    rows = [
        within("fig22/fingertip/largest_normal", peak["Fingertip Model"], "mN", 45, 55),
        within("fig22/fingertip/largest_lateral", lateral["Fingertip Model"], "mN", 16, 22),
        within("fig22/sensor/largest_normal", peak["Sensor Model"], "mN", 40, 60),
        within("fig22/lateral_fingertip_to_sensor", ratio, "×", 3, 8),
    ]
    balanced = bool(max(sums.values()) < 1e-3)
    sentence = (
        f"Both models carry similar normal forces ({peak['Fingertip Model']:.0f} and "
        f"{peak['Sensor Model']:.0f} mN at most, thesis 50), membrane and tissue cancel sideways, "
        f"and the Fingertip Model's lateral force peaks at {lateral['Fingertip Model']:.1f} mN "
        f"(thesis 20, ν times the normal one); the Sensor Model's is {ratio:.1f} times "
        "lower (thesis five)."
    )
    agrees = all(row.met for row in rows) and balanced
    return Verdict("22", "Spring forces at contact", sentence, agrees), rows, figure


def figure_24() -> Result:
    """Lateral displacement on a slippery surface, radius 10 mm."""
    obj = ContactObject(stiffness=SURFACE, friction=0.1)
    figure, panels = _figure(2, f"Fig. 24: lateral displacement, radius 10 mm, µ 0.1, {GRIP} N")
    largest, place = {}, {}
    models = {"Fingertip Model": FINGERTIP, "Sensor Model": SENSOR, "inverse Poisson": INVERSE}
    for name, model in models.items():
        tip = replace(model, radius=10e-3)
        moved = equilibrium(tip, obj, GRIP).deformation.nodes[:, 0]
        angle = np.degrees(tip.angles())
        axes = panels[1 if name == "inverse Poisson" else 0]
        axes.plot(angle, 1e6 * moved, color=COLOURS[name], label=name)
        top = int(moved.argmax())
        largest[name], place[name] = 1e6 * moved[top], angle[top]
    for axes in panels:
        axes.set_xlim(-45, 45)
        _finish(axes, "node, angle from the apex [°]", "lateral displacement [µm]")
    rows = [reported(f"fig24/{name}/largest", value, "µm") for name, value in largest.items()]
    rows += [reported(f"fig24/{name}/at", value, "°") for name, value in place.items()]
    smaller = bool(
        max(largest["Sensor Model"], largest["inverse Poisson"]) < largest["Fingertip Model"]
    )
    outwards = bool(min(place["Sensor Model"], place["inverse Poisson"]) > place["Fingertip Model"])
    sentence = (
        f"The Fingertip Model moves sideways the most ({largest['Fingertip Model']:.0f} µm, Sensor "
        f"Model {largest['Sensor Model']:.0f}), and with the inverse Poisson term the displacement "
        f"falls ({largest['inverse Poisson']:.1f} µm) and its peak shifts outwards "
        f"({place['Fingertip Model']:.1f}° to {place['inverse Poisson']:.1f}°), as the thesis "
        "says; its measured curve is not in the text, so only the shape compares."
    )
    return (
        Verdict(
            "24", "Lateral displacement with both Poisson forms", sentence, smaller and outwards
        ),
        rows,
        figure,
    )


def _stretch(tip: Fingertip, state: State) -> Array:
    """Strain of each membrane spring, shape (N − 1,)."""
    rest = tip.rest_positions()
    now = np.linalg.norm(np.diff(rest + state.deformation.seen, axis=0), axis=1)
    return now / np.linalg.norm(np.diff(rest, axis=0), axis=1) - 1.0


def figure_26() -> Result:
    """Stretching under a load that friction holds."""
    obj = ContactObject(stiffness=SURFACE, friction=0.5)
    figure, panels = _figure(2, f"Fig. 26: {GRIP} N, then a load of {LOAD} N < µFn")
    moved, stretch = {}, {}
    for axes, stiffness in zip(panels, (FINGERTIP.membrane_stiffness, STIFF_MEMBRANE), strict=True):
        for name, model in (("Fingertip Model", FINGERTIP), ("Sensor Model", SENSOR)):
            tip = replace(model, membrane_stiffness=stiffness)
            state = equilibrium(tip, obj, GRIP, LOAD)
            shape = 1e3 * (tip.rest_positions() + state.deformation.seen)
            # A dot for every third node: where they lie apart, the membrane is stretched.
            axes.plot(*shape[::3].T, ".", ms=3, color=COLOURS[name], label=name)
            moved[name, stiffness] = 1e3 * state.deformation.object_position
            stretch[name, stiffness] = 100 * float(_stretch(tip, state).max())
        axes.set_aspect("equal")
        axes.set_ylim(-0.5, 11.0)
        axes.set_title(f"membrane {stiffness / 1e3:g} kN/m", fontsize=8)
        _finish(axes, "x [mm]", "z [mm]")
    rows = []
    for (name, stiffness), value in moved.items():
        label = f"fig26/{name}/{stiffness:g}"
        rows.append(reported(f"{label}/object_moved", value, "mm"))
        rows.append(reported(f"{label}/largest_stretch", stretch[name, stiffness], "%"))
    soft = FINGERTIP.membrane_stiffness
    tip_mm, sensor_mm = moved["Fingertip Model", soft], moved["Sensor Model", soft]
    stiff_mm = moved["Sensor Model", STIFF_MEMBRANE]
    agrees = sensor_mm > 5 * tip_mm and stiff_mm < 0.3 * sensor_mm
    sentence = (
        f"The Fingertip Model holds after {tip_mm:.2f} mm while the Sensor Model's membrane "
        f"stretches by up to {stretch['Sensor Model', soft]:.0f} % and the object moves "
        f"{sensor_mm:.1f} mm; a 20 times stiffer membrane cuts that to {stiff_mm:.2f} mm, as the "
        "thesis shows."
    )
    return Verdict("26", "Stretching of the membrane", sentence, agrees), rows, figure


def figure_27() -> Result:
    """Directions of the contact forces after a press, stiff membrane."""
    obj = ContactObject(stiffness=SURFACE, friction=0.5)
    figure, panels = _figure(2, f"Fig. 27: forces on the skin, {GRIP} N, µ 0.5, membrane 30 kN/m")
    inward = {}
    pairs = (("Sensor Model", SENSOR), ("Fingertip Model", FINGERTIP))
    for axes, (name, model) in zip(panels, pairs, strict=True):
        tip = replace(model, membrane_stiffness=STIFF_MEMBRANE)
        field = contact_forces(tip, obj, equilibrium(tip, obj, GRIP))
        (inside,) = np.nonzero(field.contact)
        x, friction = field.position[inside, 0], field.friction[inside]
        # Drawn in millimetres, 20 mN to each; the skin is pushed down, friction sideways.
        for x_i, f_x, f_z in zip(1e3 * x, 50 * friction, -50 * field.normal[inside], strict=True):
            axes.annotate(
                "", (x_i + f_x, f_z), (x_i, 0.0),
                arrowprops={"arrowstyle": "->", "color": COLOURS[name], "lw": 0.8},
            )  # fmt: skip
        axes.plot(1e3 * x, np.zeros(len(x)), ".", ms=3, color=COLOURS[name], label=name)
        axes.set_ylim(-3.2, 0.6)
        axes.set_aspect("equal")
        _finish(axes, "x [mm]", "force on the skin, 1 mm = 20 mN")
        edge = np.r_[0:3, len(x) - 3 : len(x)]
        inward[name] = float(-(friction * np.sign(x))[edge].mean() * 1e3)
    rows = [reported(f"fig27/{name}/inward_at_the_edges", v, "mN") for name, v in inward.items()]
    agrees = inward["Fingertip Model"] > 0.0 > inward["Sensor Model"]
    split, axial = inward["Fingertip Model"], inward["Sensor Model"]
    sentence = (
        f"The Fingertip Model's forces point inwards ({split:.1f} mN at the edges), as in the "
        "thesis; "
        + (
            "the Sensor Model's outwards, as in the thesis."
            if agrees
            else f"those of the Sensor Model do here too ({axial:.1f} mN) where the thesis shows "
            "them outwards: pressing spreads the skin, and friction that starts at zero can only "
            "oppose that. Its Dahl exponent, grip and path are not printed."
        )
    )
    return Verdict("27", "Directions of contact forces", sentence, agrees), rows, figure


FIGURES: dict[str, Callable[[], Result]] = {
    "20": figure_20,
    "21": figure_21,
    "22": figure_22,
    "24": figure_24,
    "26": figure_26,
    "27": figure_27,
}


def _write(results: list[Result], folder: Path) -> None:
    """Pictures, numbers and a page that shows them with a sentence each."""
    parts = []
    for verdict, rows, figure in results:
        figure.savefig(folder / f"fig{verdict.figure}.png", dpi=120)
        table = "".join(
            f"<tr><td>{html.escape(row.name)}</td><td>{row.value:.4g} {row.unit}</td></tr>"
            for row in rows
        )
        word = "reproduced" if verdict.agrees else "differs"
        parts.append(
            f"<section><h2>Fig. {verdict.figure}: {html.escape(verdict.title)} "
            f"<em class={word}>{word}</em></h2><p>{html.escape(verdict.sentence)}</p>"
            f'<img src="fig{verdict.figure}.png" alt="{html.escape(verdict.title)}">'
            f"<table>{table}</table></section>"
        )
    (folder / "index.html").write_text(_PAGE.format("\n".join(parts)), encoding="utf-8")
    listed = [
        asdict(verdict) | {"rows": [asdict(row) for row in rows]} for verdict, rows, _ in results
    ]
    text = json.dumps(listed, indent=2, ensure_ascii=False)
    (folder / "appendix-b.json").write_text(text + "\n", encoding="utf-8")


_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Appendix B, reproduced</title><style>
body {{ font: 16px/1.5 sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem }}
img {{ max-width: 100% }} td {{ padding: 0 1rem 0 0; font-size: 0.85rem }}
em {{ font-style: normal; font-size: 0.8rem; padding: 0.1rem 0.5rem; border-radius: 0.6rem }}
.reproduced {{ background: #d3f0e8 }} .differs {{ background: #f9dccf }}
</style></head><body><h1>Appendix B: Fingertip Model and Sensor Model</h1>
<p>The thesis prints no data for these figures; numbers and sentences of its text are compared.</p>
{}
</body></html>
"""
