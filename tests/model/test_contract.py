"""What every body does, whatever it is made of: a chain, the silicone of each design, two fingers.

A new design gets these tests by being shipped, a new kind of body by an entry in `KINDS`.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from itertools import pairwise
from typing import Any, NamedTuple, get_args

import numpy as np
import pytest

from chromagrip import model
from chromagrip.model.dome import displacements
from chromagrip.model.pinch import FACING, HandPath, Pinch, box_body, simulate_pinch
from chromagrip.model.shapes import ball, box, plane
from chromagrip.render import load_sensor, sensor_names
from chromagrip.scene.scene import Mechanics

MU = 0.5
#: Seconds between the knots of a drive, and a step: powers of two, whose sums are exact.
LEG, DT = 2.0**-3, 2.0**-5
#: Shift and press at the knots of a drive, LEG seconds apart, in units of the body.
Knots = tuple[tuple[float, float], ...]
REST: Knots = ((0.0, 0.0), (0.0, 0.0))
STICKS: Knots = ((0.0, 0.0), (0.0, 1.0), (0.05, 1.0), (0.05, 1.0))
SLIDES: Knots = ((0.0, 0.0), (0.0, 1.0), (2.0, 1.0))
MIRRORED: Knots = ((0.0, 0.0), (0.0, 1.0), (-2.0, 1.0))
LOOP: Knots = ((0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0))


class Grasp(NamedTuple):
    """What came of a drive."""

    force: np.ndarray  # on the body, along x and into it, after each step [N], (K, 2)
    fields: list[model.ForceField]  # truth at some of the steps, the last one included
    unbalanced: float  # what nothing holds at the end, as a share
    stiffness: float  # force into the body over the depth at the end [N/m]
    state: Any  # from which it would go on
    moved: float  # largest displacement of a node at the end [m]


def pressed_chain(knots: Knots, dt: float, stiffer: float, state: Any) -> Grasp:
    """The thesis's chain, both poses prescribed [0.6 mm, 0.3 mm]."""
    tip = model.Fingertip(nodes=51)
    tip = replace(tip, tissue_stiffness=stiffer * tip.tissue_stiffness)
    obj, times = model.ContactObject(friction=MU), LEG * np.arange(len(knots))
    shift, press = (np.array(knots) * [6e-4, 3e-4]).T
    control: Any = {"normal_control": "position", "lateral_control": "position"}
    drive = model.Drive(times=times, normal=press, lateral=shift, **control)
    left = times[-1] - (state.time if state else 0.0)
    run = model.simulate(tip, obj, drive, dt=dt / 16, duration=left, state=state)
    assert run.rate[1:, :-1] == pytest.approx(np.diff(run.nodes, axis=0) * 16 / dt, abs=1e-9)
    fields = [model.contact_forces(tip, obj, run.state(k)) for k in range(1, len(run))]
    force = np.array([[field.friction.sum(), field.normal.sum()] for field in fields])
    end, last = run.state(-1), fields[-1]
    on_nodes = np.column_stack([last.friction, -last.normal])
    springs = model.chain_forces(tip, end.deformation.seen)
    apart = abs(springs - on_nodes)[1:-1].max() / max(abs(on_nodes).max(), 1e-12)
    moved = abs(end.deformation.nodes).max()
    return Grasp(force, fields, apart, force[-1, 1] / max(press[-1], 1e-12), end, moved)


def pressed_silicone(
    knots: Knots, dt: float, stiffer: float, state: Any, *, body: model.SoftBody, turn: float = 0.0
) -> Grasp:
    """A plate on a dome, or a ball on a pad [3 % of the radius, 10 % of the layer]."""
    body = replace(body, young=stiffer * body.young)
    flat = body.kind == "pad"
    solid = model.Solid(shape=ball(body.radius) if flat else plane(), friction=MU)
    along, poses = np.array([math.cos(turn), math.sin(turn), 0.0]), np.zeros((len(knots), 6))
    shift, press = (0.1 * body.thickness if flat else 0.03 * body.radius) * np.array(knots).T
    poses[:, :3] = shift[:, None] * along - press[:, None] * [0.0, 0.0, 1.0]
    motion = model.Motion(times=LEG * np.arange(len(knots)), poses=poses)
    run = model.simulate_contact(body, solid, motion, dt, start=state, keep=4)
    assert run.unconverged == 0
    fields = [model.dome_forces(body, each, whole=False) for each in run.states]
    assert fields[-1].total_force == pytest.approx(run.total_forces[-1], abs=1e-12)
    force = run.total_forces @ np.column_stack([along, [0.0, 0.0, -1.0]])
    near, whole = run.end.near, displacements(body, run.end)
    apart, moved = abs(whole[near] - run.end.displacement[near]).max(initial=0.0), abs(whole).max()
    stiffness = force[-1, 1] / max(press[-1], 1e-12)
    return Grasp(force, fields, apart / max(moved, 1e-12), stiffness, run.end, moved)


