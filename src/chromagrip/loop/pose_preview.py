"""A labelled picture of an image and its ground truth."""

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from ..scene.scene import Scene
from .poses import Shot

#: Colours of the two layers' markers and of forces.
MAGENTA = "#b0125b"
YELLOW = "#b58900"
FORCE = "#1f4fd8"
#: Spacing of the flow's arrows [px].
SPACING = 16
#: Factor by which the flow is magnified.
MAGNIFY = 4.0


def draw_preview(scene: Scene, shot: Shot, path: Path) -> None:
    """Image with markers, forces, layers, flow and depth, with the pose above."""
    matplotlib.use("Agg", force=False)
    figure = Figure(figsize=(12.0, 9.4), dpi=100, layout="constrained")
    axes = figure.subplots(2, 2)
    figure.suptitle(_title(scene, shot))
    _markers(axes[0, 0], scene, shot)
    _layers(axes[0, 1], shot)
    _flow(axes[1, 0], shot)
    _depth(figure, axes[1, 1], shot)
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
    figure.savefig(path)


def _title(scene: Scene, shot: Shot) -> str:
    pose, field = shot.pose, shot.field
    if field is None:
        forces = f"pressed {pose.depth * 1e3:g} mm, sheared {pose.shear * 1e3:g} mm"
    else:
        margin = field.safety_margin(shot.friction)
        forces = f"grip {pose.grip:g} N, load {pose.load:g} N, µ {shot.friction:.3g}" + (
            f", safety margin {margin:.2f}" if np.isfinite(margin) else ", no contact"
        )
    return f"{Path(scene.sensor).stem}, {scene.renderer}: {forces}"


def _markers(axis: Any, scene: Scene, shot: Shot) -> None:
    forces = shot.field is not None and shot.field.contact.any()
    axis.set_title("image, marker centres" + (", contact forces" if forces else ""))
    axis.imshow(shot.frame.image)
    for layer, colour in ((1, YELLOW), (0, MAGENTA)):
        visible = shot.truth.visible[layer]
        axis.plot(*shot.truth.pixels[layer, visible].T, "+", color=colour, markersize=3.5, mew=0.7)
    if shot.field is not None and shot.field.contact.any():
        sensor, touching = scene.build_sensor(), shot.field.contact
        x, z = shot.field.position[touching].T
        base = sensor.view.project(np.column_stack([x, np.zeros_like(x), z]))
        force = np.column_stack([shot.field.friction, -shot.field.normal])[touching]
        force *= 0.12 * sensor.view.height / max(abs(force).max(), 1e-12)
        axis.quiver(
            *base[::2].T,
            *force[::2].T,
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
    axis.set_title(f"motion of the outer layer since rest, up to {largest:.1f} px, ×{MAGNIFY:g}")
    axis.imshow(length, cmap="Greys", vmin=0.0, vmax=max(2.0 * largest, 1e-3))
    rows, cols = (slice(SPACING // 2, None, SPACING) for _ in range(2))
    y, x = np.mgrid[: length.shape[0], : length.shape[1]]
    arrows = MAGNIFY * flow[rows, cols]
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
    axis.set_title("distance from the camera to the skin")
    picture = axis.imshow(1e3 * shot.truth.depth, cmap="viridis")
    figure.colorbar(picture, ax=axis, label="mm", shrink=0.85)
