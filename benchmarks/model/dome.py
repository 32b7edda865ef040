"""Figures of the dome: speed of its steps, and its contact against analysis and conservation."""

import math
import time
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from chromagrip.model import (
    Dome,
    DomeRun,
    DomeState,
    Motion,
    Solid,
    dome_forces,
    limit_margin,
    press_and_move,
    simulate_contact,
)
from chromagrip.model.dome import compliance_table, contact_steps, lattice, make_table
from chromagrip.model.shapes import Shape, ball, box, capsule, cone, cylinder, plane, torus
from chromagrip.output.report import Row, at_least, at_most, reported, within

Array = NDArray[np.float64]

#: Pitches of the test of convergence [m].
_PITCHES = (0.6e-3, 0.4e-3, 0.28e-3)
#: Nearly a half space under its small contact.
_THICK = Dome(
    core=0.6e-3, young=1e6, poisson=0.49, pitch=0.14e-3, reach=math.radians(22.0), stiffening=False
)
_RIGID = 1e12
#: Presses of it by 0.04 and 0.08 mm against Hertz, which knows no finite dome, and against finite
#: elements of the same dome (`fixtures/hyperelastic/make.py --check`: 1.058 and 1.081 of Hertz).
_PRESSES = (("hertz", "force", 1.0, 7.0), ("finite_elements", "force", 1.081, 2.0))
_MM = 1e-3


def bench_dome(quick: bool) -> Iterator[Row]:
    """Rows of the dome."""
    yield from _speed(quick)
    yield from _analysis()
    yield from _orders(quick)
    yield from _symmetry()
    yield from _energy()
    yield from _robust(quick)


def _speed(quick: bool) -> Iterator[Row]:
    begin = time.perf_counter()
    make_table(Dome(reach=math.radians(79.0)))
    yield at_most(("dome", "build", "first"), time.perf_counter() - begin, "s", 20)
    compliance_table(Dome())
    compliance_table.cache_clear()
    begin = time.perf_counter()
    table = compliance_table(Dome())
    yield at_most(("dome", "build", "from_cache"), time.perf_counter() - begin, "s", 0.3)
    yield at_most(("dome", "build", "table"), table.nbytes / 1e6, "MB", 200)
    steps = 60 if quick else 150
    scenes: tuple[tuple[str, Dome, Shape, float, int], ...] = (
        ("100_contacts", Dome(stiffening=False), ball(20 * _MM), 0.6 * _MM, 1000),
        ("200_contacts", Dome(stiffening=False), plane(), 0.8 * _MM, 400),
        ("400_contacts", Dome(pitch=0.28 * _MM, stiffening=False), plane(), 0.8 * _MM, 150),
    )
    for name, dome, shape, depth, target in scenes:
        for travel, judged in ((5e-6, True), (20e-6, False)):
            rate, touching = _rate(dome, Solid(shape=shape), depth, travel, steps)
            score = f"steps_at_{travel * 1e6:.0f}um"
            yield reported(("dome", name, f"touching_at_{travel * 1e6:.0f}um"), touching, "")
            if judged:
                yield at_least(("dome", name, score), rate, "1/s", target)
            else:
                yield reported(("dome", name, score), rate, "1/s")


def _rate(dome: Dome, solid: Solid, depth: float, travel: float, steps: int) -> tuple[float, float]:
    """Steps per second of process time while an object slides, and the nodes that touch."""
    before = 10
    motion = press_and_move(
        depth, shift=(travel * (steps + before), 0.0), press_s=0.1, move_s=1e-3 * (steps + before)
    )
    pressed = simulate_contact(dome, solid, motion, 0.02, keep=12).states
    start = next(state for state in pressed if abs(state.time - 0.1) < 1e-9)
    touching, begin = 0, 0.0
    for k, (_, count) in enumerate(contact_steps(dome, solid, motion, 1e-3, start)):
        if k == before:
            begin = time.process_time()
        touching = count.touching
    return steps / (time.process_time() - begin), float(touching)


def _smooth_solid(friction: float, shape: Shape | None = None) -> Solid:
    """A rigid object with Coulomb friction."""
    return Solid(
        shape=shape or plane(), stiffness=_RIGID, friction=friction, dahl_stiffness=1e11,
        dahl_exponent=0.0,
    )  # fmt: skip