def fingers(stiffer: float = 1.0, **changes: Any) -> Pinch:
    """Two fingertips and a box of 50 g."""
    finger = model.Dome(pitch=0.7e-3, reach=math.radians(45.0), young=stiffer * 0.4e6)
    size = (20e-3, 20e-3, 16e-3)
    its = {"first": finger, "second": finger, "body": box_body(0.05, size), **changes}
    return Pinch(solid=model.Solid(shape=box(size, 1e-3), friction=MU), **its)


def pinched(knots: Knots, dt: float, stiffer: float, state: Any) -> Grasp:
    """Two fingers on a box on a table, into which the hand moves [0.5 mm, 2 N]."""
    times, (shift, press) = LEG * np.arange(len(knots)), np.array(knots).T
    down = -1.0 if (shift < 0.0).any() else 1.0
    hand = HandPath(times=tuple(times), places=tuple((5e-4 * x, 0.0, 0.0) for x in shift))
    its = fingers(stiffer, hand=hand, gravity=(9.81 * down, 0.0, 0.0))
    grip = lambda time: 2.0 * float(np.interp(time, times, press))  # noqa: E731
    run = simulate_pinch(its, times[-1], grip, dt, state)
    fields = [model.dome_forces(its.first, each) for each in (run.end.first, run.end.second)]
    for field, found in zip(fields, run.forces[-1] * np.stack([np.ones(3), FACING]), strict=True):
        assert field.total_force == pytest.approx(found, abs=1e-12)
    force = np.column_stack([run.forces[:, :, 0].sum(axis=1), -run.forces[:, 0, 2]])
    weight = 0.05 * 9.81
    apart = abs(down * (weight - run.supports[-1]) - force[-1, 0]) / weight
    stiffness = force[-1, 1] / max(run.end.closing, 1e-12)
    moved = abs(displacements(its.first, run.end.first)).max()
    return Grasp(force, fields, float(apart), stiffness, run.end, moved)


#: Each silicone once, by the first of its designs.
SILICONE = {load_sensor(name).dome: name for name in reversed(sensor_names())}
SOFT = {name: partial(pressed_silicone, body=body) for body, name in SILICONE.items()}
KINDS: dict[str, dict[str, Callable[..., Grasp]]] = {
    "chain": {"chain": pressed_chain}, "dome": SOFT, "pinch": {"pinch": pinched}
}  # fmt: skip
BODIES = {name: drive for kind in KINDS.values() for name, drive in kind.items()}
#: One body after the other, as few tables of silicone are kept at a time.
every_body = pytest.mark.parametrize("name", BODIES, scope="module")


@cache
def grasp(name: str, knots: Knots, dt: float = DT, stiffer: float = 1.0) -> Grasp:
    return BODIES[name](knots, dt, stiffer, None)


def test_every_kind_of_body_is_here() -> None:
    assert set(KINDS) == set(get_args(Mechanics))


@every_body
def test_at_rest_nothing_pushes_and_nothing_moves(name: str) -> None:
    still = grasp(name, REST)
    assert abs(still.force).max() < 1e-9
    assert still.moved < 1e-12
    assert not any(field.contact.any() for field in still.fields)


@every_body
def test_what_the_object_pushes_with_is_what_the_body_carries(name: str) -> None:
    assert grasp(name, STICKS).unbalanced < 1e-2


@every_body
def test_friction_stays_in_the_cone_of_each_node(name: str) -> None:
    for knots in (STICKS, SLIDES):
        for field in grasp(name, knots).fields:
            assert (field.friction_sizes <= MU * field.normal * (1.0 + 1e-9) + 1e-12).all()
            assert (field.normal >= 0.0).all()


