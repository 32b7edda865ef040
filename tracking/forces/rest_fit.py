"""Estimation of the camera's pose from the positions of the resting markers.

A mounted camera is rolled, tilted and shifted, and layers are never quite aligned. Each error moves
the resting markers in its own pattern. If one were confused with another, forces would be wrong.

The unknowns x are the camera's roll, tilt (2), shift (2) and log scale, and three of the inner
layer: its turn, or on a pad its shift (2) and turn.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from ...errors import UserError
from ...render import SensorDesign
from ..tracks import Tracks
from .pose import CameraPose, seen_by
from .rest_match import Agreement, RestMarkers, Shift, agreement, rest_markers, spun
from .rest_search import likely_poses
from .rest_settings import PoseSettings

Array = NDArray[np.float64]
Rounds = Sequence[tuple[float, float]]
_Pairs = tuple[NDArray[np.intp], Array]
_Missed = Callable[[Array], Array]


#: Slices of x of quantities that may be as designed, and χ² above which they are not (1 % level for
#: one and for two unknowns).
_GROUPS = {
    "roll": (slice(0, 1), 6.6),
    "tilt": (slice(1, 3), 9.2),
    "shift": (slice(3, 5), 9.2),
    "scale": (slice(5, 6), 6.6),
}


def rest_pose(
    sensor: SensorDesign, rest: Tracks, settings: PoseSettings = PoseSettings()
) -> CameraPose:
    """Estimate the pose of the camera from the resting markers.

    The last result is cached, as several reconstructors need it for the same tracks.

    Parameters
    ----------
    sensor: calibrated design, with the layout of the markers
    rest: tracks of the unloaded sensor

    Raises
    ------
    UserError
        When no pose explains the markers, or two do, or the pose is out of range.
    """
    for of_sensor, of_rest, by, pose in _last:
        if of_rest is rest and of_sensor == sensor and by == settings:
            return pose
    _last[:] = [(sensor, rest, settings, _estimated(sensor, rest, settings))]
    return _last[0][3]


#: Sensor, tracks, settings and pose of the last call.
_last: list[tuple[SensorDesign, Tracks, PoseSettings, CameraPose]] = []


def _estimated(sensor: SensorDesign, rest: Tracks, settings: PoseSettings) -> CameraPose:
    """Estimate the pose from the markers; see `rest_pose`."""
    markers = rest_markers(sensor, rest, settings.match)
    perfect = markers.same == settings.match.same
    loss = 1.0 / math.sqrt(len(sensor.places))
    fits = [_fitted(markers, CameraPose(), settings.from_design, settings)]
    if not _sure(markers, fits[0].match, settings):
        for start in likely_poses(markers, settings.search):
            fits.append(_fitted(markers, start, settings.from_search, settings))
            # With imprecise markers several poses are likely, and the best may come later.
            if not markers.lattice and perfect and _sure(markers, fits[-1].match, settings):
                break
    found = max(fits, key=lambda one: one.match.overlap)
    rivals = [(one.pose, one.match) for one in fits]
    for spin in markers.turns:
        match = agreement(markers, found.pose, found.shift, spin)
        rivals.append((spun(found.pose, spin), match))
    best = max(match.overlap for _, match in rivals)
    equal = [one for one in rivals if one[1].overlap >= best - settings.equal * loss]
    equal.sort(key=lambda one: one[1].moved)
    nearest, its_match = equal[0]
    _check_match(markers, its_match, nearest.scale, settings)
    others = [one for one in equal[1:] if not _alike(markers, nearest, one[0])]
    if others:
        _check_clear(markers, nearest, its_match, *others[0], settings.clear)
    if nearest is not found.pose:
        found = _fitted(markers, nearest, settings.from_design, settings)
    found = _told(markers, found, settings)
    _check_range(sensor, found.pose, settings)
    return replace(found.pose, error=found.match.error, ambiguous=bool(others))


@dataclass(frozen=True, kw_only=True)
class _Fit:
    """Best fit from a start.

    Attributes
    ----------
    pose: pose of the camera
    shift: misalignment of the inner layer
    match: agreement with the rest frame
    numbers, covariance: unknowns x, and their covariance
    """

    pose: CameraPose
    shift: Shift
    match: Agreement
    numbers: Array
    covariance: Array


def _sure(markers: RestMarkers, match: Agreement, settings: PoseSettings) -> bool:
    """Whether no other pose can be better."""
    # Missing markers can only hide the shift of a lattice.
    share = match.overlap if markers.lattice else match.share
    return share >= max(1.0 - settings.sure / math.sqrt(len(markers.sensor.places)), settings.share)


def _told(markers: RestMarkers, fit: _Fit, settings: PoseSettings) -> _Fit:
    """Set roll, tilt, shift or scale to the design if they do not differ from it significantly.

    An error of a tenth of a degree or pixel due to scattered markers would move the contact.
    """
    as_designed: tuple[str, ...] = ()
    deviations: dict[str, Any] = {}
    while True:
        evidence = {}
        for name, (place, limit) in _GROUPS.items():
            some, covariance = fit.numbers[place], fit.covariance[place, place]
            if name not in as_designed and covariance.any():
                evidence[name] = float(some @ np.linalg.solve(covariance, some)) / limit
        if not evidence or min(evidence.values()) >= 1.0:
            return replace(fit, pose=replace(fit.pose, **deviations))
        least = min(evidence, key=lambda name: evidence[name])
        deviations[f"{least}_deviation"] = getattr(fit.pose, f"{least}_deviation")
        as_designed = (*as_designed, least)
        start = replace(fit.pose, **{name: getattr(CameraPose(), name) for name in as_designed})
        fit = _fitted(markers, start, settings.from_design[-1:], settings, as_designed)


def _fitted(
    markers: RestMarkers,
    start: CameraPose,
    rounds: Rounds,
    settings: PoseSettings,
    as_designed: tuple[str, ...] = (),
) -> _Fit:
    """Fit pose and misalignment from a start, with each marker at the nearest design position.

    The groups in `as_designed` are not fitted, nor the tilt on a pad, where it looks like a shift.
    """
    flat = markers.sensor.shape.flat
    unit = _units(settings, flat)
    free = np.ones(len(unit), dtype=bool)
    for name in (*as_designed, "tilt") if flat else as_designed:
        free[_GROUPS[name][0]] = False
    x = _numbers(start) / unit
    place = settings.place * markers.pitch
    for radius, part in rounds:
        pose, shift = _values(x * unit, flat)
        matched = _matched(markers, pose, shift, radius, part)

        def missed(x: Array, matched: list[_Pairs] = matched) -> Array:
            pose, shift = _values(x * unit, flat)
            error = [
                (seen_by(pose, markers.camera, markers.designed(k, shift)[number]) - pixels).ravel()
                for k, (number, pixels) in enumerate(matched)
            ]
            return np.concatenate(error) / pose.scale

        def residual(some: Array, x: Array = x, missed: _Missed = missed) -> Array:
            full = x.copy()
            full[free] = some
            prior = full.copy()
            prior[_GROUPS["roll"][0]] = 0.0  # any roll is as likely
            return np.concatenate([missed(full) / place, prior])

        fit = scipy.optimize.least_squares(residual, x[free], loss="soft_l1", xtol=1e-7, ftol=1e-7)
        x = x.copy()
        x[free] = fit.x
    freedom = max(len(fit.fun) - 2 * int(free.sum()), 1)
    spread = max(2.0 * float(fit.cost) / freedom, 1e-12)
    covariance = np.zeros((len(unit), len(unit)))
    slopes = np.asarray(fit.jac)
    covariance[np.ix_(free, free)] = spread * np.linalg.pinv(slopes.T @ slopes)
    pose, shift = _values(x * unit, flat)
    deviation = np.sqrt(np.diag(covariance)) * unit
    return _Fit(
        pose=_with_deviations(pose, deviation),
        shift=shift,
        match=agreement(markers, pose, shift),
        numbers=x,
        covariance=covariance,
    )


def _units(settings: PoseSettings, flat: bool) -> Array:
    """Prior standard deviations of x, shape (9,); the value for roll is only a scale."""
    tilt, shift, turn, along = settings.tilt, settings.shift, settings.turn, settings.along
    inner = (along, along, turn) if flat else (turn, turn, turn)
    return np.array([1.0, tilt, tilt, shift, shift, settings.log_scale, *inner])


def _matched(
    markers: RestMarkers, pose: CameraPose, shift: Shift, radius: float, part: float
) -> list[_Pairs]:
    """Indices of the design markers nearest to visible ones, and pixels of the latter, by layer.

    Parameters
    ----------
    markers: markers of the rest frame
    pose, shift: pose and misalignment so far
    radius: largest distance [pitches]
    part: share of the layout, from the middle, that is used
    """
    outward = np.argsort(np.argsort(markers.sensor.places[:, 0]))
    limit = part**2 * len(outward)
    matched = []
    for layer, places in zip(markers.layers, markers.seen(pose, shift), strict=True):
        distance, number = scipy.spatial.KDTree(places).query(layer.pixels)
        near = np.asarray(distance) < radius * markers.pitch * pose.scale
        near &= outward[number] < limit
        matched.append((np.asarray(number)[near], layer.pixels[near]))
    return matched


def _numbers(pose: CameraPose) -> Array:
    """Unknowns x of a pose with aligned layers."""
    return np.array([pose.roll, *pose.tilt, *pose.shift, math.log(pose.scale), 0.0, 0.0, 0.0])


def _values(x: Array, flat: bool) -> tuple[CameraPose, Shift]:
    """Pose and misalignment of unknowns x."""
    roll, tilt_x, tilt_y, x_shift, y_shift, scale, one, two, three = map(float, x)
    pose = CameraPose(
        roll=math.remainder(roll, 2 * math.pi),
        tilt=(tilt_x, tilt_y),
        shift=(x_shift, y_shift),
        scale=math.exp(scale),
    )
    if flat:
        return pose, Shift(turn=(0.0, 0.0, three), along=(one, two))
    return pose, Shift(turn=(one, two, three))


def _with_deviations(pose: CameraPose, deviation: Array) -> CameraPose:
    roll, tilt_x, tilt_y, x_shift, y_shift, scale = map(float, deviation[:6])
    return replace(
        pose,
        roll_deviation=roll,
        tilt_deviation=(tilt_x, tilt_y),
        shift_deviation=(x_shift, y_shift),
        scale_deviation=scale * pose.scale,
    )


def _alike(markers: RestMarkers, one: CameraPose, other: CameraPose) -> bool:
    """Whether two poses put each marker at the same position."""
    here, there = (markers.seen(pose, Shift())[0] for pose in (one, other))
    return float(np.median(np.linalg.norm(here - there, axis=-1))) < 0.5 * markers.pitch


def _check_match(
    markers: RestMarkers, match: Agreement, scale: float, settings: PoseSettings
) -> None:
    """Refuse a rest frame that no pose explains."""
    allowed = settings.apart * markers.pitch * scale
    crooked = markers.sensor.defects.crookedness_mm > 0.0
    share = settings.crooked if crooked else settings.share
    if match.share < share or match.found < settings.found or match.error > allowed:
        raise UserError(
            f"{100 * match.share:.0f} % of the markers at rest lie at places of the calibrated "
            f"sensor, however its camera is turned and shifted, {match.error:.1f} px RMS from "
            f"them; wanted: at least {100 * share:.0f} % and at most {allowed:.1f} px. Is it "
            "another sensor? Or is the picture not of one at rest?"
        )


def _check_clear(
    markers: RestMarkers,
    pose: CameraPose,
    match: Agreement,
    other: CameraPose,
    its: Agreement,
    clear: float,
) -> None:
    """Refuse a rest frame that two poses explain equally well, neither of them near the design."""
    turned = math.dist(pose.shift, other.shift) < 0.5 * markers.pitch
    near, next_one = (abs(pose.roll), abs(other.roll)) if turned else (match.moved, its.moved)
    if near > clear * next_one:
        raise UserError(
            "the rest frame does not tell how the camera is turned or shifted, as the layout is "
            f"symmetric: it may be {pose}, or {other}; allowed: the first less than a quarter as "
            "far from the design as the second"
        )


def _check_range(sensor: SensorDesign, pose: CameraPose, settings: PoseSettings) -> None:
    """Refuse a pose out of the range that can be estimated."""
    search, tilt = settings.search, settings.largest_tilt
    shift = search.shift * min(sensor.view.width, sensor.view.height)
    low, high = search.smallest_scale, search.largest_scale
    if (
        math.hypot(*pose.shift) > shift
        or not low <= pose.scale <= high
        or math.hypot(*pose.tilt) > tilt
    ):
        raise UserError(
            f"the rest frame shows a camera {pose}; allowed: shifts to {shift:.0f} px, scales of "
            f"{low:g} to {high:g} and tilts to {math.degrees(tilt):.0f}°"
        )