def _analysis() -> Iterator[Row]:
    depth = 0.1 * _MM
    modulus = _THICK.young / (1.0 - _THICK.poisson**2)
    press = press_and_move(depth, twist=0.4)
    states = simulate_contact(_THICK, _smooth_solid(1e-9), press, 0.01, keep=21).states
    for state, (name, score, finite, most) in zip((states[3], states[7]), _PRESSES, strict=True):
        found = dome_forces(_THICK, state).total_normal
        hertz = 4.0 / 3.0 * modulus * math.sqrt(_THICK.radius) * (depth * state.time / 0.1) ** 1.5
        off = 100 * abs(found / (finite * hertz) - 1)
        yield at_most(("dome", name, score), off, "%", most)
    pressed = states[9]
    field = dome_forces(_THICK, pressed)
    radius = math.sqrt(lattice(_THICK).areas[field.contact].sum() / math.pi)
    off = abs(radius - math.sqrt(_THICK.radius * depth)) / _THICK.spacing
    yield at_most(("dome", "hertz", "radius"), off, "rings", 1)
    solid = _smooth_solid(0.5)
    end = simulate_contact(_THICK, solid, press, 2.5e-3, start=pressed, keep=1).end
    field = dome_forces(_THICK, end)
    a = (0.75 * field.total_normal * _THICK.radius / modulus) ** (1.0 / 3.0)
    full = 3.0 * math.pi / 16.0 * 0.5 * field.total_normal * a
    torsion = 100 * abs(field.torque((0.0, 0.0, 1.0)) / full - 1.0)
    yield at_most(("dome", "torsion", "full_slip"), torsion, "%", 2)
    yield at_most(
        ("dome", "limit_surface", "torsion"), 100 * abs(limit_margin(_THICK, solid, end)), "%", 0.1
    )
    shift = press_and_move(depth, shift=(0.11 * _MM, 0.0))
    run = simulate_contact(_THICK, solid, shift, 2.5e-3, start=pressed, keep=40)
    worst = 0.0
    for state in run.states:
        field = dome_forces(_THICK, state)
        share = field.total_friction / (0.5 * field.total_normal)
        if 0.2 < share < 0.97:
            friction = np.linalg.norm(field.friction, axis=1)
            sticks = field.contact & (friction < 0.995 * 0.5 * field.normal)
            c = math.sqrt(lattice(_THICK).areas[sticks].sum() / math.pi)
            worst = max(worst, abs(c - a * (1.0 - share) ** (1.0 / 3.0)) / _THICK.spacing)
    yield at_most(("dome", "cattaneo_mindlin", "stick_radius"), worst, "rings", 1)
    slid = Solid(shape=plane())
    both = press_and_move(0.6 * _MM, shift=(0.5 * _MM, 0.0), twist=0.5)
    state = simulate_contact(Dome(), slid, both, 2e-3, keep=1).end
    margin = limit_margin(Dome(), slid, state)
    yield within(("dome", "limit_surface", "shear_and_twist"), 100 * margin, "%", 0, 5)
    straight = press_and_move(0.6 * _MM, shift=(1.5 * _MM, 0.0))
    state = simulate_contact(Dome(), slid, straight, 2e-3, keep=1).end
    ends = abs(limit_margin(Dome(), slid, state) - dome_forces(Dome(), state).safety_margin(0.5))
    yield at_most(("dome", "limit_surface", "shear_alone"), 100 * ends, "%", 0.01)


def _orders(quick: bool) -> Iterator[Row]:
    motion = press_and_move(0.8 * _MM, shift=(0.6 * _MM, 0.0))
    forces = []
    for pitch in _PITCHES:
        dome = Dome(pitch=pitch, reach=math.radians(50.0))
        forces.append(simulate_contact(dome, Solid(shape=plane()), motion, 10e-3).total_forces[-1])
    fine = forces[-1]
    for pitch, force in zip(_PITCHES[:-1], forces[:-1], strict=True):
        error = 100 * float(np.linalg.norm(force - fine) / np.linalg.norm(fine))
        yield reported(("dome", f"pitch_{pitch * 1e3:.1f}mm", "force"), error, "%")
    slide = press_and_move(0.6 * _MM, shift=(1.0 * _MM, 0.0))
    lateral = [_last(Dome(), slide, dt)[0] for dt in (0.5e-3, 20e-3)]
    yield at_most(
        ("dome", "steps_200um", "friction"), 100 * abs(lateral[1] / lateral[0] - 1), "%", 1.5
    )
    times = np.array([0.0, 0.048, 0.192, 0.24])
    poses = np.zeros((4, 6))
    poses[1:, 2], poses[3, 0] = -0.5 * _MM, 0.2 * _MM
    viscous = Dome(relaxation=0.03)
    ends = {}
    for dt in (1e-3, 4e-3, 16e-3):
        run = simulate_contact(viscous, Solid(shape=plane()), Motion(times=times, poses=poses), dt)
        ends[dt] = run.total_forces[-1]
        rest = run.total_forces[(run.times > 0.16) & (run.times <= 0.192)]
        if dt == 1e-3:
            settled = simulate_contact(Dome(), Solid(shape=plane()), _held(), dt).total_forces[-40:]
            chatter = float(np.ptp(settled, axis=0).max())
            yield at_most(("dome", "at_rest", "chatter"), 1e3 * chatter, "mN", 0.1)
        elif len(rest):
            off = float(np.linalg.norm(ends[dt] - ends[1e-3]) / np.linalg.norm(ends[1e-3]))
            yield reported(("dome", f"viscous_{dt * 1e3:.0f}ms", "force"), 100 * off, "%")


