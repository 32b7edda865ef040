"""Figures of the renderers: speed, accuracy, and how far they are from the real sensor."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from benchmarks.parts import Part, parts_study
from benchmarks.render.judge import colour_difference, layer_centroids, poses_of
from benchmarks.render.looks import likenesses, look_of_built, palette_distance, real_dome
from benchmarks.render.path_traced import against_path_traced
from benchmarks.render.real_press import real_presses
from chromagrip.extras import require
from chromagrip.loop.grasp import grasp
from chromagrip.measure.study import Asked, Study, study
from chromagrip.measure.worlds.contacts import contact_poses
from chromagrip.model import Solid, press_and_move, simulate_contact
from chromagrip.model.dome import contact_steps
from chromagrip.model.shapes import Shape, ball, plane
from chromagrip.output.processes import one_thread
from chromagrip.output.report import Row, at_least, at_most, reported, within
from chromagrip.render import (
    DomeMap,
    Membrane,
    MembraneMap,
    SensorDesign,
    TruthMap,
    add_noise,
    centroids,
    load_sensor,
    outlines,
    rest_membrane,
)
from chromagrip.render.drawing import (
    MeshRenderer,
    Painter,
    gl_problem,
    polygon_centroids,
    projected_outlines,
)
from chromagrip.scene.scene import load_scene
from chromagrip.sensing.sensor import open_camera

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
T = TypeVar("T")

#: Poses of objects on the dome.
POSES = 20
#: Specimens of the built dome that are looked at.
SPECIMENS = 10
#: Objects that slide on the dome: name, shape, press [m] and least pictures a second.
SLIDING = (
    ("100_contacts", ball(20e-3), 0.6e-3, 200.0),
    ("200_contacts", plane(), 0.8e-3, 120.0),
)
#: Path of the object between two of its pictures [m].
_TRAVEL = 20e-6
#: Pictures before those that are timed, and those that are.
_BEFORE, _PICTURES, _QUICK_PICTURES = 10, 150, 60
#: Median sRGB of a real dome's frame (Lin et al. 2020).
REAL_DOME = {
    "ground": (250, 249, 248),
    "overlap": (209, 107, 63),
    "yellow": (241, 212, 89),
    "magenta": (198, 86, 117),
}


@study("project", "render")
def render_study(asked: Asked) -> Study[Part, tuple[Row, ...]]:
    """Renderers: speed, accuracy, and likeness to real sensors.

    A quick run has fewer repeats and poses.
    """
    require("images")
    parts: dict[str, Callable[[bool], Iterable[Row]]] = {
        "speed and accuracy": _rows_of_renderers,
        "path-traced": against_path_traced,
        "real sensors": _real_sensor,
    }
    return parts_study(parts, asked)


def _rows_of_renderers(quick: bool) -> list[Row]:
    sensor = load_sensor("thesis")
    problem = gl_problem()
    with one_thread(), ExitStack() as stack:
        painter = Painter(sensor)
        mesh = None if problem else stack.enter_context(closing(MeshRenderer(sensor)))
        rows = [
            *_speed(sensor, painter, mesh, quick),
            *_frame_rows(),
            *_dome_speed(sensor, quick),
            *_accuracy(sensor, painter, mesh, quick),
        ]
    if problem:
        rows.append(reported(("pyrender", "not_measured"), None, "", problem))
    return rows


def _speed(
    sensor: SensorDesign,
    painter: Painter,
    mesh: MeshRenderer | None,
    quick: bool,
) -> Iterator[Row]:
    membrane_map = MembraneMap(sensor, 251)
    scene = load_scene("camera-100hz", {"path": "truth"})
    with closing(open_camera(scene)) as camera:
        displacements = [sample.state.deformation.seen for sample in grasp(scene, camera)]
    membranes = [membrane_map(displacement) for displacement in displacements]
    full = Painter(sensor, redraw=True)
    for renderer in (painter, full):
        renderer.render(membranes[0])
    times: dict[str, list[float]] = {"dirty": [], "full": [], "map": [], "mesh": []}
    for _repeat in range(2 if quick else 5):
        times["dirty"].append(_per_call(painter.render, membranes))
        times["full"].append(_per_call(full.render, membranes))
        times["map"].append(_per_call(membrane_map, displacements))
        if mesh is not None:
            times["mesh"].append(_per_call(mesh.render, membranes[:: 40 if quick else 20]))
    grasped, redrawn, mapped = (float(np.median(times[k])) for k in ("dirty", "full", "map"))
    yield at_least(("painter", "full_redraw"), 1.0 / redrawn, "frames/s", 500.0)
    yield at_least(("painter", "grasp"), 1.0 / grasped, "frames/s", 1000.0)
    rate = 1.0 / (redrawn + mapped)
    yield reported(("painter", "full_redraw_with_membrane"), rate, "frames/s")
    yield reported(("painter", "grasp_with_membrane"), 1.0 / (grasped + mapped), "frames/s")
    if mesh is not None:
        ratio = float(np.median(times["mesh"])) / redrawn
        yield at_least(("painter", "times_as_fast_as_pyrender"), ratio, "", 20.0)


def _frame_rows() -> Iterator[Row]:
    """Process time of a frame of the loop at 60 Hz: placing, noise, and the whole picture."""
    scene = load_scene("margin-60hz")
    with closing(open_camera(scene)) as camera:
        states = [sample.state for sample in grasp(scene, camera)]
        sensor = scene.build_sensor()
        carry = MembraneMap(sensor, scene.fingertip.nodes)
        image = camera.expose(states[0], 0).image
        parts: dict[str, list[float]] = {"placing": [], "noise": [], "picture": []}
        for index, state in enumerate(states):
            times = [time.process_time()]
            outlines(carry(state.deformation.seen), sensor.view)
            times.append(time.process_time())
            add_noise(image, scene.camera.noise_levels, scene.seed, index)
            times.append(time.process_time())
            camera.expose(state, index)
            times.append(time.process_time())
            for part, seconds in zip(parts.values(), np.diff(times), strict=True):
                part.append(1e3 * seconds)
    for (name, found), limit in zip(parts.items(), (0.15, 0.12, 0.6), strict=True):
        yield at_most(("frame", name), float(np.mean(found)), "ms", limit)


def _per_call(call: Callable[[T], object], arguments: Sequence[T]) -> float:
    """Mean time of a call over arguments, one after the other [s]."""
    begin = time.perf_counter()
    for argument in arguments:
        call(argument)
    return (time.perf_counter() - begin) / len(arguments)


def _dome_speed(sensor: SensorDesign, quick: bool) -> Iterator[Row]:
    """Pictures of a dome a second of process time, and what takes the time."""
    for name, shape, depth, target in SLIDING:
        count = _QUICK_PICTURES if quick else _PICTURES
        parts, touching = _sliding(sensor, shape, depth, count)
        yield reported(("dome", name, "touching"), touching, "")
        yield at_least(("dome", name, "pictures"), 1.0 / sum(parts.values()), "1/s", target)
        for part, seconds in parts.items():
            yield reported(("dome", name, part), 1e3 * seconds, "ms")


def _sliding(
    sensor: SensorDesign, shape: Shape, depth: float, count: int
) -> tuple[dict[str, float], float]:
    """Process time of each part of a picture [s], and how many nodes touch, as an object slides."""
    dome, solid, taken = sensor.dome, Solid(shape=shape), count + _BEFORE
    motion = press_and_move(depth, shift=(_TRAVEL * taken, 0.0), press_s=0.1, move_s=1e-3 * taken)
    pressed = simulate_contact(dome, solid, motion, 0.02, keep=100).states
    start = next(state for state in pressed if abs(state.time - 0.1) < 1e-9)
    carry, painter = DomeMap(sensor, dome), Painter(sensor)
    steps = contact_steps(dome, solid, motion, 1e-3, start)
    parts = dict.fromkeys(("step", "membrane", "picture"), 0.0)
    touching = []
    for k in range(taken):
        times = [time.process_time()]
        stepper, step = next(steps)
        times.append(time.process_time())
        membrane = carry(stepper.linear)
        times.append(time.process_time())
        painter.render(membrane)
        times.append(time.process_time())
        if k >= _BEFORE:
            touching.append(step.touching)
            for part, seconds in zip(parts, np.diff(times), strict=True):
                parts[part] += seconds / count
    return parts, float(np.mean(touching))


def _accuracy(
    sensor: SensorDesign,
    painter: Painter,
    mesh: MeshRenderer | None,
    quick: bool,
) -> Iterator[Row]:
    """Centres against truth, and the two renderers against each other, without noise."""
    membrane_map, truth_map = MembraneMap(sensor, 251), TruthMap(sensor, 251)
    ground = painter.render(_without_markers(sensor))
    judged = []
    for _name, displacement in poses_of(sensor)[-1 if quick else 0 :]:
        masks = truth_map(membrane_map(displacement), displacement).masks
        judged.append(_judged(sensor, painter, mesh, ground, membrane_map(displacement), masks))
    error = np.stack([each.error for each in judged])
    bias = np.abs(np.nanmean(error, axis=(0, 2))).max()
    yield at_most(("painter", "centre_bias"), float(bias), "px", 0.005)
    yield reported(("painter", "centre_rms"), float(np.sqrt(np.nanmean(error**2))), "px")
    if mesh is not None:
        yield from _apart(("painter_against_pyrender",), judged)
    yield from _dome_accuracy(sensor, painter, mesh, ground, quick)


def _dome_accuracy(
    sensor: SensorDesign,
    painter: Painter,
    mesh: MeshRenderer | None,
    ground: Image,
    quick: bool,
) -> Iterator[Row]:
    """The same for objects on the dome in any pose."""
    judged, maps = [], {}
    for _name, dome, forces in contact_poses("thesis", 3 if quick else POSES):
        if dome not in maps:
            maps[dome] = DomeMap(sensor, dome), TruthMap(sensor, dome)
        membrane = maps[dome][0](forces)
        (masks,) = maps[dome][1].images(["masks"], membrane, forces).values()
        judged.append(_judged(sensor, painter, mesh, ground, membrane, masks))
    error = np.stack([each.error for each in judged])
    yield reported(("painter", "dome", "centre_rms"), float(np.sqrt(np.nanmean(error**2))), "px")
    if mesh is not None:
        yield from _apart(("painter_against_pyrender", "dome"), judged)


class Judged(NamedTuple):
    """A pose as two renderers draw it.

    Attributes
    ----------
    error: of the painter's centres against the projected outlines [px], (2, M, 2)
    apart: of its centres from those of the mesh renderer [px], (2, M, 2)
    difference: of their colours where both layers overlap [ΔE2000]
    """

    error: Array
    apart: Array
    difference: Array


def _judged(
    sensor: SensorDesign,
    painter: Painter,
    mesh: MeshRenderer | None,
    ground: Image,
    membrane: Membrane,
    masks: NDArray[np.float32],
) -> Judged:
    found = layer_centroids(painter.render, sensor, membrane, ground)
    error = found - polygon_centroids(projected_outlines(sensor, membrane))
    if mesh is None:
        return Judged(error, np.empty(0), np.empty(0))
    both = masks.min(axis=0) > 0.99
    delta = colour_difference(painter.render(membrane)[both], mesh.render(membrane)[both])
    return Judged(error, found - layer_centroids(mesh.render, sensor, membrane, ground), delta)


def _apart(case: tuple[str, ...], judged: list[Judged]) -> Iterator[Row]:
    """Rows of how far two renderers are apart."""
    layers = np.sqrt(np.nanmean(np.stack([j.apart for j in judged]) ** 2, axis=(0, 2, 3)))
    yield at_most((*case, "magenta_centres"), layers[0], "px", 0.03)
    yield at_most((*case, "yellow_centres"), layers[1], "px", 0.03)
    delta = float(np.concatenate([j.difference for j in judged]).mean())
    yield at_most((*case, "overlap_colour"), delta, "ΔE2000", 2.0)


def _without_markers(sensor: SensorDesign) -> Membrane:
    rest = rest_membrane(sensor)
    return Membrane(centres=np.full_like(rest.centres, np.nan), axes=rest.axes)


def _real_sensor(quick: bool) -> Iterator[Row]:
    sensor = load_sensor("dome-2020-printed")
    yield from real_presses()
    # Published: 7 px/mm, 30 % to either side.
    yield within(("dome-2020-printed", "centroid_gain"), centroid_gain(sensor), "px/mm", 4.9, 9.1)
    for name, delta in colours(sensor).items():
        yield at_most(("colour", name), delta, "ΔE2000", 6.0)
    yield from _built_dome()


def _built_dome() -> Iterator[Row]:
    """How many of ten specimens of the dome of 2020 look like the real one, in each respect."""
    seen = [look_of_built(seed) for seed in range(SPECIMENS)]
    alike = [likenesses(each) for each in seen]
    for name in alike[0]:
        count = sum(each[name] for each in alike)
        yield at_least(("dome-2020", name), float(count), f"of {SPECIMENS} specimens", 8.0)
    real = np.array(list(real_dome()["palette"].values()))
    apart = np.array([palette_distance(each.palette, real) for each in seen])
    yield at_most(("dome-2020", "palette"), float(np.median(apart)), "CIELAB", 4.5)
    yield reported(("dome-2020", "palette_largest"), float(apart.max()), "CIELAB")


def centroid_gain(sensor: SensorDesign) -> float:
    """Motion of the apex marker's centroid in the image with its shear [px/mm]."""
    apex = int(np.argmin(sensor.places[:, 0]))
    rest = rest_membrane(sensor)
    shear = 0.5e-3
    moved = Membrane(centres=rest.centres + np.array([shear, 0.0, 0.0]), axes=rest.axes)
    before, after = (centroids(outlines(m, sensor.view), False)[0, apex] for m in (rest, moved))
    return float(np.linalg.norm(after - before) / (1e3 * shear))


