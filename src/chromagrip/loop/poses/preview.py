"""A labelled picture of an image and its ground truth."""

import textwrap
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from ...model import margin_within
from ...scene.scene import Scene
from .dome_poses import DomePose
from .poses import Shot

#: Colours of the two layers' markers and of forces.
MAGENTA = "#b0125b"
YELLOW = "#b58900"
FORCE = "#1f4fd8"
#: Spacing of the flow's arrows [px].
SPACING = 16
#: Factor by which the flow is magnified: its longest arrow is longer than the spacing by half.
MAGNIFY = (4.0, 20.0)
#: Letters in a line of the title.
WIDTH = 110
#: Longest arrow of a force over the height of the picture, and over the width of the contact.
ARROW, OF_CONTACT = 0.08, 0.35


def draw_preview(scene: Scene, shot: Shot, path: Path) -> None:
    """Image with markers, forces, layers, flow and depth, with the pose above."""
    matplotlib.use("Agg", force=False)
    figure = Figure(figsize=(12.0, 9.4), dpi=100, layout="constrained")
    axes = figure.subplots(2, 2)
    figure.suptitle(textwrap.fill(_title(scene, shot), WIDTH))
    _markers(axes[0, 0], scene, shot)
    _layers(axes[0, 1], shot)
    _flow(axes[1, 0], shot)
    _depth(figure, axes[1, 1], shot)
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
    figure.savefig(path)


def _title(scene: Scene, shot: Shot) -> str:
    pose, field = shot.settled.pose, shot.settled.field
    if isinstance(pose, DomePose):
        forces = _dome_title(pose, shot)
    elif field is None:
        forces = f"pressed {pose.depth * 1e3:g} mm, sheared {pose.shear * 1e3:g} mm"
    else:
        margin = field.safety_margin(shot.settled.friction)
        forces = f"grip {pose.grip:g} N, load {pose.load:g} N, µ {shot.settled.friction:.3g}" + (
            f", safety margin {margin:.2f}" if np.isfinite(margin) else ", no contact"
        )
    return f"{Path(scene.sensor).stem}, {scene.renderer}: {forces}"


def _dome_title(pose: DomePose, shot: Shot) -> str:
    """How an object was put on a dome, and what it does there."""
    field, friction = shot.settled.field, shot.settled.friction
    assert field is not None
    x, y, z = field.total_force
    parts = []
    if pose.force is None:
        parts.append(f"pressed {1e3 * pose.press:.3g} mm")
        if any(pose.shear):
            parts.append("sheared " + " and ".join(f"{1e3 * s:.3g}" for s in pose.shear) + " mm")
    if pose.twist:
        parts.append(f"twisted {np.degrees(pose.twist):.3g}°")
    parts.append(f"force {x:z.2f}, {y:z.2f} and {-z:z.2f} N down")
    parts.append(f"torque {1e3 * field.torque((0.0, 0.0, 1.0)):z.2f} N·mm")
    margin, limit = field.safety_margin(friction), margin_within(field, friction)
    parts.append(
        f"Γ {margin:z.2f}, with torsion {limit:z.2f}" if np.isfinite(margin) else "no contact"
    )
    return ", ".join(parts)


def _markers(axis: Any, scene: Scene, shot: Shot) -> None:
    field = shot.settled.field
    forces = field is not None and bool(field.contact.any())
    axis.set_title("image, marker centres" + (", contact forces" if forces else ""))
    axis.imshow(shot.frame.image)
    for layer, colour in ((1, YELLOW), (0, MAGENTA)):
        visible = shot.truth.visible[layer]
        axis.plot(*shot.truth.pixels[layer, visible].T, "+", color=colour, markersize=3.5, mew=0.7)
    if field is None or not forces:
        return
    view, touching = scene.build_sensor().view, field.contact
    if field.position.shape[1] == 3:  # friction alone: a press along the view has no direction
        places, step = field.position[touching], 2e-4
        friction = field.friction[touching]
        longest = max(np.linalg.norm(friction, axis=1).max(), 1e-12)
        base = view.project(places)
        force = (view.project(places + step * friction / longest) - base) / step
        largest = np.linalg.norm(force, axis=1).max()
        # Longer ones would hide each other where the contact is small in the picture.
        wide = float(np.ptp(base, axis=0).max())
        force *= min(ARROW * view.height, OF_CONTACT * wide) / max(largest, 1e-12)
        every = 1
    else:
        x, z = field.position[touching].T
        base = view.project(np.column_stack([x, np.zeros_like(x), z]))
        force = np.column_stack([field.friction, -field.normal])[touching]
        force *= 0.12 * view.height / max(abs(force).max(), 1e-12)
        every = 2
    axis.quiver(
        *base[::every].T,
        *force[::every].T,
        angles="xy",
        scale_units="xy",
        scale=1,
        color=FORCE,
        width=2e-3,
    )


def _layers(axis: Any, shot: Shot) -> None:
    axis.set_title("layers: magenta, yellow, overlap")
    magenta, yellow = shot.truth.masks
    picture = np.ones((*magenta.shape, 3))
    picture *= 1.0 - magenta[..., None] * (1.0 - np.array([0.85, 0.25, 0.55]))
    picture *= 1.0 - yellow[..., None] * (1.0 - np.array([1.0, 0.85, 0.2]))
    axis.imshow(picture)


def _flow(axis: Any, shot: Shot) -> None:
    flow = shot.truth.flow[0]
    length = np.linalg.norm(flow, axis=-1)
    largest = float(np.nanmax(length, initial=0.0))
    magnify = round(float(np.clip(1.5 * SPACING / max(largest, 1e-3), *MAGNIFY)))
    axis.set_title(f"motion of the outer layer since rest, up to {largest:.1f} px, ×{magnify}")
    axis.imshow(length, cmap="Greys", vmin=0.0, vmax=max(2.0 * largest, 1e-3))
    rows, cols = (slice(SPACING // 2, None, SPACING) for _ in range(2))
    y, x = np.mgrid[: length.shape[0], : length.shape[1]]
    arrows = magnify * flow[rows, cols]
    axis.quiver(
        x[rows, cols],
        y[rows, cols],
        arrows[..., 0],
        arrows[..., 1],
        angles="xy",
        scale_units="xy",
        scale=1,
        width=1.5e-3,
        color=MAGENTA,
    )


def _depth(figure: Figure, axis: Any, shot: Shot) -> None:
    # The distance itself is mostly that the rays of a pad's rim are longer.
    axis.set_title("how much nearer to the camera the skin is than at rest")
    picture = axis.imshow(1e3 * (shot.rest_depth - shot.truth.depth), cmap="viridis")
    figure.colorbar(picture, ax=axis, label="mm", shrink=0.85)