def _held() -> Motion:
    poses = np.zeros((3, 6))
    poses[1:, 2], poses[1:, 0] = -0.5 * _MM, 0.1 * _MM
    return Motion(times=np.array([0.0, 0.05, 0.1]), poses=poses)


def _last(dome: Dome, motion: Motion, dt: float) -> Array:
    return simulate_contact(dome, Solid(shape=plane()), motion, dt, keep=1).total_forces[-1]


def _symmetry() -> Iterator[Row]:
    run = simulate_contact(
        Dome(), Solid(shape=plane()), press_and_move(0.5 * _MM, twist=0.3), 4e-3, keep=1
    )
    yield at_most(
        ("dome", "press_and_twist", "sideways"),
        float(abs(run.total_forces[:, :2]).max()),
        "N",
        1e-5,
    )
    straight, turned = [], []
    for angle in (0.0, 2.0 * math.pi / 3.0, 0.7):
        along = (0.2 * _MM * math.cos(angle), 0.2 * _MM * math.sin(angle))
        x, y, z = simulate_contact(
            Dome(),
            Solid(shape=ball(10 * _MM)),
            press_and_move(0.4 * _MM, shift=along),
            4e-3,
            keep=1,
        ).total_forces[-1]
        c, s = math.cos(angle), math.sin(angle)
        straight.append(np.array([c * x + s * y, c * y - s * x, z]))
        turned.append(
            float(np.linalg.norm(straight[-1] - straight[0]) / np.linalg.norm(straight[0]))
        )
    yield at_most(("dome", "turned_by_the_lattice", "force"), turned[1], "", 1e-5)
    yield at_most(("dome", "turned_anyhow", "force"), 100 * turned[2], "%", 1)


def _work(run: DomeRun, start: Array) -> tuple[float, float]:
    """Work on the dome of an object that does not turn, and the sum of its parts' sizes [J]."""
    forces = np.vstack([np.zeros(3), run.total_forces])
    places = np.vstack([start, run.places])
    parts = (0.5 * (forces[1:] + forces[:-1]) * np.diff(places, axis=0)).sum(axis=1)
    return float(parts.sum()), float(abs(parts).sum())


def _energy() -> Iterator[Row]:
    knots = np.zeros((5, 6))
    knots[1:4, 2], knots[2, 0] = -0.6 * _MM, 0.4 * _MM
    motion = Motion(times=np.linspace(0.0, 0.4, 5), poses=knots)
    for name, dome in (("linear", Dome(stiffening=False)), ("stiffening", Dome())):
        for friction in (0.5, 1e-9):
            run = simulate_contact(dome, Solid(shape=plane(), friction=friction), motion, 1e-3)
            start = np.array([0.0, 0.0, dome.radius])
            work, whole = _work(run, start)
            kind = "friction" if friction == 0.5 else "no_friction"
            made = 100 * max(0.0, -work) / whole
            yield at_most(("dome", f"loop_{name}_{kind}", "energy_made"), made, "%", 1)
            yield reported(("dome", f"loop_{name}_{kind}", "work"), 1e6 * work, "µJ")


def _robust(quick: bool) -> Iterator[Row]:
    shapes = (
        plane(), ball(5 * _MM), cylinder(4 * _MM), box(12 * _MM, 1.0 * _MM),
        capsule(3 * _MM, 14 * _MM), torus(6 * _MM, 2 * _MM), cone(5 * _MM, 8 * _MM, 1.0 * _MM),
    )  # fmt: skip
    rounds, steps, unconverged, halvings, out = 0, 0, 0, 0, 0.0
    for shape in shapes[:3] if quick else shapes:
        for stiffness in (1e9, 1e11):
            solid = Solid(shape=shape, stiffness=stiffness)
            motion = press_and_move(0.5 * _MM, shift=(1.0 * _MM, 0.4 * _MM), twist=0.4)
            run = simulate_contact(Dome(), solid, motion, 2e-3)
            rounds += int(run.rounds.sum())
            steps += len(run.times)
            unconverged += run.unconverged
            halvings += run.halvings
            out = max(out, *(over_cone(solid, state) for state in run.states))
    yield at_most(("dome", "primitives", "rounds"), rounds / steps, "", 6)
    yield at_most(("dome", "primitives", "unconverged"), 100 * unconverged / steps, "%", 0.1)
    yield reported(("dome", "primitives", "halvings"), 100 * halvings / steps, "%")
    yield at_most(("dome", "primitives", "out_of_cone"), out, "", 1e-9)


def over_cone(solid: Solid, state: DomeState) -> float:
    """Largest friction of a node over its cone, less one."""
    normal = np.einsum("ij,ij->i", state.forces, state.normals)
    friction = np.linalg.norm(state.friction, axis=1)
    on = normal > 0.0
    if not on.any():
        return 0.0
    return float((friction[on] / (solid.friction * normal[on])).max() - 1.0)