def colours(sensor: SensorDesign) -> dict[str, float]:
    """CIEDE2000 of each colour's median from that of a real dome's frame."""
    rest = rest_membrane(sensor)
    # Half a marker apart, so that each dye is seen alone beside the overlap.
    half = sensor.half_sizes.max()
    centres = rest.centres.copy()
    centres[1] += half * rest.axes[1, :, :, 0] / sensor.half_sizes[1]
    membrane = Membrane(centres=centres, axes=rest.axes)
    painter = Painter(sensor)
    image = painter.render(membrane)
    magenta, yellow = TruthMap(sensor, 11)(membrane, np.zeros((11, 2))).masks
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    middle = np.hypot(x - image.shape[1] / 2, y - image.shape[0] / 2) < image.shape[0] / 5
    parts = {
        "overlap": (magenta > 0.99) & (yellow > 0.99),
        "yellow": (magenta < 0.01) & (yellow > 0.99),
        "magenta": (magenta > 0.99) & (yellow < 0.01),
    }
    medians = {name: np.median(image[part & middle], axis=0) for name, part in parts.items()}
    # The real frame's ground is a median over its middle, between seams.
    medians["ground"] = np.median(painter.render(_without_markers(sensor))[middle], axis=0)
    return {
        name: float(colour_difference(medians[name], np.array(real, dtype=float)))
        for name, real in REAL_DOME.items()
    }
