"""Draw the traction on a silicone dome, seen from above, at three instants of a contact.

python examples/dome_contact.py [press|shear|twist|pencil] [PICTURE.png]   # twist by default
"""

import sys

import numpy as np
from matplotlib import colors, figure, patches

from chromagrip import model
from chromagrip.model import shapes
from chromagrip.model.dome import lattice

DOME, PENCIL, MU = model.Dome(pitch=0.5e-3), 3.5e-3, 0.5  # radius of the pencil [m], friction
AREAS, KEY = 1e3 * lattice(DOME).areas, 60.0  # force [N] over area is [kPa]; arrow of the key [kPa]
BLUES = colors.LinearSegmentedColormap.from_list("blues", ["white", "deepskyblue"])


def rolled(depth: float) -> model.Motion:
    """A pencil that is pressed at −20° of the dome, and rolls over the apex to +20°."""
    angles = np.radians([-20.0, *np.linspace(-20.0, 20.0, 21)])
    rest, poses = DOME.radius + PENCIL, np.zeros((22, 6))
    apart = rest - np.array([-2e-5, *[depth] * 21])  # between the pencil's axis and the centre
    poses[:, 0], poses[:, 2] = apart * np.sin(angles), apart * np.cos(angles) - rest
    poses[:, 4] = (angles - angles[0]) * rest / PENCIL  # about y: it rolls and does not slide
    return model.Motion(times=np.linspace(0.0, 0.22, 22), poses=poses)


SCENES = {  # shape, motion, and what is drawn when [s]
    "press": (shapes.ball(10e-3), model.press_and_move(0.8e-3),
              {"Ball pressed by 0.2 mm": 0.025, "by 0.5 mm": 0.0625, "by 0.8 mm": 0.1}),
    "shear": (shapes.plane(), model.press_and_move(0.8e-3, shift=(1e-3, 0.0)),
              {"Plate moved by 0.2 mm": 0.12, "by 0.5 mm": 0.15, "by 1 mm": 0.2}),
    "twist": (shapes.plane(), model.press_and_move(0.8e-3, twist=np.radians(30.0)),
              {"Plate turned by 3°": 0.11, "by 9°": 0.13, "by 30°": 0.2}),
    "pencil": (shapes.cylinder(PENCIL, 60e-3, 0.5e-3), rolled(0.8e-3),
               {"Pencil pressed at −20°": 0.01, "rolled to the apex": 0.11, "to +20°": 0.21}),
}  # fmt: skip


def draw(axes, what: str, field: model.ForceField, margin: float, top: float):
    """Pressure as colour, friction as arrows, the totals as title; lengths in mm."""
    at = np.column_stack([1e3 * field.position[:, :2], field.friction[:, :2] / AREAS[:, None]])
    form = {"shading": "gouraud", "cmap": BLUES, "vmin": 0.0, "vmax": top}
    pressure = axes.tripcolor(*at[:, :2].T, field.normal / AREAS, **form)
    slips = np.linalg.norm(field.friction, axis=1) > 0.999 * MU * field.normal
    form = {"angles": "xy", "scale_units": "xy", "scale": KEY, "width": 0.005}
    for on, name, hue in ((~slips, "skin sticks", "black"), (slips, "skin slips", "orangered")):
        quiver = axes.quiver(*at[field.contact & on].T, color=hue, label=name, **form)
    axes.quiverkey(quiver, 0.93, 0.04, KEY, f"friction\n{KEY:g} kPa", color="black")
    axes.set_axis_off()
    axes.add_patch(patches.Circle((0.0, 0.0), 1e3 * DOME.radius, fill=False, color="grey"))
    axes.errorbar(-7.0, -7.7, xerr=1.0, color="black", linewidth=3)
    axes.text(-7.0, -7.5, "2 mm", ha="center", va="bottom")
    axes.set(aspect="equal", xlim=(-8.2, 8.2), ylim=(-8.2, 8.2))
    text = f"ΣFn {field.total_normal:.2f} N, ΣFf {field.total_friction:.2f} N"
    text += f"\nΓ {field.safety_margin(MU):.2f}, with torsion {margin:.2f}"
    print(axes.set_title(f"{what}\n{text}", fontsize=11).get_text())
    return pressure


def main(name: str = "twist", picture: str = "dome-contact.png") -> None:
    shape, motion, times = SCENES.get(name) or sys.exit(f"choose one of {', '.join(SCENES)}")
    solid = model.Solid(shape=shape, friction=MU)
    run = model.simulate_contact(DOME, solid, motion, 2.5e-3, keep=1000)  # all
    states = [run.states[abs(run.times - time).argmin()] for time in times.values()]
    fields = [model.dome_forces(DOME, state) for state in states]
    top = max((field.normal / AREAS).max() for field in fields)
    page = figure.Figure((13.0, 5.2), layout="constrained")
    for axes, what, field, state in zip(page.subplots(1, 3), times, fields, states, strict=True):
        pressure = draw(axes, what, field, model.limit_margin(DOME, solid, state), top)
    page.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    page.colorbar(pressure, ax=page.axes, label="normal pressure [kPa]", shrink=0.8)
    page.savefig(picture, dpi=90)


if __name__ == "__main__":
    main(*sys.argv[1:])
