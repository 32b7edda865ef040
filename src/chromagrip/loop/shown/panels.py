"""Panels of curves of a run, as its report and its figure show them."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model import GROSS_SLIP
from ...output.run_page import Curve, Panel, Role
from ...scene.scene import Scene
from ..column import ALL, ONE, Mechanics
from ..columns import FINGERS, columns_of, interval_of, mechanics
from ..trace import may_slide, word_for_read

Array = NDArray[np.float64]
Columns = Mapping[str, Array]

#: Title of the panels of margins.
MARGIN = "safety margin Γ"


@dataclass(frozen=True, kw_only=True)
class _Shown:
    """A column of a trace as a curve.

    Attributes
    ----------
    column: without the name of a finger
    label: in the legend; {} is the word for what the controller reads
    second: drawn in the second style of its role
    steps: whether each value holds until the next instant
    role: see `Role`; by default that of a column's name
    """

    column: str
    label: str
    second: bool = False
    steps: bool = False
    role: Role | None = None


@dataclass(frozen=True, kw_only=True)
class _Plan:
    """A panel of a run, or of each finger; attributes as of `Panel`, `bodies` as of `Column`."""

    title: str
    curves: tuple[_Shown, ...]
    levels: tuple[tuple[str, float], ...] = ()
    span: tuple[float, float] = (0.0, 0.0)
    limits: tuple[float, float] = (-math.inf, math.inf)
    bodies: tuple[Mechanics, ...] = ALL


_PLANS = (
    _Plan(
        title=MARGIN,
        curves=(
            _Shown(column="margin_true", label="true"),
            _Shown(column="margin_estimated", label="{}"),
            _Shown(column="limit_margin_true", label="with torsion, true", second=True),
            _Shown(column="limit_margin_estimated", label="with torsion, {}", second=True),
        ),
        span=(0.0, 1.0),
        limits=(-0.2, 1.05),
    ),
    _Plan(
        title="contact forces [N]",
        curves=(
            _Shown(column="normal_true_n", label="ΣFn true"),
            _Shown(column="normal_estimated_n", label="ΣFn {}"),
            _Shown(column="friction_true_n", label="ΣFf true", second=True),
            _Shown(column="friction_estimated_n", label="ΣFf {}", second=True),
        ),
    ),
    _Plan(
        title="grip and load [N]",
        curves=(
            _Shown(column="grip_n", label="grip commanded", steps=True, role="commanded"),
            _Shown(column="applied_n", label="grip applied", second=True, role="commanded"),
            _Shown(column="load_n", label="load", steps=True, role="other"),
            _Shown(column="table_n", label="force of the table", role="other"),
        ),
    ),
    _Plan(
        title="friction coefficient µ",
        curves=(
            _Shown(column="mu_true", label="true"),
            _Shown(column="mu_estimated", label="{}"),
        ),
        limits=(0.0, 2.0),
    ),
    _Plan(
        title="slip of the object [mm], true",
        curves=(
            _Shown(column="lateral_displacement_mm", label="lateral displacement"),
            _Shown(column="rigid_slip_mm", label="rigid slip", second=True),
        ),
        levels=((f"gross slip {1e3 * GROSS_SLIP:g}", 1e3 * GROSS_SLIP),),
        bodies=ONE,
    ),
    _Plan(
        title="slide of the object [mm], true",
        curves=(_Shown(column="slide_mm", label="in the hand"),),
    ),
    _Plan(
        title="turn of the object [°], true",
        curves=(
            _Shown(column="turn_deg", label="in the hand"),
            _Shown(column="elastic_deg", label="elastic twist", second=True),
        ),
        span=(-1.0, 1.0),  # a smaller turn is the solver's noise
    ),
    _Plan(
        title="pressure [N/m], true",
        curves=(
            _Shown(column="pressure_n_per_m", label="over the outermost nodes"),
            _Shown(column="pressure_pitch_n_per_m", label="plus one node pitch", second=True),
        ),
    ),
    _Plan(
        title="mean pressure [kPa], true",
        curves=(_Shown(column="pressure_kpa", label="of the contact pressed more"),),
    ),
    _Plan(
        title="torque about the axis [N mm]",
        curves=(
            _Shown(column="torque_true_nmm", label="true"),
            _Shown(column="torque_estimated_nmm", label="{}"),
        ),
    ),
)


def panels_of(scene: Scene, of: Columns) -> Iterator[Panel]:
    """Panels of a run, without curves that have no value.

    Two fingers share a panel of one true value and its estimate, and have a panel each otherwise.

    Parameters
    ----------
    scene: that was run
    of: columns of its trace; a trace of an earlier version lacks some
    """
    body = mechanics(scene)
    for plan in _PLANS:
        if body not in plan.bodies:
            continue
        if body != "pinch" or plan.curves[0].column in columns_of(body):
            yield from _panel(scene, of, plan, [""])
        elif any(curve.second for curve in plan.curves):
            for finger in FINGERS:
                yield from _panel(scene, of, plan, [finger])
        else:
            yield from _panel(scene, of, plan, FINGERS)


def _panel(
    scene: Scene, of: Columns, plan: _Plan, fingers: tuple[str, ...] | list[str]
) -> Iterator[Panel]:
    """Panel of these fingers; none without curves."""
    read = word_for_read(scene.path)
    curves = [
        curve
        for finger in fingers
        for shown in plan.curves
        for curve in _curve(of, shown, finger, read, len(fingers) > 1)
    ]
    if not curves:
        return
    levels, title = list(plan.levels), plan.title
    if plan.title == MARGIN:
        curves += _doubt(scene, of, fingers[0], plan.limits[1])
        if scene.target_margin is not None:
            levels.append((f"target {scene.target_margin:g}", scene.target_margin))
    if len(fingers) == 1 and fingers[0]:
        title = f"{title}, {fingers[0]} finger"
    yield Panel(title=title, curves=curves, levels=levels, span=plan.span, limits=plan.limits)


def _curve(of: Columns, shown: _Shown, finger: str, read: str, shared: bool) -> Iterator[Curve]:
    """Curve of a finger's column; none if it has no value."""
    name = f"{finger}_{shown.column}" if finger else shown.column
    if name not in of or not np.isfinite(of[name]).any():
        return
    low, high = interval_of(of, name) or (None, None)
    label = shown.label.format(read)
    yield Curve(
        label=f"{finger} finger, {label}" if shared else label,
        values=of[name],
        role=shown.role or ("estimated" if "_estimated" in name else "true"),
        second=(shared and finger == FINGERS[1]) or shown.second,
        steps=shown.steps,
        low=low,
        high=high,
    )


def _doubt(scene: Scene, of: Columns, finger: str, top: float) -> Iterator[Curve]:
    """Times at which sliding was possible, shaded up to the top of the panel."""
    possible = may_slide(scene, of, f"{finger}_" if finger else "")
    if scene.sliding_margin is not None and possible.any():
        bottom = np.where(possible, scene.sliding_margin, np.nan)
        yield Curve(
            label="sliding possible, the grip is held or raised",
            values=bottom,
            role="other",
            low=bottom,
            high=np.where(possible, top, np.nan),
        )
