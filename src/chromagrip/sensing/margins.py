"""Margins of an observation: bias on µ, margin with torsion, margin to hold, finger to follow."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..control import GripObservation
from ..model import margin_within, torsion
from ..scene.scene import HeldMargin
from ..tracking import Z90

Array = NDArray[np.float64]


def finished(observation: GripObservation, bias: float = 0.0) -> GripObservation:
    """Add a bias on µ, and the margin of friction and torsion together; no interval exceeds 1."""
    observation = with_limit_margin(with_friction_bias(observation, bias))
    return replace(
        observation,
        margin_interval=_at_most_one(observation.margin_interval),
        limit_margin_interval=_at_most_one(observation.limit_margin_interval),
    )


def _at_most_one(interval: tuple[float, float]) -> tuple[float, float]:
    """Interval of a margin, which never exceeds 1; an unknown end stays NaN."""
    low, high = interval
    return min(low, 1.0), min(high, 1.0)


def with_friction_bias(observation: GripObservation, bias: float) -> GripObservation:
    """Add a bias to µ, which stays at 0.01 or above, and compute Γ with it."""
    if bias == 0.0 or math.isnan(observation.margin):
        return observation
    mu = max(observation.friction + bias, 0.01)
    margin = observation.field.safety_margin(mu)
    low, high = (end + mu - observation.friction for end in observation.friction_interval)
    margin_low, margin_high = (
        end + margin - observation.margin for end in observation.margin_interval
    )
    return replace(
        observation,
        friction=mu,
        friction_interval=(low, high),
        margin=margin,
        margin_interval=(margin_low, margin_high),
    )


def with_limit_margin(observation: GripObservation) -> GripObservation:
    """Add the margin of friction and torsion together, if the torque is known.

    A torque whose covariance is unknown counts as exact.
    """
    field, mu = observation.field, observation.friction
    if field.directions is None or math.isnan(observation.margin):
        return observation
    # It is never larger than Γ, except for the tolerance of its search.
    limit = min(margin_within(field, mu), observation.margin)
    twist, slope, bound = torsion(field)
    bound *= mu
    observation = replace(observation, torsion=twist, torsion_borne=bound)
    if not bound > 0.0:  # a single node carries no torsion
        return replace(
            observation, limit_margin=limit, limit_margin_interval=observation.margin_interval
        )
    covariance = field.wrench_covariance
    error = 0.0 if covariance is None else _deviation(slope, covariance) / bound
    share = abs(twist) / bound
    error = math.hypot(error, share * _bound_deviation(observation))
    low, high = observation.margin_interval
    ends = (1.0 - high, 1.0 - low), (share - Z90 * error, share + Z90 * error)
    return replace(
        observation,
        limit_margin=limit,
        limit_margin_interval=_interval(limit, 1.0 - observation.margin, share, ends),
    )


def held(observation: GripObservation, margin: HeldMargin) -> GripObservation:
    """Observation for a controller: its margin is the one to hold."""
    if margin == "friction" or math.isnan(observation.limit_margin):
        return observation
    return replace(
        observation,
        margin=observation.limit_margin,
        margin_interval=observation.limit_margin_interval,
    )


def smaller(observations: Sequence[GripObservation]) -> int:
    """Number of the finger whose observation the controller gets: that of the smallest margin.

    A finger without contact comes before all others, so that controllers grip. A finger without an
    estimate is ignored while another finger has one.
    """
    return min(range(len(observations)), key=lambda k: _urgency(observations[k]))


def _urgency(observation: GripObservation) -> float:
    if observation.no_estimate:
        return math.inf
    return -math.inf if math.isnan(observation.margin) else observation.margin


def _deviation(slope: Array, covariance: Array) -> float:
    return math.sqrt(max(float(slope @ covariance @ slope), 0.0))


def _bound_deviation(observation: GripObservation) -> float:
    """Relative standard deviation of µ·ΣFn, to which a contact's bounds are proportional."""
    field = observation.field
    low, high = observation.friction_interval
    friction = 0.0 if math.isnan(low) else (high - low) / (2.0 * Z90 * observation.friction)
    normal = math.sqrt(max(field.totals_covariance[0, 0], 0.0)) / field.total_normal
    return math.hypot(friction, normal)


def _interval(
    limit: float,
    pull: float,
    twist: float,
    ends: tuple[tuple[float, float], tuple[float, float]],
) -> tuple[float, float]:
    """Interval of the margin, from the errors of pull and twist together.

    Both share the error of µ·ΣFn. So their effects are added, each as if the limit surface were
    an ellipsoid: the used share of it is the root of the sum of both squares.

    Parameters
    ----------
    limit: margin of friction and torsion together
    pull, twist: friction and torsion, each as a share of the largest that is carried alone
    ends: ends of the intervals of both
    """
    used = math.hypot(pull, twist)
    pulls, twists = ends
    least, most = (
        math.hypot(max(pulls[k], 0.0), twist) + math.hypot(pull, max(twists[k], 0.0)) - 2.0 * used
        for k in (0, 1)
    )
    return limit - most, limit - least
