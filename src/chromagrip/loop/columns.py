"""Table of the columns of a trace.

Lines of traces, schemas of Parquet files, panels of reports, topics of logs and
docs/file-formats.md are made from it.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from ..model import margin_within, pressure
from ..scene.fingers import build_pinch
from ..scene.scene import Mechanics, Scene
from ..tracking import Z90
from .column import (
    ONE,
    OUTCOMES,
    SOFT,
    TWO,
    Column,
    Held,
    Line,
    deviation,
    estimate,
    estimated,
    held,
    read,
    true,
    true_wrench,
    visible,
    wrench_columns,
)
from .sample import Sample

Array = NDArray[np.float64]

#: Names of two fingers; the names of their columns begin with `first_` or `second_`.
FINGERS = ("first", "second")
#: Beginnings of the names of each finger's columns.
PREFIXES: dict[Mechanics, tuple[str, ...]] = {
    "chain": ("",),
    "dome": ("",),
    "pinch": tuple(f"{finger}_" for finger in FINGERS),
}

#: Columns of the frame as a whole.
WHOLE = (
    Column("time_s", "time of the frame", lambda line: line.sample.time),
    Column(
        "load_n",
        "lateral load",
        lambda line: line.sample.load,
        "/load_n/lateral",
        ONE,
    ),
    Column(
        "grip_n",
        "commanded grip force of each finger",
        lambda line: line.sample.grip,
        "/grip_n/commanded",
    ),
    Column(
        "applied_n",
        "force of the gripper's drive",
        lambda line: line.sample.applied,
        "/grip_n/applied",
    ),
    held(
        "table_n",
        "force of the table",
        lambda h: h.now.state.support,
        "/load_n/table",
    ),
    Column(
        "smaller_finger",
        "finger observed by the controller, 1 or 2",
        lambda line: line.sample.smaller + 1.0,
        bodies=TWO,
    ),
    held(
        "mass_g",
        "mass with added mass",
        lambda h: 1e3 * h.mass,
        "/mass_g/object",
    ),
    held(
        "object_x_mm",
        "object's x in the hand",
        lambda h: 1e3 * h.now.fingers[0].place[0],
    ),
    held(
        "object_y_mm",
        "object's y in the hand",
        lambda h: 1e3 * h.now.fingers[0].place[1],
    ),
    held(
        "object_z_mm",
        "object's z in the hand",
        lambda h: 1e3 * (h.now.state.closing - h.now.fingers[0].indentation),
    ),
    held(
        "height_mm",
        "rise of the centre of mass",
        lambda h: 1e3 * h.rise,
        "/height_mm/object",
    ),
    held("closing_mm", "closing distance of each finger", lambda h: 1e3 * h.now.state.closing),
    held(
        "slide_mm",
        "slide across z, without elastic motion",
        lambda h: 1e3 * h.now.record.slide,
        "/slide_mm/in_hand",
    ),
    held(
        "turn_deg",
        "turn about z, without elastic twist",
        lambda h: math.degrees(h.now.record.turn),
        "/turn_deg/in_hand",
    ),
    held(
        "elastic_deg",
        "mean elastic twist of both skins",
        lambda h: math.degrees(h.now.record.elastic),
        "/turn_deg/elastic",
    ),
    held(
        "pressure_kpa",
        "larger mean pressure of both contacts",
        lambda h: 1e-3 * h.now.record.pressure,
        "/pressure_kpa/true",
    ),
    held(
        "outcome",
        "worst outcome so far: 0 held, 1 turned, 2 crushed, 3 dropped",
        lambda h: float(h.outcome),
    ),
)
#: Columns of each finger, in the order of a trace.
EACH = (
    Column("normal_true_n", "true ΣFn", true(lambda c: c.field.total_normal), "/normal_n/true"),
    Column(
        "friction_true_n", "true ΣFf", true(lambda c: c.field.total_friction), "/friction_n/true"
    ),
    Column("mu_true", "true µ, Σµᵢ·Fn,i/ΣFn", true(lambda c: c.friction), "/mu/true"),
    Column(
        "margin_true",
        "true Γ; NaN without contact",
        true(lambda c: c.field.safety_margin(c.friction)),
        "/margin/true",
    ),
    Column(
        "normal_estimated_n",
        "estimated ΣFn",
        estimated(lambda o: o.field.total_normal),
        "/normal_n/estimated",
    ),
    Column(
        "friction_estimated_n",
        "estimated ΣFf",
        estimated(lambda o: o.field.total_friction),
        "/friction_n/estimated",
    ),
    Column(
        "normal_deviation_n",
        "standard deviation of the estimated ΣFn",
        read(lambda o: deviation(o, 0)),
    ),
    Column(
        "friction_deviation_n",
        "standard deviation of the estimated ΣFf",
        read(lambda o: deviation(o, 1)),
    ),
    *estimate("mu", "µ", lambda o: o.friction, lambda o: o.friction_interval),
    *estimate("margin", "Γ", lambda o: o.margin, lambda o: o.margin_interval),
    Column(
        "pressure_n_per_m",
        "ΣFn over the contact's width",
        true(lambda c: pressure(c.field)),
        "/pressure_n_per_m/true",
        ONE,
    ),
    Column(
        "pressure_pitch_n_per_m",
        "ΣFn over the width plus one node pitch",
        true(lambda c: pressure(c.field, c.pitch)),
        bodies=ONE,
    ),
    Column(
        "lateral_displacement_mm",
        "largest slip so far",
        true(lambda c: c.slip.lateral_displacement * 1e3),
        "/slip_mm/lateral_displacement",
    ),
    Column(
        "rigid_slip_mm",
        "summed sliding of the whole contact",
        true(lambda c: c.slip.rigid_slip * 1e3),
        "/slip_mm/rigid_slip",
    ),
    Column("object_mm", "object position along x", true(lambda c: c.place[0] * 1e3), bodies=ONE),
    Column(
        "rigid_part_mm",
        "indentation",
        true(lambda c: c.indentation * 1e3),
        bodies=ONE,
    ),
    Column("contact_nodes", "nodes in contact", true(lambda c: float(c.field.contact.sum()))),
    Column(
        "markers_visible",
        "tracked marker pairs",
        visible,
        "/markers/visible",
    ),
    Column(
        "object_y_mm",
        "object position along y; 0 on a chain",
        true(lambda c: c.place[1] * 1e3),
        bodies=ONE,
    ),
    Column(
        "object_turn_deg",
        "object turn about z; 0 on a chain",
        true(lambda c: math.degrees(c.turn)),
        bodies=ONE,
    ),
    Column(
        "limit_margin_true",
        "true margin with torsion",
        true(lambda c: margin_within(c.field, c.friction)),
        "/limit_margin/true",
    ),
    *estimate(
        "limit_margin",
        "margin with torsion",
        lambda o: o.limit_margin,
        lambda o: o.limit_margin_interval,
        SOFT,
    ),
    *wrench_columns("true", "true force", true, true_wrench),
    *wrench_columns("estimated", "estimated force", read, lambda o: np.append(o.force, o.torque)),
    *wrench_columns(
        "deviation",
        "standard deviation of force",
        read,
        lambda o: np.append(o.force_deviation, o.torque_deviation),
    ),
)


def prefixes(scene: Scene) -> tuple[str, ...]:
    """Beginnings of the names of each finger's columns."""
    return PREFIXES[scene.mechanics]


