"""Appendix B of the thesis: Fingertip Model and Sensor Model side by side (Figs. 20 to 27).

The thesis prints no data for these figures: numbers and sentences of its text are compared.
"""

from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from ...model import (
    ContactObject,
    Fingertip,
    SpringLaw,
    State,
    contact_forces,
    equilibrium,
    spring_force,
    spring_forces,
)
from ...output.figure import WIDTH, finish, new_figure
from ...output.report import reported, within
from .runs import UNPRINTED
from .statements import Section

Array = NDArray[np.float64]

SENSOR = "Sensor Model"
FINGERTIP = "Fingertip Model"
INVERSE = "inverse Poisson"
#: Fingertip of each model, and its spring law.
MODELS = {FINGERTIP: Fingertip(), SENSOR: Fingertip(law="axial")}
COLOURS = {FINGERTIP: "#1f3b73", SENSOR: "#e76f51", INVERSE: "#2a9d8f"}
#: Line and marker of each model, so that they differ by more than their colour.
LINES = {FINGERTIP: "-", SENSOR: "--", INVERSE: "-."}
MARKERS = {FINGERTIP: ".", SENSOR: "x"}
#: Stiffness [N/m], length [m] and damping [N·s/m] of a single spring (Figs. 20, 21).
SPRING = 314.0
LENGTH = 8e-3
DAMPING = 0.1
#: Force on a single spring [N]; not printed.
PUSH = 0.2
#: Stiffness of a surface that counts as rigid [N/m]; the appendix gives the surface none.
SURFACE = 1e5
#: Grip force [N]; not printed. 1 N gives the printed largest nodal force of 0.05 N.
GRIP = 1.0
#: Load of Fig. 26 [N].
LOAD = 0.2
#: Stiffness of the stiffer membrane of Figs. 26 and 27 [N/m].
STIFF_MEMBRANE = 30e3


