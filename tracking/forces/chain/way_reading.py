"""Forces of the chain from a contact that is followed along its way, begun by the read-out."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....model import ForceField, FrictionReading
from ...tracks import Tracks
from ..calibration import SensorCalibration
from ..dome.key_shifts import Shifts
from ..dome.settings import ShiftSettings
from ..friction import OBSERVABLE_MARGIN
from ..reconstructors import NoEstimateError
from ..shifts import MarkerShifts
from .learned import Learned
from .settings import WaySettings
from .way_filter import WayFilter, WayFrame

Array = NDArray[np.float64]

#: Percentile of the pairs' motions that stands for those that move most.
_MOST = 95.0
#: Difference of two answers in units of its error, above which both count as less certain.
_APART = 1.2


class WayReading:
    """Estimates ΣFn, ΣFf and µ by a contact that explains all frames since the first touch.

    The trained read-out begins it, and answers as long as the way tells less. Its field is scaled
    to the sums.

    Parameters
    ----------
    calibration: calibration of the sensor, with a read-out
    rest: tracks of the unloaded sensor
    settings: tuned parameters
    """

    def __init__(
        self,
        calibration: SensorCalibration,
        rest: Tracks,
        settings: WaySettings = WaySettings(),
    ) -> None:
        self._settings, self._calibration = settings, calibration
        self._learned = Learned(calibration, rest)
        self._shifts = MarkerShifts(calibration, rest, settings.reach)
        self._filter = self._followed(0.0)
        self.reset()

    def _followed(self, azimuth: float) -> WayFilter:
        """What follows a contact in the plane of an azimuth [rad]."""
        shifts = self._shifts
        return WayFilter(
            self._calibration.fingertip,
            shifts.sensor,
            shifts.places,
            self._settings.filter,
            azimuth,
        )

    def reset(self) -> None:
        """Forget previous frames: the next one is the first."""
        self._learned.reset()
        self._forget()

    def _forget(self) -> None:
        self._filter.reset()
        self._frames: list[WayFrame] = []
        self._last: Shifts | None = None
        self._time = 0.0

    def update(self, tracks: Tracks) -> ForceField:
        """Estimate the force field of a frame.

        Raises
        ------
        NoEstimateError
            When the read-out has no estimate, and when no contact explains the way.
        """
        reason, field = "", None
        try:
            field = self._learned.update(tracks)
        except NoEstimateError as error:
            reason = str(error)
        azimuth = None
        if field is not None:
            azimuth = 0.0 if field.plane is None else field.plane.azimuth
        try:
            self._follow(*self._read(tracks), tracks.time, azimuth)
        except NoEstimateError:  # too few markers to follow; what the way told is of another frame
            if field is not None:
                return field
        if field is None:
            raise NoEstimateError(reason)
        return self._told(field)

    def _read(self, tracks: Tracks) -> tuple[Shifts, float]:
        """Whitened shifts of a frame, and the standard deviation of a place by noise alone [px]."""
        settings = self._settings
        values, certain = self._shifts(tracks, settings.least_markers)
        covariance = self._shifts.noise(tracks)[certain]
        values = values[certain]
        places = [0, 1, 3, 4]
        noise = math.sqrt(float(covariance[:, places, places].mean()))
        for layer in (0, 3):
            motion = np.hypot(values[:, layer], values[:, layer + 1])
            place = settings.place**2 + (settings.share * motion) ** 2
            size = settings.size**2 + (settings.size_share * values[:, layer + 2]) ** 2
            for index, added in enumerate((place, place, size), layer):
                covariance[:, index, index] += added
        whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        limits = ShiftSettings(odd=settings.odd)
        return Shifts(values=values, whiten=whiten, used=certain, settings=limits), noise

    def _follow(self, shifts: Shifts, noise: float, time: float, azimuth: float | None) -> None:
        """Follow a frame.

        Parameters
        ----------
        noise: standard deviation of a place [px]
        azimuth: of the load's plane by the read-out [rad]; None: unknown
        """
        settings, last = self._settings, self._last
        seen = float(shifts.seen @ shifts.seen) / shifts.count
        if seen < (settings.touched if last is None else settings.left):
            self._forget()
            return
        dt = settings.first_dt if last is None else max(time - self._time, 1e-3)
        self._last, self._time = shifts, time
        moved = _places_moved(last, shifts)
        motion = math.inf if last is None else _motion(last, shifts)
        noise *= settings.noise * math.sqrt(2.0)
        frame = WayFrame(
            dt=dt,
            shifts=shifts,
            weight=min(1.0, max(motion - settings.quiet, 0.0) / settings.full),
            motion=moved,
            stirred=math.sqrt(max(moved**2 - noise**2, 0.0)),
        )
        if len(self._frames) < settings.tried:
            self._frames.append(frame)
            self._turn(azimuth)
        self._filter.add(frame)

    def _turn(self, azimuth: float | None) -> None:
        """Follow the contact again if its plane was found to be another one."""
        if azimuth is None:
            return
        off = math.remainder(azimuth - self._filter.azimuth, math.pi)
        if abs(off) < self._settings.turned:
            return
        self._filter = self._followed(azimuth)
        for frame in self._frames[:-1]:
            self._filter.add(frame)

    def _told(self, field: ForceField) -> ForceField:
        """Field of the read-out, with the sums and µ of the way where it tells them."""
        settings, reading, misfits = self._settings, field.friction_reading, self._filter.misfits
        if len(misfits) < settings.told or reading is None or not field.contact.any():
            return field
        each = self._filter.values()
        told = np.median(each, axis=0)
        if not told[0] > settings.first_force:
            return field
        misfit = max(float(np.mean(misfits[-settings.remembered :])), float(np.mean(misfits)))
        if misfit > settings.misfit:
            raise NoEstimateError(
                "no contact with a round or flat object of one friction explains the way of the "
                "markers"
            )
        doubt = settings.doubt * max(misfit - settings.filter.usual_misfit, 0.0)
        errors = np.array([settings.normal_error * told[0], settings.friction_error])
        scale = told[0] * np.array([1.0, told[2]])  # errors of sums that change Γ by as much as 1
        errors = np.sqrt(errors**2 + each[:, :2].var(axis=0) + (doubt * scale) ** 2)
        margin = math.hypot(settings.margin_error, float(each[:, 3].std())) + doubt
        return _fused(field, told, errors, margin)


def _motion(last: Shifts, now: Shifts) -> float:
    """Root mean square of the whitened motion between two frames, of the pairs that move most."""
    both = last.used & now.used
    before, after = both[last.used], both[now.used]
    moved = now.values[after] - last.values[before]
    whole = np.einsum("vwi,vi->vw", now.whiten[after], moved)
    each = (whole**2).mean(axis=1)
    return math.sqrt(np.percentile(each, _MOST)) if each.size else math.inf


def _places_moved(last: Shifts | None, now: Shifts) -> float:
    """Root mean square of the motion of places between two frames [px]; of the first, from rest."""
    moved = now.values
    if last is not None:
        both = last.used & now.used
        moved = now.values[both[now.used]] - last.values[both[last.used]]
    moved = moved[:, [0, 1, 3, 4]]
    return float(np.sqrt((moved**2).mean())) if moved.size else 0.0


def _fused(field: ForceField, told: Array, errors: Array, error: float) -> ForceField:
    """Mean of a read-out's field and what a way tells, weighted by their errors.

    Parameters
    ----------
    told: ΣFn [N], ΣFf [N], µ and Γ of the way, shape (4,)
    errors: standard deviations of its sums [N], shape (2,)
    error: that of its Γ
    """
    reading = field.friction_reading
    assert reading is not None
    before = np.array([field.total_normal, field.total_friction])
    sums, deviations = _mean(told[:2], errors, before, np.sqrt(np.diag(field.totals_covariance)))
    margin, deviation = _mean(
        told[3],
        error,
        field.safety_margin(reading.value),
        reading.margin_deviation,
    )
    normal, friction = sums.tolist()
    mu = told[2] if margin > 0.95 else friction / ((1.0 - margin) * normal)
    side = math.copysign(1.0, float(field.net_friction[0]))
    pressing = field.normal * (normal / before[0])
    dragging = np.where(field.contact, field.friction, 0.0)
    dragging = dragging + (side * friction - dragging.sum()) * pressing / normal
    share = math.hypot(deviations[0] / normal, float(deviation) / max(1.0 - margin, 0.2))
    return replace(
        field,
        normal=pressing,
        friction=np.where(field.contact, dragging, 0.0),
        totals_covariance=np.diag(deviations**2),
        friction_reading=FrictionReading(
            value=mu,
            deviation=share * mu,
            observable=margin < OBSERVABLE_MARGIN,
            margin_deviation=float(deviation),
        ),
    )


def _mean(one: Any, error: Any, other: Any, other_error: Any) -> tuple[Any, Any]:
    """Mean of values with independent errors, weighted, and its error, larger if they disagree."""
    weight = other_error**2 / (error**2 + other_error**2)
    apart = abs(one - other) / np.hypot(error, other_error)
    spread = error * np.sqrt(weight) * np.maximum(apart / _APART, 1.0)
    return weight * one + (1.0 - weight) * other, spread
