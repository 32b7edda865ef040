"""Range checks of physical parameters: one sentence that names the value and what is allowed."""

import math


def finite(name: str, value: float, unit: str, *, above: float = -math.inf) -> None:
    """Raise ValueError unless `value` is finite and greater than `above` (in `unit`)."""
    if math.isfinite(value) and value > above:
        return
    bound = "" if above == -math.inf else f" and above {above:g}"
    raise ValueError(f"{name} must be finite{bound} {unit}".rstrip() + f", got {value!r}")


def within(name: str, value: float, unit: str, low: float, high: float) -> None:
    """Raise ValueError unless low ≤ value ≤ high (in `unit`)."""
    if not low <= value <= high:
        raise ValueError(
            f"{name} must lie in {low:g}…{high:g} {unit}".rstrip() + f", got {value!r}"
        )
