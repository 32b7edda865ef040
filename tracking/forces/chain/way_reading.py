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
from .way import Way
from .way_fit import WayFit, WayFrame

Array = NDArray[np.float64]

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
        self._shifts = MarkerShifts(calibration, rest, settings.reach, halves=True)
        self._fit = self._fitted(0.0)
        self.reset()

    def _fitted(self, azimuth: float) -> WayFit:
        """What follows a contact in the plane of an azimuth [rad]."""
        known = self._calibration
        return WayFit(
            known.fingertip,
            self._shifts.sensor,
            self._shifts.places,
            known.stiffness_deviation,
            self._settings,
            azimuth,
        )

    def reset(self) -> None:
        """Forget previous frames: the next one is the first."""
        self._learned.reset()
        self._forget()

    def _forget(self) -> None:
        self._way = Way(fit=self._fit)
        self._last: Shifts | None = None
        self._before: Shifts | None = None
        self._time, self._still = 0.0, 0

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
        try:
            self._follow(self._read(tracks), tracks.time, field)
        except NoEstimateError as error:
            reason = reason or str(error)
        if field is None:
            raise NoEstimateError(reason)
        return self._told(field)

    def _read(self, tracks: Tracks) -> Shifts:
        """Whitened shifts of a frame."""
        settings = self._settings
        values, certain = self._shifts(tracks, settings.least_markers)
        covariance = self._shifts.noise(tracks)[certain]
        values = values[certain]
        for layer in (0, 3):
            motion = np.hypot(values[:, layer], values[:, layer + 1])
            place = settings.place**2 + (settings.share * motion) ** 2
            size = settings.size**2 + (settings.size_share * values[:, layer + 2]) ** 2
            for index, added in enumerate((place, place, size), layer):
                covariance[:, index, index] += added
        whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        limits = ShiftSettings(odd=settings.odd)
        return Shifts(values=values, whiten=whiten, used=certain, settings=limits)

    def _follow(self, shifts: Shifts, time: float, field: ForceField | None) -> None:
        """Follow a frame if enough has moved."""
        settings, last = self._settings, self._last
        if float(shifts.seen @ shifts.seen) < settings.touched * shifts.count:
            self._forget()
            return
        moved = _places_moved(self._before, shifts)
        self._before = shifts
        motion = math.inf if last is None else _motion(last, shifts)
        self._still += 1
        if motion < settings.moved and self._still < settings.still:
            self._way.search()
            return
        dt = settings.first_dt if last is None else max(time - self._time, 1e-3)
        self._last, self._time, self._still = shifts, time, 0
        weight = min(1.0, settings.least + max(motion - settings.quiet, 0.0) / settings.full)
        sums, friction = None, math.nan
        if field is not None and field.friction_reading is not None:
            sums = np.array([field.total_normal, field.total_friction])
            friction = field.friction_reading.value
            self._turn(field)
        frame = WayFrame(dt=dt, shifts=shifts, weight=weight, motion=moved, sums=sums)
        self._way.add(frame, friction)

    def _turn(self, field: ForceField) -> None:
        """Follow the contact again if its plane was found to be another one."""
        azimuth = 0.0 if field.plane is None else field.plane.azimuth
        off = math.remainder(azimuth - self._fit.azimuth, math.pi)
        if abs(off) < self._settings.turned or len(self._way.frames) > self._settings.tried:
            return
        self._fit = self._fitted(azimuth)
        self._way = Way(fit=self._fit, frames=self._way.frames)

    def _told(self, field: ForceField) -> ForceField:
        """Field of the read-out, with the sums and µ of the way where it tells them."""
        settings, way, reading = self._settings, self._way, field.friction_reading
        if way.now is None or reading is None or not field.contact.any():
            return field
        now, fit = way.now, self._fit
        values, found = fit.values(now), way.quadratic()
        if not (values[0, 0] > settings.first_force and now.done >= settings.told):
            return field
        misfit = max(way.misfit())
        if misfit > settings.misfit:
            raise NoEstimateError(
                "no contact with a round or flat object of one friction explains the way of the "
                "markers"
            )
        slopes = (found.weights.T @ values)[1:]
        # What another step of the search would change, a misfit above the usual one, a search that
        # promises much, and a young way are doubts.
        left = np.clip(found.step, -1.0, 1.0) @ slopes
        doubt = max(misfit / settings.usual_misfit, 1.0)
        doubt *= 1.0 + found.gain / (settings.promised * way.cost())
        doubt *= 1.0 + settings.young / now.done
        return _fused(field, values[0] + 0.5 * left, abs(left), doubt, settings)


def _motion(last: Shifts, now: Shifts) -> float:
    """Root mean square of the whitened motion between two frames."""
    both = last.used & now.used
    before, after = both[last.used], both[now.used]
    moved = now.values[after] - last.values[before]
    whole = np.einsum("vwi,vi->vw", now.whiten[after], moved)
    return float(np.sqrt((whole**2).mean())) if whole.size else math.inf


def _places_moved(last: Shifts | None, now: Shifts) -> float:
    """Root mean square of the motion of places between two frames [px]."""
    if last is None:
        return 0.0
    both = last.used & now.used
    moved = (now.values[both[now.used]] - last.values[both[last.used]])[:, [0, 1, 3, 4]]
    return float(np.sqrt((moved**2).mean())) if moved.size else 0.0


def _fused(
    field: ForceField, told: Array, left: Array, doubt: float, settings: WaySettings
) -> ForceField:
    """Mean of a read-out's field and what a way tells, weighted by their errors.

    Parameters
    ----------
    told: ΣFn [N], ΣFf [N], µ and Γ of the way, half-way to the next step of its search, (4,)
    left: changes of these by that step, shape (4,)
    doubt: factor on its errors
    """
    reading = field.friction_reading
    assert reading is not None
    before = np.array([field.total_normal, field.total_friction])
    own = np.array([settings.normal_error * told[0], settings.friction_error]) * doubt
    own = np.hypot(own, left[:2])
    sums, deviations = _mean(told[:2], own, before, np.sqrt(np.diag(field.totals_covariance)))
    margin, deviation = _mean(
        told[3],
        math.hypot(settings.margin_error * doubt, left[3]),
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
