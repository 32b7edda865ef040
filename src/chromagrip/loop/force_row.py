"""Row of a table of estimates: the values of an observation, by column of `FORCES`."""

import math

import numpy as np

from ..control import GripObservation
from ..output.parquet import Row
from ..tracking import Z90, FrictionRule


def force_row(observation: GripObservation, rule: FrictionRule) -> Row:
    """Values of an observation and their intervals; None for unknown values."""
    if observation.no_estimate:
        return {"no_estimate": observation.no_estimate}
    field = observation.field
    row: Row = {"no_estimate": ""}
    values = [
        ("mu", "", observation.friction, observation.friction_interval),
        ("margin", "", observation.margin, observation.margin_interval),
        ("limit_margin", "", observation.limit_margin, observation.limit_margin_interval),
    ]
    for k, (name, total) in enumerate(
        (("normal", field.total_normal), ("friction", field.total_friction))
    ):
        half = Z90 * math.sqrt(field.totals_covariance[k, k])
        # In this order of arguments, max keeps a NaN.
        values.append((name, "_n", total, (max(total - half, 0.0), total + half)))
    deviations = [*observation.force_deviation, 1e3 * observation.torque_deviation]
    wrench = [*observation.force, 1e3 * observation.torque]
    # Names of force and torque of a dome, and their units in columns.
    names = ("force_x", "force_y", "force_z", "torque")
    units = ("_n", "_n", "_n", "_nmm")
    for name, unit, value, deviation in zip(names, units, wrench, deviations, strict=True):
        values.append((name, unit, value, (value - Z90 * deviation, value + Z90 * deviation)))
    for name, unit, value, (low, high) in values:
        for end, number in (("", value), ("_low", low), ("_high", high)):
            row[f"{name}{end}{unit}"] = float(number) if math.isfinite(number) else None
    row["mu_observable"] = rule.read(field).observable
    row["node_normal_n"] = field.normal.astype(np.float32)
    row["node_friction_n"] = field.friction.astype(np.float32).ravel()
    return row
