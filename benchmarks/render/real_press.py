"""The dome of 2020 pressed as in its publication and in pictures of it: hue and outward flow."""

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from chromagrip.model import Solid, press_and_move, simulate_contact
from chromagrip.model.dome import lattice
from chromagrip.model.shapes import Shape, ball, plane
from chromagrip.output.report import Row, reported, within
from chromagrip.render import DomeMap, Membrane, SensorDesign, centroids, load_sensor, outlines
from chromagrip.render.drawing import Painter

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Deepest press over the silicone's thickness, and steps to it.
DEEPEST, STEPS = 0.45, 40
#: Friction of the objects.
FRICTION = 0.5
#: Largest motion of the apex marker for which the hue's slope is compared with the published [mm].
RANGE_MM = 0.5
#: Published slope of the hue [°/mm], 30 % to either side.
SLOPE = (6.44, 11.96)
#: Flow in a real pair of pictures, 800×582 [px], and radius of the part that it is the mean of.
FLOW, PART = (2.9, 3.0), 80.0
#: Radius of the dome's image in that pair and in the design's picture [px].
SEEN, OURS = 263.0, 142.0


def real_presses() -> Iterator[Row]:
    """Rows of the hue under presses, and of the depth at which the flow is the real pair's."""
    printed = load_sensor("dome-2020-printed")
    moved, hue, share = _hues(printed, (plane(), ball(10e-3)))
    near = moved <= RANGE_MM
    slope = abs(np.polyfit(moved[near], hue[near], 1)[0])
    yield within(("dome-2020-printed", "hue_slope"), float(slope), "°/mm", *SLOPE)
    fit = np.corrcoef(moved[near], hue[near])[0, 1] ** 2
    yield reported(("dome-2020-printed", "hue_slope_r2"), float(fit), "")
    whole = abs(np.polyfit(moved, hue, 1)[0])
    unit = f"°/mm (to {moved.max():.1f} mm)"
    yield reported(("dome-2020-printed", "hue_slope_of_all_presses"), float(whole), unit)
    yield reported(("dome-2020-printed", "shear_of_the_centroid"), share, "of the object's")
    plain = load_sensor("dome-2020")
    depth, flow = outward_flow(plain, plane())
    low, high = (float(np.interp(value, flow, depth)) for value in FLOW)
    middle = (low + high) / 2
    yield reported(("dome-2020", "depth_of_the_real_flow"), middle, "mm")
    convex = outward_flow(plain, ball(20e-3))
    yield reported(
        ("dome-2020", "flow_of_a_ball_of_20_mm"), float(np.interp(middle, *convex)), "px"
    )


def _states(sensor: SensorDesign, shape: Shape, shift: float = 0.0) -> tuple[Array, list[Membrane]]:
    """Depths of an object's press [mm], and the membrane at each; a shift [m] comes last."""
    dome = sensor.dome
    motion = press_and_move(DEEPEST * dome.thickness, shift=(shift, 0.0), press_s=0.1)
    solid = Solid(shape=shape, friction=FRICTION)
    run = simulate_contact(dome, solid, motion, 0.1 / STEPS, keep=10 * STEPS)
    membrane_map = DomeMap(sensor, dome)
    share = np.minimum([state.time / 0.1 for state in run.states], 1.0)
    return 1e3 * DEEPEST * dome.thickness * share, [membrane_map(s.linear) for s in run.states]


def _untouched(sensor: SensorDesign) -> Membrane:
    dome = sensor.dome
    return DomeMap(sensor, dome)(np.zeros_like(lattice(dome).points))


def _hues(sensor: SensorDesign, shapes: tuple[Shape, ...]) -> tuple[Array, Array, float]:
    """Motion of the apex marker [mm] and hue of its pixels [°] in presses; its share of a shear.

    As published: mean hue of the marker's pixels whose saturation is above a half.
    """
    rest, painter = _untouched(sensor), Painter(sensor)
    apex = int(np.argmin(sensor.places[:, 0]))
    reach = 1.6 * float(np.linalg.norm(outlines(rest, sensor.view)[1, apex, 1]))
    moved, hue = [], []
    for shape in shapes:
        for membrane in _states(sensor, shape)[1][:STEPS]:
            moved.append(1e3 * (rest.centres - membrane.centres)[0, apex, 2])
            centre = centroids(outlines(membrane, sensor.view), False)[1, apex]
            hue.append(mean_hue(painter.render(membrane), centre, reach))
    shear = 0.2e-3
    *_, end = _states(sensor, plane(), shear)[1]
    pressed = _states(sensor, plane())[1][STEPS - 1]
    share = float((end.centres - pressed.centres)[0, apex, 0] / shear)
    return np.array(moved), np.array(hue), share


def mean_hue(image: Image, centre: Array, radius: float) -> float:
    """Mean hue [°] of saturated pixels around a place; hues beyond 180° count as negative."""
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    near = np.hypot(x - centre[0], y - centre[1]) < radius
    hue, saturation, _ = cv2.split(cv2.cvtColor(image.astype(np.float32), cv2.COLOR_RGB2HSV))
    chosen = hue[near & (saturation > 0.5)]
    return float(np.where(chosen > 180.0, chosen - 360.0, chosen).mean())


def outward_flow(sensor: SensorDesign, shape: Shape) -> tuple[Array, Array]:
    """Depth of a press [mm], and mean flow of the magenta layer away from the apex [px].

    In pixels of the real pair, within 80 px of the apex.
    """
    view, scale = sensor.view, SEEN / OURS
    middle = np.array([view.width - 1.0, view.height - 1.0]) / 2.0
    rest = centroids(outlines(_untouched(sensor), view), False)[0] - middle
    size = np.linalg.norm(rest, axis=1)
    near = (scale * size < PART) & (size > 1.0)
    depth, membranes = _states(sensor, shape)
    flow = [
        ((centroids(outlines(one, view), False)[0] - middle - rest) * rest).sum(axis=1) / size
        for one in membranes
    ]
    return depth[:STEPS], scale * np.array(flow)[:STEPS, near].mean(axis=1)
