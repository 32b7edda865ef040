"""Numbers that a caller gives, which must be numbers in their range."""

import math
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from ..errors import UserError


def number(value: object, what: str, least: float = -math.inf) -> float:
    """A finite number of at least `least`.

    Raises
    ------
    UserError
        For anything else.
    """
    given = float(value) if isinstance(value, Real) else math.nan
    if not (math.isfinite(given) and given >= least):
        bound = "" if least == -math.inf else f" of at least {least:g}"
        raise UserError(f"{what} = {value!r} must be a finite number{bound}")
    return given


def numbers(values: object, counts: tuple[int, ...], what: str) -> NDArray[np.float64]:
    """Array of so many finite numbers.

    Raises
    ------
    UserError
        For anything else.
    """
    try:
        found = np.asarray(values, float)
    except (TypeError, ValueError):
        found = np.zeros(0)
    if found.ndim != 1 or len(found) not in counts or not np.isfinite(found).all():
        words = " or ".join(map(str, counts))
        raise UserError(f"{what} must be {words} finite numbers, got {values!r}")
    return found
