"""A labelled picture of an image and its ground truth."""

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ...model import margin_within
from ...scene.scene import Scene
from .poses import Shot

#: Colours of the two layers' markers and of forces.
MAGENTA = "#b0125b"
FORCE = "#1f4fd8"

#: Columns and rows of a part of the picture: left, right, top, bottom [px].
Window = tuple[float, float, float, float]


def draw_preview(scene: Scene, shot: Shot, path: Path) -> None:
    """Draw the picture and, magnified, its forces, layers, motion, indentation and numbers."""
    matplotlib.use("Agg", force=False)
    figure = Figure(figsize=(12.6, 8.2), dpi=100, layout="constrained")
    axes = figure.subplots(2, 3)
    pose = shot.settled.pose
    names = ", ".join(filter(None, (Path(scene.sensor).stem, pose.object_name(scene))))
    figure.suptitle(f"{names}: {pose.words(shot.settled)}", fontsize=15)
    window = _window(shot)
    _whole(axes[0, 0], shot, window)
    _forces(axes[0, 1], scene, shot, window)
    _layers(axes[0, 2], shot)
    _motion(axes[1, 0], shot, window)
    _depth(figure, axes[1, 1], shot)
    _numbers(axes[1, 2], scene, shot)
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
    for axis in (axes[0, 1], axes[0, 2], axes[1, 0], axes[1, 1]):
        axis.set_xlim(window[0], window[1])
        axis.set_ylim(window[3], window[2])
    figure.savefig(path)


def _window(shot: Shot) -> Window:
    """Square around the part that has moved."""
    length = np.nan_to_num(np.linalg.norm(shot.truth.flow[0], axis=-1))
    height, width = length.shape
    moved_share = 0.2  # motion over its largest that belongs to the window
    rows, columns = np.nonzero(length > moved_share * max(length.max(), 1e-9))
    if not len(rows):
        return -0.5, width - 0.5, -0.5, height - 0.5
    smallest = 0.2  # smallest window over the picture
    side = 1.1 * max(np.ptp(rows), np.ptp(columns), smallest * height)
    x, y = (columns.min() + columns.max()) / 2, (rows.min() + rows.max()) / 2
    if side > 0.8 * height:
        x, y, side = (width - 1) / 2, (height - 1) / 2, height
    return x - side / 2, x + side / 2, y - side / 2, y + side / 2


def _facts(scene: Scene, shot: Shot) -> list[tuple[str, str]]:
    """Quantities of the contact, each with its value and unit."""
    field, friction = shot.settled.field, shot.settled.friction
    facts = [
        ("renderer", scene.renderer),
        ("largest motion", f"{_largest(shot):.1f} px"),
    ]
    if field is None:
        return facts
    if not field.contact.any():
        return [*facts, ("contact", "none")]
    facts += [("µ", f"{friction:.3g}"), ("ΣFn", f"{field.total_normal:.2f} N")]
    facts += [("ΣFf", f"{abs(field.total_friction):.2f} N")]
    margin = field.safety_margin(friction)
    facts += [("Γ", f"{margin:.2f}")]
    if field.position.shape[1] == 3:
        x, y, z = field.total_force
        facts += [("force along x, y, down", f"{x:z.2f}, {y:z.2f}, {-z:z.2f} N")]
        facts += [("torque about the axis", f"{1e3 * field.torque((0.0, 0.0, 1.0)):z.2f} N·mm")]
        facts += [("Γ with torsion", f"{margin_within(field, friction):.2f}")]
    return facts


def _largest(shot: Shot) -> float:
    return float(np.nanmax(np.linalg.norm(shot.truth.flow[0], axis=-1), initial=0.0))


def _numbers(axis: Any, scene: Scene, shot: Shot) -> None:
    axis.set_title("truth")
    axis.set_frame_on(False)
    for row, (name, value) in enumerate(_facts(scene, shot)):
        axis.text(0.02, 0.93 - 0.1 * row, name, transform=axis.transAxes, fontsize=12)
        axis.text(0.98, 0.93 - 0.1 * row, value, transform=axis.transAxes, fontsize=12, ha="right")