def _panels(count: int, title: str) -> tuple[Figure, Array]:
    """Panels of a figure, of more than two in rows of three, with room for one more."""
    columns, rows = (count, 1) if count <= 2 else (3, count // 3 + 1)
    width = 4.0 if count == 1 else WIDTH
    figure = new_figure(title, width, 0.6 + 2.8 * rows, UNPRINTED if count > 1 else "")
    return figure, figure.subplots(rows, columns, squeeze=False).ravel()


def _settle_spring(law: SpringLaw, rest: tuple[float, float]) -> Array:
    """Ends of a pushed spring once nothing moves: upper (x, z), lower x [m], shape (3,).

    The lower end slides on the surface z = 0, which the upper one cannot cross either.
    """

    def rates(_: float, y: Array) -> Array:
        stretch = (y[0] - y[2], y[1])
        f_x, f_z = spring_force(law, rest, stretch, SPRING, Fingertip().poisson_tissue)
        wall = 1e4 * max(0.0, -(rest[1] + y[1]))
        return np.array([-f_x, -PUSH - f_z + wall, f_x]) / DAMPING

    end = solve_ivp(rates, (0.0, 20.0), np.zeros(3), method="LSODA", rtol=1e-8, atol=1e-12)
    return end.y[:, -1]


def _springs(title: str, rest: tuple[float, float]) -> tuple[dict[str, Array], Figure]:
    """Vector from the lower to the upper end of the pushed spring by model [m], and its figure."""
    figure, (axes,) = _panels(1, title)
    axes.plot([0, 1e3 * rest[0]], [0, 1e3 * rest[1]], "o:", color="grey", label="at rest")
    vectors = {}
    for name, model in MODELS.items():
        x, z, foot = _settle_spring(model.law, rest)
        vectors[name] = np.array([rest[0] + x - foot, rest[1] + z])
        ends = 1e3 * np.array([[foot, 0.0], [rest[0] + x, rest[1] + z]])
        axes.plot(*ends.T, "o", ls=LINES[name], color=COLOURS[name], label=name)
    axes.axhline(0.0, color="black", lw=0.8)
    finish(axes, "z [mm]", "x [mm]", aspect="equal", xlim=(-5.0, 9.0), ylim=(-1.0, 9.0))
    return vectors, figure


def figure_20() -> Section:
    """A vertical spring, pushed along itself."""
    vectors, figure = _springs("Fig. 20: vertical spring pushed down", (0.0, LENGTH))
    tilt = {name: float(np.degrees(np.arctan2(*vector))) for name, vector in vectors.items()}
    upright = within(("fig20", "sensor", "tilt"), tilt[SENSOR], "°", -0.01, 0.01)
    return Section(
        part="figure-20",
        title="Vertical spring under compression",
        figure=figure,
        agrees=abs(tilt[FINGERTIP]) > 1.0 and bool(upright.met),
        sentence=(
            "As in the thesis, the Fingertip Model's spring rotates (by "
            f"{tilt[FINGERTIP]:.1f}° under {PUSH} N) while the Sensor Model's stays upright; the "
            "force is not printed."
        ),
        extra_rows=[reported(("fig20", "fingertip", "tilt"), tilt[FINGERTIP], "°"), upright],
    )


def figure_21() -> Section:
    """A spring at 45°, pushed down."""
    rest = (LENGTH / np.sqrt(2), LENGTH / np.sqrt(2))
    vectors, figure = _springs("Fig. 21: spring at 45° pushed down", rest)
    height = {name: 1e3 * float(vector[1]) for name, vector in vectors.items()}
    flat = within(("fig21", "sensor", "height"), height[SENSOR], "mm", -0.1, 0.1)
    return Section(
        part="figure-21",
        title="Spring at 45° under compression",
        figure=figure,
        agrees=height[FINGERTIP] > 1.0 and bool(flat.met),
        sentence=(
            f"Under {PUSH} N the Sensor Model's spring ends at a height of "
            f"{abs(height[SENSOR]):.1f} mm (thesis: flat on the surface, nothing holds it up), the "
            f"Fingertip Model's at {height[FINGERTIP]:.1f} mm, carried by its vertical part "
            "(thesis: another steady state)."
        ),
        extra_rows=[reported(("fig21", "fingertip", "height"), height[FINGERTIP], "mm"), flat],
    )


def figure_22() -> Section:
    """Spring forces of the nodes in contact, without friction."""
    obj = ContactObject(stiffness=SURFACE, friction=1e-9)
    figure, panels = _panels(5, f"Fig. 22: frictionless rigid surface, {GRIP} N")
    normal, lateral, unbalanced = {}, {}, {}
    for name, tip in MODELS.items():
        state = equilibrium(tip, obj, GRIP)
        field = contact_forces(tip, obj, state)
        tissue, membrane = spring_forces(tip, state.deformation.seen)
        inside = field.contact
        curves = {
            "b: contact normal": field.normal,
            "d: tissue normal": -tissue[:, 1],
            "c: tissue lateral": -tissue[:, 0],
            "f: membrane normal": -membrane[:, 1],
            "e: membrane lateral": -membrane[:, 0],
        }
        x = 1e3 * field.position[inside, 0]
        look = {"color": COLOURS[name], "ls": LINES[name], "marker": MARKERS[name], "ms": 4}
        for axes, (title, values) in zip(panels, curves.items(), strict=False):
            axes.plot(x, 1e3 * values[inside], label=name, **look)
            finish(axes, "force [mN]", "x [mm]", legend=False)
            axes.set_title(title, fontsize=10)
        normal[name] = 1e3 * field.normal.max()
        lateral[name] = 1e3 * abs(tissue[inside, 0]).max()
        both = 1e3 * abs(tissue[inside, 0] + membrane[inside, 0]).max()
        unbalanced[name] = both / lateral[name]
    panels[-1].axis("off")
    panels[-1].legend(*panels[0].get_legend_handles_labels(), loc="center", frameon=False)
    ratio = lateral[FINGERTIP] / lateral[SENSOR]
    rows = [
        within(("fig22", "fingertip", "largest_normal"), normal[FINGERTIP], "mN", 45, 55),
        within(("fig22", "fingertip", "largest_lateral"), lateral[FINGERTIP], "mN", 16, 22),
        within(("fig22", "sensor", "largest_normal"), normal[SENSOR], "mN", 40, 60),
        within(("fig22", "lateral_fingertip_to_sensor"), ratio, "×", 3, 8),
    ]
    return Section(
        part="figure-22",
        title="Spring forces at contact",
        figure=figure,
        agrees=all(row.met for row in rows) and max(unbalanced.values()) < 1e-3,
        sentence=(
            f"Both models carry similar normal forces ({normal[FINGERTIP]:.0f} and "
            f"{normal[SENSOR]:.0f} mN at most, thesis 50), membrane and tissue cancel sideways, "
            f"and the Fingertip Model's lateral force peaks at {lateral[FINGERTIP]:.1f} mN "
            f"(thesis 20, ν times the normal one); the Sensor Model's is {ratio:.1f} times lower "
            "(thesis five)."
        ),
        extra_rows=rows,
    )


def figure_24() -> Section:
    """Lateral displacement on a slippery surface, radius 10 mm."""
    obj = ContactObject(stiffness=SURFACE, friction=0.1)
    figure, panels = _panels(2, f"Fig. 24: lateral displacement, radius 10 mm, µ 0.1, {GRIP} N")
    largest, place = {}, {}
    for name, model in (MODELS | {INVERSE: Fingertip(law="inverse-poisson")}).items():
        tip = replace(model, radius=10e-3)
        moved = equilibrium(tip, obj, GRIP).deformation.nodes[:, 0]
        angle = np.degrees(tip.angles())
        look = {"color": COLOURS[name], "ls": LINES[name], "label": name}
        panels[int(name == INVERSE)].plot(angle, 1e6 * moved, **look)
        top = int(moved.argmax())
        largest[name], place[name] = 1e6 * float(moved[top]), float(angle[top])
    for axes in panels:
        x_label = "node, angle from the apex [°]"
        finish(axes, "lateral displacement [µm]", x_label, xlim=(-45, 45))
    smaller = max(largest[SENSOR], largest[INVERSE]) < largest[FINGERTIP]
    outwards = min(place[SENSOR], place[INVERSE]) > place[FINGERTIP]
    return Section(
        part="figure-24",
        title="Lateral displacement with both Poisson forms",
        figure=figure,
        agrees=smaller and outwards,
        sentence=(
            f"The Fingertip Model moves sideways the most ({largest[FINGERTIP]:.0f} µm, Sensor "
            f"Model {largest[SENSOR]:.0f}), and with the inverse Poisson term the displacement "
            f"falls ({largest[INVERSE]:.1f} µm) and its peak shifts outwards "
            f"({place[FINGERTIP]:.1f}° to {place[INVERSE]:.1f}°), as the thesis says; its measured "
            "curve is not in the text, so only the shape compares."
        ),
        extra_rows=[
            *(reported(("fig24", name, "largest"), value, "µm") for name, value in largest.items()),
            *(reported(("fig24", name, "at"), value, "°") for name, value in place.items()),
        ],
    )


def _stretch(tip: Fingertip, state: State) -> float:
    """Largest strain of a membrane spring [%]."""
    rest = tip.rest_positions()
    now = np.linalg.norm(np.diff(rest + state.deformation.seen, axis=0), axis=1)
    return 100.0 * float((now / np.linalg.norm(np.diff(rest, axis=0), axis=1) - 1.0).max())


def figure_26() -> Section:
    """Stretching under a load that friction holds."""
    obj = ContactObject(stiffness=SURFACE, friction=0.5)
    figure, panels = _panels(2, f"Fig. 26: {GRIP} N, then a load of {LOAD} N < µFn")
    soft = Fingertip().membrane_stiffness
    moved, stretch, rows = {}, {}, []
    for axes, stiffness in zip(panels, (soft, STIFF_MEMBRANE), strict=True):
        for name, model in MODELS.items():
            tip = replace(model, membrane_stiffness=stiffness)
            state = equilibrium(tip, obj, GRIP, LOAD)
            shape = 1e3 * (tip.rest_positions() + state.deformation.seen)
            # A dot for every third node: where the dots are far apart, the membrane is stretched.
            axes.plot(*shape[::3].T, MARKERS[name], ms=4, color=COLOURS[name], label=name)
            moved[name, stiffness] = 1e3 * state.deformation.object_position
            stretch[name, stiffness] = _stretch(tip, state)
            subject = ("fig26", name, f"{stiffness:g}")
            rows.append(reported((*subject, "object_moved"), moved[name, stiffness], "mm"))
            rows.append(reported((*subject, "largest_stretch"), stretch[name, stiffness], "%"))
        title = f"membrane {stiffness / 1e3:g} kN/m"
        finish(axes, "z [mm]", "x [mm]", aspect="equal", ylim=(-0.5, 11.0), title=title)
    fingertip, sensor = moved[FINGERTIP, soft], moved[SENSOR, soft]
    stiffer = moved[SENSOR, STIFF_MEMBRANE]
    return Section(
        part="figure-26",
        title="Stretching of the membrane",
        figure=figure,
        agrees=sensor > 5 * fingertip and stiffer < 0.3 * sensor,
        sentence=(
            f"The Fingertip Model holds after {fingertip:.2f} mm while the Sensor Model's membrane "
            f"stretches by up to {stretch[SENSOR, soft]:.0f} % and the object moves "
            f"{sensor:.1f} mm; a 20 times stiffer membrane cuts that to {stiffer:.2f} mm, as the "
            "thesis shows."
        ),
        extra_rows=rows,
    )


def _arrows(axes: Axes, x: Array, friction: Array, normal: Array, name: str) -> None:
    """Forces on the skin at x [m]: 20 mN to a millimetre, the skin pushed down."""
    for x_i, f_x, f_z in zip(1e3 * x, 50 * friction, -50 * normal, strict=True):
        arrow = {"arrowstyle": "->", "color": COLOURS[name], "lw": 0.8}
        axes.annotate("", (x_i + f_x, f_z), (x_i, 0.0), arrowprops=arrow)
    axes.plot(1e3 * x, np.zeros(len(x)), ".", ms=3, color=COLOURS[name], label=name)
    y_label = "force on the skin, 1 mm = 20 mN"
    finish(axes, y_label, "x [mm]", aspect="equal", ylim=(-3.2, 0.6))


def figure_27() -> Section:
    """Directions of the contact forces after a press, stiff membrane."""
    obj = ContactObject(stiffness=SURFACE, friction=0.5)
    figure, panels = _panels(2, f"Fig. 27: forces on the skin, {GRIP} N, µ 0.5, membrane 30 kN/m")
    inward = {}
    for axes, name in zip(panels, (SENSOR, FINGERTIP), strict=True):
        tip = replace(MODELS[name], membrane_stiffness=STIFF_MEMBRANE)
        field = contact_forces(tip, obj, equilibrium(tip, obj, GRIP))
        inside = field.contact
        x, friction = field.position[inside, 0], field.friction[inside]
        _arrows(axes, x, friction, field.normal[inside], name)
        edge = np.r_[0:3, len(x) - 3 : len(x)]
        inward[name] = float(-(friction * np.sign(x))[edge].mean() * 1e3)
    agrees = inward[FINGERTIP] > 0.0 > inward[SENSOR]
    difference = (
        f"those of the Sensor Model do here too ({inward[SENSOR]:.1f} mN) where the thesis shows "
        "them outwards: pressing spreads the skin, and friction that starts at zero can only "
        "oppose that. Its Dahl exponent, grip and path are not printed."
    )
    return Section(
        part="figure-27",
        title="Directions of contact forces",
        figure=figure,
        agrees=agrees,
        sentence=(
            f"The Fingertip Model's forces point inwards ({inward[FINGERTIP]:.1f} mN at the "
            "edges), as in the thesis; "
            + ("the Sensor Model's outwards, as in the thesis." if agrees else difference)
        ),
        extra_rows=[
            reported(("fig27", name, "inward_at_the_edges"), value, "mN")
            for name, value in inward.items()
        ],
    )


def appendix_b() -> list[Section]:
    """Every figure of the appendix that holds a result."""
    figures = (figure_20, figure_21, figure_22, figure_24, figure_26, figure_27)
    return [figure() for figure in figures]
