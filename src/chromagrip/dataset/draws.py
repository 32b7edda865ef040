"""Random draws of values, such as `{ uniform = [low, high] }`."""

import math
from typing import Any

import numpy as np

from ..errors import UserError
from ..extras import missing

#: A kind of draw with its numbers.
How = dict[str, list[Any]]
#: How many numbers each kind of draw takes; None: any.
_DRAWS = {"uniform": 2, "log_uniform": 2, "normal": 4, "choice": None, "each": None}


def draw(how: How, rng: np.random.Generator, turn: int) -> Any:
    """Draw a value; `each` cycles through its list by `turn`."""
    ((kind, numbers),) = how.items()
    if kind == "choice":
        return numbers[int(rng.integers(len(numbers)))]
    if kind == "each":
        return numbers[turn % len(numbers)]
    if kind == "uniform":
        return float(rng.uniform(*numbers))
    if kind == "log_uniform":
        return float(np.exp(rng.uniform(*np.log(numbers))))
    mean, deviation, low, high = numbers
    while True:
        value = float(rng.normal(mean, deviation))
        if low <= value <= high:
            return value


def check_draw(how: How, name: str) -> None:
    """Refuse an invalid draw; `name` is its place in messages.

    Raises
    ------
    UserError
        For an unknown kind, and for numbers that are not allowed.
    """
    if len(how) != 1 or next(iter(how)) not in _DRAWS:
        raise UserError(f"{name}: expected one of {', '.join(_DRAWS)}")
    ((kind, numbers),) = how.items()
    count = _DRAWS[kind]
    if count is None:
        if not numbers:
            advice = ""
            if name.endswith("object.mesh"):
                lack = missing("mesh")
                advice = ": give --meshes FOLDER" + (f"; {lack}" if lack else "")
            raise UserError(f"{name}: {kind} needs something to choose from{advice}")
        return
    if len(numbers) != count or not all(isinstance(v, int | float) for v in numbers):
        raise UserError(f"{name}: {kind} takes {count} numbers, got {numbers}")
    low, high = numbers[-2:]
    if not (math.isfinite(low) and math.isfinite(high) and low <= high):
        raise UserError(f"{name}: the range from {low} to {high} is empty")
    if kind == "log_uniform" and not low > 0.0:
        raise UserError(f"{name}: log_uniform starts above 0, got {low}")
    if kind == "normal" and not (numbers[1] > 0.0 and low <= numbers[0] <= high):
        raise UserError(f"{name}: normal needs a deviation above 0 and its mean within bounds")


def ends(how: How) -> list[Any]:
    """Bounds of the drawn values, or all of them."""
    ((kind, numbers),) = how.items()
    return list(numbers) if _DRAWS[kind] is None else list(numbers[-2:])
