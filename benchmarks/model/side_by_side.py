"""Chain and dome under the same grips and loads: what agrees, and what cannot.

Each body is pressed against a flat object and against a ball, which the chain sees as a circle, and
then pulled sideways until nearly all of the contact slides. Both objects have the same stiffness
per area and the same friction.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from chromagrip.model import (
    ContactObject,
    Dome,
    DomeState,
    Fingertip,
    Motion,
    Solid,
    State,
    contact_forces,
    dome_forces,
    equilibrium,
    simulate_contact,
)
from chromagrip.model.dome import lattice
from chromagrip.model.shapes import ball, plane
from chromagrip.output.report import Row, Table, at_most, number, reported

Array = NDArray[np.float64]

#: Grip, and the share of what friction holds up to which the load goes.
GRIP, FRICTION, MOST = 3.0, 0.5, 0.92
#: Share of what friction holds at which both bodies are compared.
COMPARED = 0.6
#: Radius of each object [m].
OBJECTS = {"flat": math.inf, "ball": 20e-3}
#: Steps of the grip and of the load.
STEPS = 40
#: A node slides from this share of its limit on.
SLIDES = 0.99
#: Forces from which a power of the depth is fitted; below, a contact is a few nodes wide [N].
FITTED = 0.3
#: Time in which a dome is pressed, and damper of the object, which carries a 1e-4th of the load.
_SECONDS, _DRAG = 0.2, 0.1


class Press(NamedTuple):
    """A body under a rising grip.

    Attributes
    ----------
    force: ΣFn [N], shape (K,)
    depth: by which body and object approach each other [m], shape (K,)
    half_width: of the contact in the plane of the load [m], shape (K,)
    strip: depth of the strip that carries ΣFn by the pressure along the meridian [m], shape (K,)
    """

    force: Array
    depth: Array
    half_width: Array
    strip: Array


class Pull(NamedTuple):
    """A body under a grip and a rising load.

    Attributes
    ----------
    share: load over µ times grip, shape (K,)
    normal, friction: ΣFn and ΣFf [N], shape (K,)
    margin: Γ, shape (K,)
    sliding: share of the contact's width that slides, shape (K,)
    """

    share: Array
    normal: Array
    friction: Array
    margin: Array
    sliding: Array


class Side(NamedTuple):
    """One body and one object."""

    body: str
    object: str
    press: Press
    pull: Pull


def side_by_side(quick: bool) -> list[Side]:
    """Both bodies with both objects.

    Parameters
    ----------
    quick: whether the dome has a coarser pitch
    """
    sides = []
    for name, radius in OBJECTS.items():
        for body, run in (("chain", _chain), ("dome", partial(_dome, quick))):
            sides.append(Side(body, name, *run(radius)))
    return sides


def _chain(radius: float) -> tuple[Press, Pull]:
    tip = Fingertip()
    obj = ContactObject(curvature=1.0 / radius, friction=FRICTION)
    state: State | None = None
    press, pull = [], []
    for share in np.arange(1, STEPS + 1) / STEPS:
        state = equilibrium(tip, obj, GRIP * share, state=state, parts=1)
        field = contact_forces(tip, obj, state)
        x = field.position[:, 0]
        on = field.normal > 0.0
        width = sum(_edge(side * x, field.normal, tip.pitch) for side in (1.0, -1.0))
        strip = math.pi * (abs(x[on]) @ field.normal[on]) / field.normal[on].sum()
        press.append((field.normal.sum(), state.deformation.rigid_part, width / 2.0, strip))
    for share in MOST * np.arange(STEPS + 1) / STEPS:
        state = equilibrium(tip, obj, GRIP, FRICTION * GRIP * share, state=state)
        field = contact_forces(tip, obj, state)
        slides = field.contact & (abs(field.friction) > SLIDES * FRICTION * field.normal)
        sliding = tip.shares()[slides].sum() / tip.shares()[field.contact].sum()
        sums = field.total_normal, field.total_friction, field.safety_margin(FRICTION)
        pull.append((share, *sums, sliding))
    return Press(*np.array(press).T), Pull(*np.array(pull).T)


def _dome(quick: bool, radius: float) -> tuple[Press, Pull]:
    dome = Dome(pitch=0.4e-3 if quick else 0.28e-3, reach=math.radians(50.0))
    solid = Solid(shape=plane() if radius == math.inf else ball(radius), friction=FRICTION)
    loads = np.zeros((3, 6))
    loads[1:, 2], loads[2, 0] = -GRIP, FRICTION * GRIP * MOST
    motion = Motion(
        times=np.array([0.0, _SECONDS, 2.0 * _SECONDS]),
        poses=np.zeros((3, 6)),
        free=("x", "z"),
        loads=loads,
        drag=(_DRAG, 0.0, _DRAG, 0.0, 0.0, 0.0),
    )
    states = simulate_contact(dome, solid, motion, _SECONDS / STEPS, keep=2 * STEPS).states
    height = dome.radius + (0.0 if radius == math.inf else radius)
    press = [_pressed(dome, state, height) for state in states[:STEPS]]
    pull = [_pulled(dome, state, motion) for state in states[STEPS - 1 :]]
    return Press(*np.array(press).T), Pull(*np.array(pull).T)


def _pressed(dome: Dome, state: DomeState, height: float) -> tuple[float, float, float, float]:
    nodes = lattice(dome)
    field = dome_forces(dome, state)
    counts = np.bincount(nodes.ring)
    rings = np.bincount(nodes.ring, np.hypot(field.position[:, 0], field.position[:, 1])) / counts
    pressure = np.bincount(nodes.ring, field.normal) / np.bincount(nodes.ring, nodes.areas)
    along = 2.0 * pressure.sum() * dome.spacing  # rings are a spacing apart
    radius = _edge(rings, pressure, dome.spacing)
    return field.total_normal, height - state.place[2], radius, field.total_normal / along


def _pulled(
    dome: Dome, state: DomeState, motion: Motion
) -> tuple[float, float, float, float, float]:
    areas = lattice(dome).areas
    field = dome_forces(dome, state)
    friction = np.linalg.norm(field.friction, axis=1)
    sticks = field.contact & (friction <= SLIDES * FRICTION * field.normal)
    sliding = 1.0 - math.sqrt(areas[sticks].sum() / areas[field.contact].sum())
    share = motion.load_at(state.time)[0] / (FRICTION * GRIP)
    margin = field.safety_margin(FRICTION)
    return share, field.total_normal, field.total_friction, margin, sliding


def _edge(place: Array, force: Array, pitch: float) -> float:
    """Where a pressure ends: beyond its last node, which would count in whole pitches."""
    order = np.argsort(place)
    place, force = place[order], force[order]
    last = int(np.flatnonzero(force)[-1])
    fall = force[last - 1] - force[last]
    beyond = pitch if fall <= 0.0 else force[last] / fall * (place[last] - place[last - 1])
    return float(place[last] + min(beyond, pitch))


def _power(press: Press) -> float:
    """Power of the depth with which ΣFn grows."""
    far = press.force >= FITTED
    return float(np.polyfit(np.log(press.depth[far]), np.log(press.force[far]), 1)[0])


def _off_rule(press: Press) -> float:
    """Largest deviation of `strip` from 3π/8 of the half width, as a share."""
    far = press.force >= FITTED
    rule = 3.0 * math.pi / 8.0 * press.half_width[far]
    return float(abs(press.strip[far] / rule - 1.0).max())


def _at(pull: Pull, values: Array) -> float:
    return float(np.interp(COMPARED, pull.share, values))


def side_rows(sides: list[Side]) -> list[Row]:
    """Figures of both bodies; with a target what equilibrium demands of a flat contact."""
    rows = []
    for name in OBJECTS:
        most, apart = (0.2, 0.005) if name == "flat" else (math.inf, math.inf)
        chain, dome = (side for side in sides if side.object == name)
        for score in ("normal", "friction"):
            one, other = (_at(s.pull, getattr(s.pull, score)) for s in (chain, dome))
            off = 100.0 * abs(other / one - 1.0)
            rows.append(at_most(("bodies", name, "difference", score), off, "%", most))
        margins = (np.interp(chain.pull.share, s.pull.share, s.pull.margin) for s in (chain, dome))
        off = float(abs(np.subtract(*margins)).max())
        rows.append(at_most(("bodies", name, "difference", "margin"), off, "", apart))
        for side in (chain, dome):
            press, pull = side.press, side.pull
            figures = (
                ("depth", 1e3 * press.depth[-1], "mm"),
                ("half_width", 1e3 * press.half_width[-1], "mm"),
                ("sliding", 100.0 * _at(pull, pull.sliding), "%"),
                ("power_of_the_depth", _power(press), ""),
                ("off_the_rule", 100.0 * _off_rule(press), "%"),
                ("strip_at_light_grip", 1e3 * np.interp(FITTED, press.force, press.strip), "mm"),
                ("strip", 1e3 * press.strip[-1], "mm"),
            )
            rows += [reported(("bodies", name, side.body, key), *rest) for key, *rest in figures]
    return rows


def side_table(sides: list[Side]) -> Table:
    """The same for a page: a column for each object and body."""
    lines: list[tuple[str, Callable[[Side], float], str]] = [
        ("ΣFn under grip and load [N]", lambda s: _at(s.pull, s.pull.normal), ".3f"),
        ("ΣFf under grip and load [N]", lambda s: _at(s.pull, s.pull.friction), ".3f"),
        ("Γ under grip and load", lambda s: _at(s.pull, s.pull.margin), ".3f"),
        ("share of the width that slides [%]", lambda s: 100 * _at(s.pull, s.pull.sliding), ".0f"),
        ("depth under the grip alone [mm]", lambda s: 1e3 * s.press.depth[-1], ".2f"),
        ("half width under the grip alone [mm]", lambda s: 1e3 * s.press.half_width[-1], ".2f"),
        ("ΣFn grows with the depth to the power of", lambda s: _power(s.press), ".2f"),
        (
            f"depth d of a strip that carries the same at {FITTED:g} N [mm]",
            lambda s: 1e3 * float(np.interp(FITTED, s.press.force, s.press.strip)),
            ".2f",
        ),
        (
            f"the same at {GRIP:g} N [mm]",
            lambda s: 1e3 * s.press.strip[-1],
            ".2f",
        ),
        ("largest distance of d from 3πa/8 [%]", lambda s: 100 * _off_rule(s.press), ".0f"),
    ]
    return Table(
        ("", *(f"{side.body}, {side.object}" for side in sides)),
        tuple((name, *(number(value(s), form) for s in sides)) for name, value, form in lines),
    )
