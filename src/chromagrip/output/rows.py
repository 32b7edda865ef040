"""One measured figure beside its target, as every bench reports it."""

import os
import platform
from dataclasses import asdict, dataclass
from typing import Any

from ..output.versions import versions


@dataclass(frozen=True)
class Row:
    """One measured figure; `target` says in words what it has to be, `met` whether it is.

    A figure that this machine cannot measure has the value None and is not met.
    """

    name: str
    value: float | None
    unit: str
    target: str
    met: bool


def within(name: str, value: float | None, unit: str, low: float, high: float) -> Row:
    """Figure that has to lie between two bounds."""
    met = value is not None and low <= value <= high
    target = f"{low:g}…{high:g}" if low != high else f"{low:g}"
    return Row(name, None if value is None else float(value), unit, target, bool(met))


def at_least(name: str, value: float, unit: str, low: float) -> Row:
    """Figure that has to reach a bound."""
    return Row(name, float(value), unit, f"≥ {low:g}", bool(value >= low))


def at_most(name: str, value: float, unit: str, high: float) -> Row:
    """Figure that must not exceed a bound; without one it is reported."""
    if high == float("inf"):
        return reported(name, value, unit)
    return Row(name, float(value), unit, f"≤ {high:g}", bool(value <= high))


def reported(name: str, value: float | None, unit: str) -> Row:
    """Figure that is reported as it is."""
    return Row(name, None if value is None else float(value), unit, "reported", value is not None)


def report(rows: list[Row], quick: bool = False) -> dict[str, Any]:
    """What every measuring command prints with --json: the machine, and a row per figure."""
    machine = {
        "system": platform.system(),
        "processor": platform.machine(),
        "cores": os.cpu_count(),
        **versions(),
    }
    return {"machine": machine, "quick": quick, "rows": [asdict(row) for row in rows]}