def columns_of(body: Mechanics) -> dict[str, Column]:
    """Columns of a written trace of these mechanics, by full name."""
    return {name: column for name, _, column in _placed(body)}


def _placed(body: Mechanics) -> Iterator[tuple[str, int, Column]]:
    """List full name, finger and column of each value of a line."""
    yield from ((column.name, 0, column) for column in WHOLE if body in column.bodies)
    for k, before in enumerate(PREFIXES[body]):
        yield from ((before + c.name, k, c) for c in EACH if body in c.bodies)


#: Columns of one finger's trace in memory, in order, with their meaning.
COLUMNS = {name: column.meaning for name, column in columns_of("dome").items()}


class Rows:
    """Lines of the trace of a scene, one for each frame.

    Parameters
    ----------
    scene: scene that is run

    Attributes
    ----------
    columns: names and meanings of the values of a line
    names: names of the columns that are written; a chain has no third dimension
    """

    def __init__(self, scene: Scene) -> None:
        body = scene.mechanics
        placed = list(_placed(_IN_MEMORY[body]))
        self.columns = {name: column.meaning for name, _, column in placed}
        # On the camera path a method for domes may read a chain's pictures.
        self._values = [
            (k, column.value if body in column.bodies or scene.path == "camera" else _unknown)
            for _, k, column in placed
        ]
        self.names = tuple(columns_of(body))
        self._held = _HELD[body](scene)

    def line(self, sample: Sample) -> tuple[float, ...]:
        """Values of a frame, in the order of `columns`; call it first with the first frame."""
        held = self._held(sample)
        lines = [Line(sample=sample, finger=k, held=held) for k, _ in enumerate(sample.readings)]
        return tuple(value(lines[finger]) for finger, value in self._values)


class _Object:
    """Object of two fingers, frame after frame; its rise is counted from the first frame."""

    def __init__(self, scene: Scene) -> None:
        self._pinch, self._limits = build_pinch(scene), scene.pinch.limits
        self._start = math.nan

    def at(self, sample: Sample) -> Held:
        """Both fingers and their object at a frame."""
        now = sample.pinch
        height = -float(self._pinch.down @ now.state.moving.place)
        self._start = height if math.isnan(self._start) else self._start
        return Held(
            now=now,
            mass=self._pinch.body_at(sample.time).mass,
            rise=height - self._start,
            outcome=OUTCOMES.index(now.record.outcome(self._limits)),
        )


def _not_held(sample: Sample) -> None:
    """Return None: one finger does not hold its object."""


#: Makes the function of a sample that gives both fingers and their object.
_HELD: dict[Mechanics, Callable[[Scene], Callable[[Sample], Held | None]]] = {
    "chain": lambda scene: _not_held,
    "dome": lambda scene: _not_held,
    "pinch": lambda scene: _Object(scene).at,
}
#: Mechanics whose columns a trace has in memory: a method for domes may read a chain's pictures.
_IN_MEMORY: dict[Mechanics, Mechanics] = {"chain": "dome", "dome": "dome", "pinch": "pinch"}


def _unknown(line: Line) -> float:
    """Return NaN for a column that the body lacks."""
    return math.nan


def values_of(sample: Sample, names: Iterable[str], finger: int = 0) -> dict[str, float]:
    """Values of some columns of a frame, for one finger."""
    table, line = columns_of("dome"), Line(sample=sample, finger=finger)
    return {name: table[name].value(line) for name in names}


def interval_of(of: Mapping[str, Array], name: str) -> tuple[Array, Array] | None:
    """Ends of the 90 % interval of an estimate; None if the trace has no interval.

    Parameters
    ----------
    of: columns of the trace, shape (T,) each
    name: column of the estimate
    """
    if "_estimated" not in name:
        return None
    low, high, deviation = (
        of.get(name.replace("_estimated", f"_{part}")) for part in ("low", "high", "deviation")
    )
    if low is not None and high is not None:
        return low, high
    if deviation is not None:
        return of[name] - Z90 * deviation, of[name] + Z90 * deviation
    return None
