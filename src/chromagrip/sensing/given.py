"""Checks of numbers that a caller gives."""

import math
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from ..errors import UserError


def number(value: object, what: str, least: float = -math.inf) -> float:
    """Check a finite number of at least `least`; `what` names it in the message.

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
    """Check an array of finite numbers; `counts` are the allowed lengths.

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
