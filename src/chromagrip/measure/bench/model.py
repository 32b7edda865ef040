"""Figures of the node models: speed as ratios in one run, accuracy against finer runs."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ...model import (
    ContactObject,
    Drive,
    Fingertip,
    ForceField,
    History,
    Method,
    ModelError,
    State,
    contact_forces,
    explicit_limit,
    rest_ensemble,
    rest_state,
    simulate,
    step_many,
)
from ...output.rows import Row, at_least, at_most, reported

Array = NDArray[np.float64]
Progress = Callable[[str], None]

#: The 27 objects of thesis section 5.2 (E4, E5).
OBJECTS = [
    ContactObject(friction=mu, stiffness=stiffness, curvature=curvature)
    for mu, stiffness, curvature in product(
        (0.3, 0.5, 0.7), (1000.0, 160.0, 80.0), (0.0, 50.0, 200.0)
    )
]
GRIPS = (0.1, 0.3, 1.0, 3.0, 10.0)
#: Share of a stable explicit step that the baseline takes.
SAFE = 0.9


def bench_model(quick: bool, progress: Progress) -> list[Row]:
    """Rows of the node models.

    Parameters
    ----------
    quick: fewer objects and grips, a coarser reference, shorter timings
    progress: told what is being run
    """
    return [
        *_against_dense(quick, progress),
        *_real_time(progress),
        *_cost_over_nodes(progress),
        *_graded(quick, progress),
        *_reductions(progress),
        *_true_steps(quick, progress),
        *_ensemble(quick, progress),
    ]


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
    t = np.array([0.0, 0.04, 0.04, 1.0, 1.0, 2.0])
    return Drive(
        times=t, normal=np.full(6, 5.0), lateral=np.array([0.0, 0.0, 0.25, 0.25, 0.65, 0.65])
    )


def _cpu(run: Callable[[], object], repeats: int) -> float:
    """Median CPU time of a call [s], after one that is not counted."""
    run()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        run()
        times.append(time.process_time() - start)
    return float(np.median(times))


def _against_dense(quick: bool, progress: Progress) -> Iterator[Row]:
    tip, obj, drive = Fingertip(), OBJECTS[9], _thesis_grasp()
    progress("2 s grasp, implicit, 1 ms steps")
    implicit = _cpu(lambda: simulate(tip, obj, drive, dt=1e-3, duration=2.0, every=100), 5)
    steps = 200 if quick else 1000
    seconds = {}
    baselines: tuple[Method, ...] = ("euler", "rk4")
    for method in baselines:
        dt = SAFE * explicit_limit(tip, obj, rest_state(tip), method)
        progress(f"dense {method}, {steps} steps of {dt * 1e6:.2f} µs")

        def run(method: Method = method, dt: float = dt) -> History:
            return simulate(tip, obj, drive, dt=dt, duration=steps * dt, every=steps, method=method)

        spent = _cpu(run, 1)
        seconds[method] = spent / steps * 2.0 / dt
        yield reported(f"dense/{method}/step", dt * 1e6, "µs")
        yield reported(f"dense/{method}/cpu_2s_scaled", seconds[method], "s")
    yield reported("implicit/cpu_2s", implicit, "s")
    yield at_least(
        "implicit/cpu_ratio_to_dense_scaled", min(seconds.values()) / implicit, "×", 1000
    )
    # The same accuracy: both against the implicit run at 1/20 of the explicit step, over 20 ms.
    progress("accuracy of both over 20 ms")
    small = Fingertip(nodes=51)
    short = Drive(times=np.array([0.0, 0.01]), normal=np.array([0.0, 1.0]), lateral=np.zeros(2))
    span = 0.012
    dt = span / np.ceil(span / (SAFE * explicit_limit(small, obj, rest_state(small), "euler")))
    fine = simulate(small, obj, short, dt=dt / 20, duration=span, every=round(20 * span / dt))
    truth = contact_forces(small, obj, fine.state(-1)).normal.sum()
    both: tuple[tuple[Method, float], ...] = (("euler", dt), ("implicit", 1e-3))
    for method, d in both:
        every = round(span / d)
        end = simulate(small, obj, short, dt=d, duration=span, every=every, method=method).state(-1)
        error = abs(contact_forces(small, obj, end).normal.sum() / truth - 1.0)
        yield reported(f"accuracy/{method}/normal_after_12ms", 100 * error, "%")


def _real_time(progress: Progress) -> Iterator[Row]:
    progress("2 s grasp against the clock")
    tip, obj, drive = Fingertip(), OBJECTS[9], _thesis_grasp()
    spent = _cpu(lambda: simulate(tip, obj, drive, dt=1e-3, duration=2.0, every=1), 5)
    yield at_least("implicit/times_real_time", 2.0 / spent, "×", 20)


def _cost_over_nodes(progress: Progress) -> Iterator[Row]:
    counts = (101, 251, 501, 1001, 2001, 4001)
    obj, drive = OBJECTS[9], smooth_grasp(2.0, 0.4)
    spent = []
    for nodes in counts:
        progress(f"cost of {nodes} nodes")
        tip = Fingertip(nodes=nodes)

        def run(tip: Fingertip = tip) -> History:
            return simulate(tip, obj, drive, dt=1e-3, duration=0.4, every=400)

        spent.append(_cpu(run, 3))
        yield reported(f"cost/{nodes}_nodes", spent[-1] / 400 * 1e6, "µs/step")
    slope = np.polyfit(np.log(counts), np.log(spent), 1)[0]
    yield at_most("cost/slope_over_nodes", slope, "", 1.1)
    # The same once the contact does not grow any more: a load on a settled grip.
    t = np.array([0.0, 0.4])
    pull = Drive(times=t, normal=np.full(2, 2.0), lateral=np.array([0.0, 0.4]))
    spent = []
    for nodes in counts:
        progress(f"cost of {nodes} nodes, settled grip")
        tip = Fingertip(nodes=nodes)
        settled = simulate(tip, obj, drive, dt=2e-3, duration=0.2, every=100).state(-1)
        settled = replace(settled, time=0.0)

        def hold(tip: Fingertip = tip, state: State = settled) -> History:
            return simulate(tip, obj, pull, dt=1e-3, duration=0.4, every=400, state=state)

        spent.append(_cpu(hold, 3))
    slope = np.polyfit(np.log(counts), np.log(spent), 1)[0]
    yield reported("cost/slope_over_nodes_settled_grip", slope, "")


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


def _graded(quick: bool, progress: Progress) -> Iterator[Row]:
    fine, graded = Fingertip(), Fingertip.graded()
    found = []
    for obj in OBJECTS[:: 5 if quick else 1]:
        for grip in (0.3, 1.0, 3.0, 5.0):
            progress(f"graded chain, µ {obj.friction}, {obj.stiffness:g} N/m, {grip} N")
            drive = smooth_grasp(grip, 0.5 * obj.friction * grip)
            a, b = (
                _measures(tip, obj, simulate(tip, obj, drive, dt=1e-3, duration=1.2, every=300))
                for tip in (fine, graded)
            )
            found.append(100 * abs(b[1:] / a[1:] - 1.0).max(axis=0))
    yield at_most("graded/nodes", graded.nodes, "", 100)
    names = ("normal", "friction", "width", "mu")
    for name, worst, usual in zip(
        names, np.max(found, 0), np.quantile(found, 0.95, 0), strict=True
    ):
        yield at_most(f"graded/{name}", worst, "%", 0.5)
        yield reported(f"graded/{name}_95_of_100_runs", usual, "%")


def _reductions(progress: Progress) -> Iterator[Row]:
    """What the other choices of less cost and save, on a press without load."""
    progress("half chain, no friction")
    tip, obj = Fingertip(), OBJECTS[9]
    drive = smooth_grasp(2.0, 0.0)

    def press(half: bool = False, friction: bool = True) -> tuple[float, Array]:
        def run() -> History:
            return simulate(
                tip, obj, drive, dt=1e-3, duration=0.4, every=400, half=half, friction=friction
            )

        return _cpu(run, 5), _measures(tip, obj, run())[-1]

    whole, truth = press()
    for name, choice in (("half", {"half": True}), ("no_friction", {"friction": False})):
        spent, found = press(**choice)
        yield reported(f"{name}/speed_up", whole / spent, "×")
        yield reported(f"{name}/normal", 100 * abs(found[0] / truth[0] - 1.0), "%")
        yield reported(f"{name}/width", 100 * abs(found[2] / truth[2] - 1.0), "%")


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


def _true_steps(quick: bool, progress: Progress) -> Iterator[Row]:
    tip = Fingertip()
    reference = 2e-4 if quick else 1e-5
    steps = (1e-3, 1e-2, 2e-2) if quick else (1e-4, 1e-3, 5e-3, 1e-2, 2e-2)
    worst = {dt: np.zeros(2) for dt in steps}
    swing = 0.0
    beyond = 0
    for obj, grip in product(OBJECTS[:: 4 if quick else 1], GRIPS[:: 2 if quick else 1]):
        progress(
            f"steps: µ {obj.friction}, {obj.stiffness:g} N/m, {obj.curvature:g} /m, grip {grip} N"
        )
        drive = smooth_grasp(grip, 0.5 * obj.friction * grip)

        def run(dt: float, obj: ContactObject = obj, drive: Drive = drive) -> History:
            every = round(0.1 / dt)
            return simulate(tip, obj, drive, dt=dt, duration=1.2, every=every)

        try:
            truth = margins(tip, obj, run(reference))
        except ModelError:
            beyond += 1  # no contact force of this object carries this grip, at any step
            continue
        for dt in steps:
            found = margins(tip, obj, run(dt))
            worst[dt] = np.maximum(worst[dt], abs(found / truth - 1.0).max(axis=0))
        swing = max(swing, _swing(tip, obj, drive))
    label = "0.2 ms" if quick else "0.01 ms"
    for dt, (normal, margin) in worst.items():
        limit = 2.0 if dt <= 1e-2 else np.inf
        name = f"steps/{dt * 1e3:g}ms"
        yield at_most(f"{name}/normal_to_{label}", 100 * float(normal), "%", limit)
        yield at_most(f"{name}/margin_to_{label}", 100 * float(margin), "%", limit)
    yield at_most("steps/20ms/swing_at_rest", 1e3 * swing, "mN", 1.0)
    yield reported("steps/grips_no_object_force_carries", float(beyond), "runs")


def _swing(tip: Fingertip, obj: ContactObject, drive: Drive) -> float:
    """Largest change of ΣFn from step to step at 20 ms, 0.6 s after the grip has settled [N]."""
    still = replace(drive, lateral=np.zeros_like(drive.lateral))
    run = simulate(tip, obj, still, dt=2e-2, duration=1.2)
    normal = [
        contact_forces(tip, obj, run.state(k)).normal.sum() for k in range(len(run) - 15, len(run))
    ]
    return float(abs(np.diff(normal, n=2)).max())


def _ensemble(quick: bool, progress: Progress) -> Iterator[Row]:
    tip = Fingertip.graded()
    objects = OBJECTS * 2
    count, steps = len(objects), 200 if quick else 1000
    grips = np.random.default_rng(0).uniform(0.5, 4.0, count)
    t: Array = np.linspace(1e-3, steps * 1e-3, steps)
    grip = grips[:, None] * _smooth(t, 0.0, 0.2)
    friction = np.array([obj.friction for obj in objects])
    load = 0.5 * friction[:, None] * grip * _smooth(t, 0.2, 0.6)
    start = rest_ensemble(tip, count)
    for threads in (1, 2):
        progress(f"ensemble, {threads} threads")
        step_many(tip, objects, start, 1e-3, grip[:, :2], load[:, :2], threads)
        begun = time.perf_counter()
        step_many(tip, objects, start, 1e-3, grip, load, threads)
        rate = count * steps / (time.perf_counter() - begun)
        name = f"ensemble/{threads}_threads"
        yield (
            reported(name, rate, "steps/s")
            if threads == 1
            else at_least(name, rate, "steps/s", 50e3)
        )