@every_body
def test_it_sticks_at_a_small_shear_and_slides_at_a_large_one(name: str) -> None:
    for field in grasp(name, STICKS).fields[-1:]:
        assert 0.0 < field.total_friction < 0.5 * MU * field.total_normal
    field = grasp(name, SLIDES).fields[-1]
    assert field.total_friction == pytest.approx(MU * field.total_normal, rel=0.01)
    ratio = field.friction_sizes[field.contact] / field.normal[field.contact]
    assert ratio == pytest.approx(MU, rel=0.01)


@every_body
def test_a_mirrored_drive_mirrors_what_comes_of_it(name: str) -> None:
    right, left = grasp(name, SLIDES).force, grasp(name, MIRRORED).force
    error = (1e-9 if name == "chain" else 0.01) * abs(right).max()
    assert left * [-1.0, 1.0] == pytest.approx(right, abs=error)


@pytest.mark.parametrize("name", SOFT, scope="module")
def test_a_drive_that_is_turned_turns_what_comes_of_it(name: str) -> None:
    """By a third of a turn, which maps the nodes on themselves."""
    straight = grasp(name, SLIDES).force
    turned = BODIES[name](SLIDES, DT, 1.0, None, turn=2.0 * math.pi / 3.0).force
    assert turned == pytest.approx(straight, abs=1e-4 * abs(straight).max())


@every_body
def test_half_the_step_changes_little(name: str) -> None:
    whole, half = (grasp(name, STICKS, dt).force[-1] for dt in (DT, 0.5 * DT))
    most = 5e-3 if name in SOFT else 1e-3
    assert half == pytest.approx(whole, abs=most * abs(whole).max())


@pytest.mark.parametrize("name", ["chromatouch-next", "dome-2020"], scope="module")
def test_shorter_steps_converge(name: str) -> None:
    ends = [grasp(name, STICKS, dt).force[-1] for dt in (DT, 0.5 * DT, 0.25 * DT)]
    changes = [abs(later - first).max() for first, later in pairwise(ends)]
    assert changes[1] < 0.6 * changes[0]


def state_bytes(state: Any) -> bytes:
    """Of all that a state holds, but for its time."""
    if isinstance(state, np.ndarray):
        return state.tobytes()
    names = [name for name in getattr(state, "__dataclass_fields__", ()) if name != "time"]
    inner = b"".join(state_bytes(getattr(state, name)) for name in names)
    return inner if names else repr(state).encode()


@every_body
def test_a_drive_that_goes_on_from_its_middle_ends_in_the_same_bytes(name: str) -> None:
    drive, whole = BODIES[name], grasp(name, STICKS)
    half = drive(STICKS[:2], DT, 1.0, None)
    rest = drive(STICKS, DT, 1.0, half.state)
    assert state_bytes(rest.state) == state_bytes(whole.state)
    assert len(rest.force) < len(whole.force)


@every_body
def test_a_stiffer_body_needs_a_larger_force(name: str) -> None:
    soft, hard = (grasp(name, STICKS, stiffer=by).stiffness for by in (1.0, 1.5))
    assert 1.1 * soft < hard < 1.5 * soft * (1.0 + 1e-3)


@pytest.mark.parametrize("name", ["chain", *SOFT], scope="module")
def test_a_closed_loop_costs_work(name: str) -> None:
    """Press, shift, back and lift: friction takes, nothing gives, and nothing is left."""
    force = np.vstack([np.zeros(2), grasp(name, LOOP).force])
    drive = np.array(LOOP)
    steps = np.linspace(0.0, len(LOOP) - 1.0, len(force))
    place = np.column_stack([np.interp(steps, np.arange(len(LOOP)), each) for each in drive.T])
    work = (0.5 * (force[1:] + force[:-1]) * np.diff(place, axis=0)).sum()
    assert 0.0 < work < 2.0 * MU * force[:, 1].max()
    assert abs(force[-1]).max() < 1e-3 * abs(force).max()


def test_a_pinched_body_that_is_kicked_gains_no_energy() -> None:
    held, kick = grasp("pinch", STICKS[:2]).state, np.array([0.0, 2e-3, 0.0])
    moving = replace(held.moving, momentum=kick, momentum_before=kick)
    its = fingers(table=False, gravity=(0.0, 0.0, 0.0))
    start = replace(held, moving=moving, support=0.0)
    run = simulate_pinch(its, 0.3, lambda time: 2.0, 5e-3, start)
    momentum = np.linalg.norm([each.momentum for each in run.moving], axis=1)
    assert momentum.max() <= 2e-3 * (1.0 + 1e-6)
    assert momentum[-5:].max() < 1e-3
    assert abs(run.places[:, 1]).max() > 1e-5
