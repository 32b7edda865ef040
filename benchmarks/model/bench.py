"""Figures of the node models: speed as ratios in one run, accuracy against finer runs."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from benchmarks.model.bodies import bench_bodies
from benchmarks.model.dome import bench_dome
from benchmarks.model.integrators import explicit_limit, integrate
from benchmarks.model.mesh_distances import bench_meshes
from benchmarks.model.pinch_steps import pinch_rows
from benchmarks.parts import Part, parts_study
from chromagrip import thesis
from chromagrip.measure.study import Asked, Study, study
from chromagrip.measure.worlds.grasps import contact_object
from chromagrip.model import (
    ContactObject,
    Drive,
    Fingertip,
    ForceField,
    History,
    ModelError,
    contact_forces,
    simulate,
)
from chromagrip.output.report import Bounds, Row, at_least, at_most, measured, reported

Array = NDArray[np.float64]

#: The 27 objects of the thesis.
OBJECTS = [contact_object(index) for index in range(len(thesis.OBJECTS))]
#: Object on which methods are compared: µ 0.5, 1000 N/m, flat.
_OBJECT = OBJECTS[9]
#: Grips of the test of steps [N].
GRIPS = (0.1, 0.3, 1.0, 3.0, 10.0)
#: Share of a stable explicit step that the baseline takes.
SAFE = 0.9


@study("project", "model")
def model_study(asked: Asked) -> Study[Part, tuple[Row, ...]]:
    """Node models, dome and pinch: speed as ratios in one run, accuracy against finer runs.

    A quick run has fewer objects and grips, a coarser reference and shorter timings.
    """
    parts: dict[str, Callable[[bool], Iterable[Row]]] = {
        "against dense": _against_dense,
        "real time": lambda _: _real_time(),
        "cost over nodes": lambda _: _cost_over_nodes(),
        "graded": _graded,
        "true steps": _true_steps,
        "dome": bench_dome,
        "meshes": bench_meshes,
        "bodies": bench_bodies,
        "pinch": pinch_rows,
    }
    return parts_study(parts, asked)


def _smooth(t: Array, start: float, end: float) -> Array:
    """Step from 0 to 1 with two continuous derivatives."""
    x = np.clip((t - start) / (end - start), 0.0, 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x * x)


def smooth_grasp(grip: float, load: float) -> Drive:
    """Grip rises over 0.2 s, the load in two rises to 0.9 s."""
    t = np.linspace(0.0, 1.2, 2401)
    loads = load * (0.4 * _smooth(t, 0.2, 0.5) + 0.6 * _smooth(t, 0.6, 0.9))
    return Drive(times=t, normal=grip * _smooth(t, 0.0, 0.2), lateral=loads)


def _thesis_grasp() -> Drive:
    """Conservative Control of the validation experiment: 5 N, load steps at 0.04 and 1 s."""
    (first, second), (small, large) = thesis.LOAD_TIMES_S, thesis.LOADS_N
    return Drive(
        times=np.array([0.0, first, first, second, second, thesis.DURATION_S]),
        normal=np.full(6, 5.0),
        lateral=np.array([0.0, 0.0, small, small, large, large]),
    )


def _cpu(run: Callable[[], object], repeats: int) -> float:
    """Median CPU time of a call [s]; the first call is not counted."""
    run()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        run()
        times.append(time.process_time() - start)
    return float(np.median(times))


def _against_dense(quick: bool) -> Iterator[Row]:
    tip, drive = Fingertip(), _thesis_grasp()
    implicit = _cpu(lambda: simulate(tip, _OBJECT, drive, dt=1e-3, duration=2.0, every=100), 5)
    steps = 200 if quick else 1000
    seconds = []
    for method in ("euler", "rk4"):
        dt = SAFE * explicit_limit(tip, _OBJECT, method=method)
        run = partial(
            integrate, method, tip, _OBJECT, drive, dt=dt, duration=steps * dt, every=steps
        )
        seconds.append(_cpu(run, 1) / steps * 2.0 / dt)
        yield reported(("dense", method, "step"), dt * 1e6, "µs")
        yield reported(("dense", method, "cpu_2s_scaled"), seconds[-1], "s")
    yield reported(("implicit", "cpu_2s"), implicit, "s")
    ratio = min(seconds) / implicit
    yield at_least(("implicit", "cpu_ratio_to_dense_scaled"), ratio, "×", 1000)
    # Accuracy of both, against the implicit run at 1/20 of the explicit step, over 12 ms.
    small = Fingertip(nodes=51)
    short = Drive(times=np.array([0.0, 0.01]), normal=np.array([0.0, 1.0]), lateral=np.zeros(2))
    span = 0.012
    limit = explicit_limit(small, _OBJECT)
    dt = span / np.ceil(span / (SAFE * limit))

    def final_normal(dt: float, method: str) -> float:
        every = round(span / dt)
        run = integrate(method, small, _OBJECT, short, dt=dt, duration=span, every=every)
        return float(contact_forces(small, _OBJECT, run.state(-1)).normal.sum())

    truth = final_normal(dt / 20, "implicit")
    for method, step in {"euler": dt, "implicit": 1e-3}.items():
        error = abs(final_normal(step, method) / truth - 1.0)
        yield reported(("accuracy", method, "normal_after_12ms"), 100 * error, "%")


def _real_time() -> Iterator[Row]:
    tip, drive = Fingertip(), _thesis_grasp()
    spent = _cpu(lambda: simulate(tip, _OBJECT, drive, dt=1e-3, duration=2.0, every=1), 5)
    yield at_least(("implicit", "times_real_time"), 2.0 / spent, "×", 20)


def _cost_over_nodes() -> Iterator[Row]:
    counts = (101, 251, 501, 1001, 2001, 4001)
    grasp = smooth_grasp(2.0, 0.4)
    # A load on a settled grip: the contact does not grow any more.
    pull = Drive(times=np.array([0.0, 0.4]), normal=np.full(2, 2.0), lateral=np.array([0.0, 0.4]))
    growing, settled = [], []
    for nodes in counts:
        tip = Fingertip(nodes=nodes)
        run = partial(simulate, tip, _OBJECT, dt=1e-3, duration=0.4, every=400)
        growing.append(_cpu(partial(run, grasp), 3))
        yield reported(("cost", f"{nodes}_nodes"), growing[-1] / 400 * 1e6, "µs/step")
        state = simulate(tip, _OBJECT, grasp, dt=2e-3, duration=0.2, every=100).state(-1)
        settled.append(_cpu(partial(run, pull, state=replace(state, time=0.0)), 3))
    yield at_most(("cost", "slope_over_nodes"), _slope(counts, growing), "", 1.1)
    yield reported(("cost", "slope_over_nodes_settled_grip"), _slope(counts, settled), "")


def _slope(counts: Sequence[int], seconds: Sequence[float]) -> float:
    """Exponent of the time over the number of nodes."""
    return float(np.polyfit(np.log(counts), np.log(seconds), 1)[0])


def _width(tip: Fingertip, field: ForceField) -> float:
    """Contact width between the points where the force crosses the threshold [m]."""
    force = field.normal / tip.contact_threshold
    (inside,) = np.nonzero(force > 1.0)
    x = field.position[:, 0]
    i, j = inside[0], inside[-1]
    left = x[i] - (x[i] - x[i - 1]) * (force[i] - 1.0) / (force[i] - force[i - 1])
    right = x[j] + (x[j + 1] - x[j]) * (force[j] - 1.0) / (force[j] - force[j + 1])
    return float(right - left)


def _measures(tip: Fingertip, obj: ContactObject, run: History) -> Array:
    """ΣFn, ΣFf, width and largest ratio at each recorded instant but the first, (R − 1, 4)."""
    rows = []
    for k in range(1, len(run)):
        field = contact_forces(tip, obj, run.state(k))
        ratio = abs(field.friction) / np.maximum(field.normal, 1e-12)
        rows.append(
            (
                field.normal.sum(),
                abs(field.friction.sum()),
                _width(tip, field),
                ratio[field.contact].max(),
            )
        )
    return np.array(rows)


def _graded(quick: bool) -> Iterator[Row]:
    fine, graded = Fingertip(), Fingertip.graded()
    errors = []
    for obj, grip in product(OBJECTS[:: 5 if quick else 1], (0.3, 1.0, 3.0, 5.0)):
        drive = smooth_grasp(grip, 0.5 * obj.friction * grip)
        a, b = (
            _measures(tip, obj, simulate(tip, obj, drive, dt=1e-3, duration=1.2, every=300))
            for tip in (fine, graded)
        )
        errors.append(100 * abs(b[1:] / a[1:] - 1.0).max(axis=0))
    yield at_most(("graded", "nodes"), graded.nodes, "", 100)
    for name, column in zip(
        ("normal", "friction", "width", "mu"), np.transpose(errors), strict=True
    ):
        yield at_most(("graded", name), column.max(), "%", 0.5)
        usual = np.quantile(column, 0.95)
        yield reported(("graded", f"{name}_95_of_100_runs"), usual, "%")


def margins(tip: Fingertip, obj: ContactObject, run: History) -> Array:
    """ΣFn and Γ over all nodes at each recorded instant but the first, shape (R − 1, 2).

    Γ is NaN where nothing touches.
    """
    rows = []
    for k in range(1, len(run)):
        field = contact_forces(tip, obj, run.state(k))
        normal, friction = field.normal.sum(), abs(field.friction.sum())
        rows.append((normal, 1.0 - friction / (obj.friction * normal) if normal else np.nan))
    return np.array(rows)


def _true_steps(quick: bool) -> Iterator[Row]:
    tip = Fingertip()
    reference = 2e-4 if quick else 1e-5
    steps = (1e-3, 1e-2, 2e-2) if quick else (1e-4, 1e-3, 5e-3, 1e-2, 2e-2)
    largest = {dt: np.zeros(2) for dt in steps}
    swing = 0.0
    beyond = 0
    for obj, grip in product(OBJECTS[:: 4 if quick else 1], GRIPS[:: 2 if quick else 1]):
        drive = smooth_grasp(grip, 0.5 * obj.friction * grip)

        def run(dt: float, obj: ContactObject = obj, drive: Drive = drive) -> Array:
            every = round(0.1 / dt)
            history = simulate(tip, obj, drive, dt=dt, duration=1.2, every=every)
            return margins(tip, obj, history)

        try:
            truth = run(reference)
        except ModelError:
            beyond += 1  # no contact force of this object carries this grip, at any step
            continue
        for dt in steps:
            largest[dt] = np.maximum(largest[dt], abs(run(dt) / truth - 1.0).max(axis=0))
        swing = max(swing, _swing(tip, obj, drive))
    label = "0.2 ms" if quick else "0.01 ms"
    for dt, errors in largest.items():
        target = Bounds(high=2.0) if dt <= 1e-2 else None
        for name, error in zip(("normal", "margin"), 100 * errors, strict=True):
            yield measured(("steps", f"{dt * 1e3:g}ms", f"{name}_to_{label}"), error, "%", target)
    yield at_most(("steps", "20ms", "swing_at_rest"), 1e3 * swing, "mN", 1.0)
    yield reported(("steps", "grips_no_object_force_carries"), beyond, "runs")


def _swing(tip: Fingertip, obj: ContactObject, drive: Drive) -> float:
    """Largest change of ΣFn from step to step at 20 ms, 0.6 s after the grip has settled [N]."""
    still = replace(drive, lateral=np.zeros_like(drive.lateral))
    run = simulate(tip, obj, still, dt=2e-2, duration=1.2)
    normal = [
        contact_forces(tip, obj, run.state(k)).normal.sum() for k in range(len(run) - 15, len(run))
    ]
    return float(abs(np.diff(normal, n=2)).max())
