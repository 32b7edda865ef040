"""A published reading: one JSON object, the row of a table of estimates with how late it is.

`docs/file-formats.md` lists its keys. `observation_of` makes of it what our controllers take.
"""

import math
import time
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..control import GripObservation
from ..model import ForceField
from ..output.parquet import Row

#: Name and version of the messages.
SCHEMA = "chromagrip reading 1"
Message = dict[str, Any]
#: Keys that every message has besides, null where they are unknown.
_ALWAYS = ("wrench_covariance", "mu_observed", "torsion_nmm", "torsion_borne_nmm")


def message_of(
    row: Row,
    observation: GripObservation | None,
    *,
    late_s: float,
    skipped: int,
    columns: Iterable[str] = (),
    doubt: str | None = None,
) -> Message:
    """Message of a reading.

    Parameters
    ----------
    row: row of the table of estimates, with its frame and time
    observation: observation of the row; None for displacements of a flat pad
    late_s: time since the frame came [s]
    skipped: number of frames that were left out so far, because newer ones had come
    columns: columns that every message has, null where they are unknown
    doubt: what was assumed of the pictures, in words
    """
    message: Message = dict.fromkeys((*columns, *_ALWAYS))
    message |= {"schema": SCHEMA, "published_s": time.time()}
    message |= {"late_s": late_s, "skipped": skipped, "doubt": doubt}
    message |= {name: value for name, value in row.items() if not isinstance(value, np.ndarray)}
    if observation is not None and not observation.no_estimate:
        covariance = observation.field.wrench_covariance
        if covariance is not None and np.isfinite(covariance).all():
            message["wrench_covariance"] = covariance.tolist()
        message["mu_observed"] = bool(observation.friction_observable)
        message["torsion_nmm"] = 1e3 * observation.torsion  # JSON has null for NaN
        message["torsion_borne_nmm"] = 1e3 * observation.torsion_borne
    return message


def observation_of(message: Mapping[str, Any]) -> GripObservation:
    """Observation for a controller: forces in sum, friction and margins of a message.

    Its margin is the smaller one of Γ and that with torsion, as scenes hold it by default. The
    forces are those of a single node, with the right sums and their covariances left at zero.
    """

    def number(name: str) -> float:
        value = message.get(name)
        return math.nan if value is None else float(value)

    def interval(name: str) -> tuple[float, float]:
        return number(f"{name}_low"), number(f"{name}_high")

    reason = str(message.get("no_estimate") or "")
    normal, friction = (0.0 if reason else number(name) for name in ("normal_n", "friction_n"))
    field = ForceField(
        position=np.zeros((1, 3)),
        normal=np.array([normal]),
        friction=np.array([[friction, 0.0, 0.0]]),
        contact=np.array([normal > 0.0]),
        totals_covariance=np.zeros((2, 2)),
        directions=np.array([[0.0, 0.0, -1.0]]),
    )
    limit = number("limit_margin")
    held = "limit_margin" if math.isfinite(limit) else "margin"
    return GripObservation(
        time=number("time_s"),
        field=field,
        friction=number("mu"),
        friction_interval=interval("mu"),
        friction_observable=bool(message.get("mu_observed")),
        margin=number(held),
        margin_interval=interval(held),
        lateral_displacement=math.nan,
        no_estimate=reason,
        limit_margin=limit,
        limit_margin_interval=interval("limit_margin"),
        torsion=1e-3 * number("torsion_nmm"),
        torsion_borne=1e-3 * number("torsion_borne_nmm"),
    )
