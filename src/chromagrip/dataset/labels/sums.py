"""Sums and shares of a frame, of any body."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .columns import STATES

#: Tolerance of Γ against its forces: rounding.
_MARGIN = 1e-6
#: Γ may be below 0 by this much in gross slip, where friction is found by iteration.
_OVER = 1e-3


def wrong_sums(
    row: dict[str, Any], touching: NDArray[np.bool_], normal: float, friction: float, slack: float
) -> Iterator[str]:
    """Yield what is wrong with the sums of a frame.

    Parameters
    ----------
    row: values of the frame
    touching: nodes in contact, (N,)
    normal, friction: sums over the nodes [N]
    slack: what they may be off [N]
    """
    if row["slip_state"] not in STATES:
        yield f"slip_state is {row['slip_state']!r}"
    for name, total in (("normal_n", normal), ("friction_n", friction)):
        if abs(row[name] - total) > slack:
            yield f"{name} is {row[name]:.6g}, the nodes' sum {total:.6g}"
    if row["contact_nodes"] != touching.sum():
        yield f"contact_nodes is {row['contact_nodes']}, {touching.sum()} nodes are in contact"
    held = row["mu"] * row["normal_n"]
    margin = 1.0 - row["friction_n"] / held if row["contact_nodes"] else np.nan
    if not np.isclose(row["margin"], margin, atol=_MARGIN, equal_nan=True):
        yield f"margin is {row['margin']:.6g}, its forces say {margin:.6g}"
    if row["margin"] < -_OVER:
        yield f"margin is {row['margin']:.3g}: friction holds more than it can"
    if not 0.0 <= row["slipped_share"] <= 1.0:
        yield f"slipped_share is {row['slipped_share']}"
