"""Time per frame of each renderer against its error."""

import time
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.parts import Part, whole_chart
from benchmarks.render.judge import colour_difference, layer_centroids, poses_of
from chromagrip.extras import require
from chromagrip.measure.charts.chart import Axis, Chart, Point
from chromagrip.measure.study import Asked, Study, study
from chromagrip.output.processes import one_thread
from chromagrip.render import (
    MembraneMap,
    Renderer,
    SensorDesign,
    TruthMap,
    encode_srgb,
    ground_image,
    load_sensor,
)
from chromagrip.render.drawing import (
    MeshRenderer,
    Painter,
    gl_problem,
    polygon_centroids,
    projected_outlines,
    supersampled_image,
)

Image = NDArray[np.uint8]
#: Errors that are drawn.
AXES = (
    Axis(key="centre_error", label="centre of a marker, RMS error [px]", unit="px"),
    Axis(key="colour_error", label="colour on the markers, mean CIEDE2000", unit="ΔE2000"),
)


@study("project", "chart-render")
def render_chart(asked: Asked) -> Study[Part, Chart]:
    """Time per frame of each renderer against its error; a quick run has fewer repeats."""
    require("images")
    return whole_chart(_chart, "renderers", asked)


def _chart(quick: bool) -> Chart:
    with one_thread():
        points = _measure(load_sensor("thesis"), quick)
    title = "Renderers: 400 markers in two layers, 640×480"
    return Chart(part="render", title=title, per="frame", points=points, axes=AXES)


def _measure(sensor: SensorDesign, quick: bool) -> list[Point]:
    membrane_map = MembraneMap(sensor, 251)
    _, displacement = poses_of(sensor)[1]
    membrane = membrane_map(displacement)
    # A load that grows: every marker near the contact moves a little from frame to frame.
    shares = np.linspace(0.5, 1.0, 4 if quick else 10)
    sequence = [membrane_map(share * displacement) for share in shares]
    exact = supersampled_image(sensor, membrane)
    truth = polygon_centroids(projected_outlines(sensor, membrane))
    marked = TruthMap(sensor, 251)(membrane, displacement).masks.max(axis=0) > 0.01
    bare = np.rint(encode_srgb(ground_image(sensor).astype(float))).astype(np.uint8)
    renderers = _renderers(sensor)
    points = [
        Point(
            name=name,
            times=[],
            errors={},
            ours="painter" in name,
            settings="sensor thesis, a load that grows over ten frames",
            command="./run bench chart-render",
        )
        for name in renderers
    ]
    # In turns, so that other load of the machine affects all alike; one renderer at a time, because
    # closing one OpenGL context takes the display from the others.
    for turn in range(2 if quick else 4):
        for point in points:
            renderer = renderers[point.name]()
            renderer.render(sequence[0])
            for _ in range(2):
                begin = time.perf_counter()
                for frame in sequence:
                    renderer.render(frame)
                point.times.append(1e3 * (time.perf_counter() - begin) / len(sequence))
            if turn == 0:
                off = layer_centroids(renderer.render, sensor, membrane, bare) - truth
                colour = colour_difference(renderer.render(membrane)[marked], exact[marked]).mean()
                centre = float(np.sqrt(np.nanmean(off**2)))
                point.errors.update(centre_error=centre, colour_error=float(colour))
            renderer.close()
    return points


def _renderers(sensor: SensorDesign) -> dict[str, Callable[[], Renderer]]:
    """Constructor of each renderer at each setting, by name."""
    renderers: dict[str, Callable[[], Renderer]] = {
        "painter": lambda: Painter(sensor),
        "painter, redrawn in full": lambda: Painter(sensor, redraw=True),
    }
    if gl_problem() is None:
        for k in (1, 2, 3):
            renderers[f"pyrender, {k}×{k} samples"] = partial(MeshRenderer, sensor, k)
    return renderers
