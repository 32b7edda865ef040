"""Panels of a run's curves, for its report and its figure."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model import GROSS_SLIP
from ...output.run_page import Curve, Panel, Role
from ...scene.scene import Mechanics, Scene
from ..column import ALL, ONE
from ..columns import columns_of, interval_of, prefixes
from ..trace import may_slide, word_for_read

Array = NDArray[np.float64]
Columns = Mapping[str, Array]

#: Title of the panels of margins.
MARGIN = "safety margin Γ"


@dataclass(frozen=True)
class _Shown:
    """A column of a trace as a curve.

    Attributes
    ----------
    column: name of the column, without that of a finger
    label: label in the legend; {} is the word for the controller's values
    second: whether the curve has the second style of its role
    role: role of the curve, see `Role`
    steps: whether each value holds until the next instant
    """

    column: str
    label: str
    second: bool = False
    role: Role = "true"
    steps: bool = False


@dataclass(frozen=True, kw_only=True)
class _Plan:
    """A panel of a run, or of each finger; attributes as of `Panel`, `bodies` as of `Column`."""

    title: str
    curves: tuple[_Shown, ...]
    levels: tuple[tuple[str, float], ...] = ()
    span: tuple[float, float] = (0.0, 0.0)
    limits: tuple[float, float] = (-math.inf, math.inf)
    bodies: tuple[Mechanics, ...] = ALL


def _both(column: str, label: str = "", second: bool = False) -> tuple[_Shown, _Shown]:
    """Curves of a true value and its estimate; {} in the column's name stands for the kind."""
    return (
        _Shown(column.format("true"), f"{label}true", second),
        _Shown(column.format("estimated"), f"{label}{{}}", second, "estimated"),
    )


_PLANS = (
    _Plan(
        title=MARGIN,
        curves=(*_both("margin_{}"), *_both("limit_margin_{}", "with torsion, ", True)),
        span=(0.0, 1.0),
        limits=(-0.2, 1.05),
    ),
    _Plan(
        title="contact forces [N]",
        curves=(*_both("normal_{}_n", "ΣFn "), *_both("friction_{}_n", "ΣFf ", True)),
    ),
    _Plan(
        title="grip and load [N]",
        curves=(
            _Shown("grip_n", "grip commanded", role="commanded", steps=True),
            _Shown("applied_n", "grip applied", second=True, role="commanded"),
            _Shown("load_n", "load", role="other", steps=True),
            _Shown("table_n", "force of the table", role="other"),
        ),
    ),
    _Plan(title="friction coefficient µ", curves=_both("mu_{}"), limits=(0.0, 2.0)),
    _Plan(
        title="slip of the object [mm], true",
        curves=(
            _Shown("lateral_displacement_mm", "lateral displacement"),
            _Shown("rigid_slip_mm", "rigid slip", second=True),
        ),
        levels=((f"gross slip {1e3 * GROSS_SLIP:g}", 1e3 * GROSS_SLIP),),
        bodies=ONE,
    ),
    _Plan(
        title="slide of the object [mm], true",
        curves=(_Shown("slide_mm", "in the hand"),),
        span=(0.0, 0.1),  # smaller slides, and below smaller turns and torques, are solver noise
    ),
    _Plan(
        title="turn of the object [°], true",
        curves=(
            _Shown("turn_deg", "in the hand"),
            _Shown("elastic_deg", "elastic twist", second=True),
        ),
        span=(-1.0, 1.0),
    ),
    _Plan(
        title="pressure [N/m], true",
        curves=(
            _Shown("pressure_n_per_m", "over the outermost nodes"),
            _Shown("pressure_pitch_n_per_m", "plus one node pitch", second=True),
        ),
    ),
    _Plan(
        title="mean pressure [kPa], true",
        curves=(_Shown("pressure_kpa", "of the contact pressed more"),),
    ),
    _Plan(
        title="torque about the axis [N mm]",
        curves=_both("torque_{}_nmm"),
        span=(-1.0, 1.0),
    ),
)


def panels_of(scene: Scene, of: Columns) -> Iterator[Panel]:
    """Panels of a run, without curves that have no value.

    Two fingers share a panel with one true value and its estimate; otherwise each has a panel.

    Parameters
    ----------
    scene: scene that was run
    of: columns of its trace; a trace of an earlier version lacks some
    """
    body, befores = scene.mechanics, prefixes(scene)
    for plan in _PLANS:
        if body not in plan.bodies:
            continue
        groups: list[tuple[str, ...]] = [befores]
        if plan.curves[0].column in columns_of(body):
            groups = [("",)]
        elif any(curve.second for curve in plan.curves):
            groups = [(before,) for before in befores]
        for group in groups:
            yield from _panel(scene, of, plan, group)


def _panel(scene: Scene, of: Columns, plan: _Plan, befores: tuple[str, ...]) -> Iterator[Panel]:
    """Panel of columns whose names begin with `befores`; empty without curves."""
    read = word_for_read(scene.path)
    curves: list[Curve] = []
    for k, before in enumerate(befores):
        shared = f"{_words(before)}, " if len(befores) > 1 else ""
        for shown in plan.curves:
            curves += _curve(of, shown, before, shared + shown.label.format(read), k == 1)
    if not curves:
        return
    levels, title = plan.levels, plan.title
    if title == MARGIN:
        curves += _doubt(scene, of, befores[0], plan.limits[1])
        levels = _margin_levels(scene)
    if len(befores) == 1 and befores[0]:
        title = f"{title}, {_words(befores[0])}"
    yield Panel(title=title, curves=curves, levels=levels, span=plan.span, limits=plan.limits)


def _words(before: str) -> str:
    """Words for a finger, from the beginning of its columns' names."""
    return before.replace("_", " finger")


def _margin_levels(scene: Scene) -> tuple[tuple[str, float], ...]:
    """Margins that a controller has as settings."""
    levels = (
        ("target {:g}", scene.target_margin),
        ("sliding possible from {:g} down", scene.sliding_margin),
    )
    return tuple((text.format(value), value) for text, value in levels if value is not None)


def _curve(of: Columns, shown: _Shown, before: str, label: str, second: bool) -> Iterator[Curve]:
    """Curve of a column; empty if it has no value."""
    name = before + shown.column
    if name not in of or not np.isfinite(of[name]).any():
        return
    low, high = interval_of(of, name) or (None, None)
    yield Curve(
        label=label,
        values=of[name],
        role=shown.role,
        second=second or shown.second,
        steps=shown.steps,
        low=low,
        high=high,
    )


def _doubt(scene: Scene, of: Columns, before: str, top: float) -> Iterator[Curve]:
    """Times at which sliding was possible, shaded up to the top of the panel."""
    possible = may_slide(scene, of, before)
    if scene.sliding_margin is not None and possible.any():
        bottom = np.where(possible, scene.sliding_margin, np.nan)
        yield Curve(
            label="sliding was possible",
            values=bottom,
            role="other",
            low=bottom,
            high=np.where(possible, top, np.nan),
        )
