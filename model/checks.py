"""Range checks of physical parameters: one sentence that names the value and what is allowed."""

import math

from ..errors import UserError


def finite(
    name: str, value: float, unit: str, *, above: float = -math.inf, below: float = math.inf
) -> None:
    """Raise ValueError unless `value` is finite, above one bound and at most the other."""
    if math.isfinite(value) and above < value <= below:
        return
    bound = "" if above == -math.inf else f" and above {above:g}"
    if below != math.inf:
        bound += f" and at most {below:g}"
    raise UserError(f"{name} must be finite{bound} {unit}".rstrip() + f", got {value!r}")


def within(name: str, value: float, unit: str, low: float, high: float) -> None:
    """Raise ValueError unless low ≤ value ≤ high (in `unit`)."""
    if not low <= value <= high:
        raise UserError(f"{name} must lie in {low:g}…{high:g} {unit}".rstrip() + f", got {value!r}")