def _whole(axis: Any, shot: Shot, window: Window) -> None:
    axis.set_title("picture; the square is magnified")
    axis.imshow(shot.frame.image)
    left, right, top, bottom = window
    axis.add_patch(Rectangle((left, top), right - left, bottom - top, fill=False, ec=FORCE, lw=1.8))


def _forces(axis: Any, scene: Scene, shot: Shot, window: Window) -> None:
    axis.imshow(shot.frame.image)
    yellow = "#b58900"  # colour of the lower layer's markers
    for layer, colour in ((1, yellow), (0, MAGENTA)):
        visible = shot.truth.visible[layer]
        axis.plot(*shot.truth.pixels[layer, visible].T, "+", color=colour, ms=5.0, mew=1.0)
    field = shot.settled.field
    if field is None or not field.contact.any():
        axis.set_title("marker centres (+)")
        return
    view, touching = scene.build_sensor().view, field.contact
    if field.position.shape[1] == 3:  # only friction: a press along the view has no direction
        what, places, step = "friction", field.position[touching], 2e-4
        friction = field.friction[touching]
        largest = max(float(np.linalg.norm(friction, axis=1).max()), 1e-12)
        base = view.project(places)
        force = (view.project(places + step * friction / largest) - base) / step
        # Arrows of neighbours would hide each other.
        every = max(1, len(base) // 120)
    else:
        what, (x, z), every = "force", field.position[touching].T, 2
        base = view.project(np.column_stack([x, np.zeros_like(x), z]))
        force = np.column_stack([field.friction, -field.normal])[touching]
        largest = max(float(np.linalg.norm(force, axis=1).max()), 1e-12)
    longest = 0.14  # longest arrow of a force over the side of the window
    force *= longest * (window[1] - window[0]) / max(np.linalg.norm(force, axis=1).max(), 1e-12)
    axis.set_title(f"markers (+) and {what}, ≤ {largest:.2g} N a node")
    axis.quiver(
        *base[::every].T,
        *force[::every].T,
        angles="xy",
        scale_units="xy",
        scale=1,
        color=FORCE,
        width=4e-3,
    )


def _layers(axis: Any, shot: Shot) -> None:
    axis.set_title("layers; red where both lie")
    magenta, yellow = shot.truth.masks
    picture = np.ones((*magenta.shape, 3))
    picture *= 1.0 - magenta[..., None] * (1.0 - np.array([0.85, 0.25, 0.55]))
    picture *= 1.0 - yellow[..., None] * (1.0 - np.array([1.0, 0.85, 0.2]))
    axis.imshow(np.clip(picture, 0.0, 1.0))


def _motion(axis: Any, shot: Shot, window: Window) -> None:
    flow, largest = shot.truth.flow[0], _largest(shot)
    arrows = 22  # number of arrows of the motion along a side of the window
    spacing = max(2, round((window[1] - window[0]) / arrows))
    most_magnified = 20.0  # largest magnification of the motion
    magnify = max(1, round(min(1.3 * spacing / max(largest, 1e-3), most_magnified)))
    axis.set_title(f"motion since rest, × {magnify}")
    length = np.linalg.norm(flow, axis=-1)
    axis.imshow(length, cmap="Greys", vmin=0.0, vmax=max(2.5 * largest, 1e-3))
    y, x = np.mgrid[
        spacing // 2 : length.shape[0] : spacing, spacing // 2 : length.shape[1] : spacing
    ]
    axis.quiver(
        x,
        y,
        *(magnify * flow[y, x]).transpose(2, 0, 1),
        angles="xy",
        scale_units="xy",
        scale=1,
        width=4e-3,
        color=MAGENTA,
    )


def _depth(figure: Figure, axis: Any, shot: Shot) -> None:
    # The distance itself mostly shows that the rays to a pad's rim are longer.
    axis.set_title("skin nearer to the camera than at rest")
    picture = axis.imshow(1e3 * (shot.rest_depth - shot.truth.depth), cmap="viridis")
    figure.colorbar(picture, ax=axis, label="mm", location="bottom", shrink=0.8)
