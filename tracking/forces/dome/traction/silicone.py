"""Uncertainty of tractions due to the covariance of a calibration's silicone parameters.

Young's modulus scales all forces. The other parameters change the shifts due to forces, and the
split into normal force and friction. For a small error of a parameter, the fitted forces change so
that they compensate the change of the shifts (to first order, within the same zone).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace as changed
from numpy.typing import NDArray

from ....tracks import Tracks
from ...calibration import SensorCalibration, silicone_of, with_silicone
from ...pose import CameraPose
from ...shifts import MarkerShifts
from ...silicone_values import silicone_names
from ..marker_response import DomeResponse
from .fit import TractionFit, Tractions
from .settings import TractionSettings, UnsureSettings
from .skin import Skin

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Sums:
    """Sums of forces, and position of a contact.

    Attributes
    ----------
    values: ΣFn, ΣFf, Fx, Fy, Fz [N] and Mz [N·m], shape (6,)
    margin: margin Γ
    net: friction vector that counts in Γ [N], shape (3,)
    middle: mean rest position of the nodes, weighted by normal force [m], shape (3,)
    """

    values: Array
    margin: float
    net: Array
    middle: Array


@dataclass(frozen=True, kw_only=True)
class _Other:
    """Silicone with one parameter changed by `step`."""

    step: float
    response: DomeResponse
    skin: Skin


class UnsureSilicone:
    """Propagates the covariance of one calibration's silicone parameters to the estimates.

    Parameters
    ----------
    calibration: calibration of the sensor, with its covariance
    rest: tracks of the unloaded sensor
    pose: pose of the specimen's camera
    settings: tuned parameters of the reconstructor
    """

    def __init__(
        self,
        calibration: SensorCalibration,
        rest: Tracks,
        pose: CameraPose,
        settings: TractionSettings,
    ) -> None:
        self._settings = settings.silicone
        values = silicone_of(calibration)
        assert values is not None
        covariance = np.array(calibration.silicone_covariance)
        names = silicone_names(calibration.sensor)
        # The last parameter is Young's modulus: its deviation is relative.
        share = np.ones(len(names))
        share[-1] = values.young_kpa
        self._covariance = covariance / np.outer(share, share)
        self._others: dict[int, _Other] = {}
        for k, name in enumerate(names[:-1]):
            step, now = float(np.sqrt(covariance[k, k])), getattr(values, name)
            if not step > 0.0:
                continue
            if name == "poisson" and now + step > self._settings.highest_poisson:
                step = -step
            known = with_silicone(calibration, changed(values, **{name: now + step}))
            shifts = MarkerShifts(known, rest, settings.reach, pose)
            dome = known.sensor.round_dome("reconstructor traction")
            self._others[k] = _Other(
                step=step,
                response=DomeResponse(shifts.sensor, dome, shifts.places),
                skin=Skin(dome, settings.skin),
            )
        self.reset()

    def reset(self) -> None:
        """Forget the cached derivatives."""
        self._last: Sums | None = None
        self._slopes = np.zeros((7, len(self._covariance)))

    def __call__(
        self,
        fit: TractionFit,
        response: DomeResponse,
        found: Tractions,
        sums: Sums,
        read: Callable[[Skin, Array], Sums],
    ) -> Array:
        """Covariance of ΣFn, ΣFf, Fx, Fy, Fz, Mz and Γ, shape (7, 7).

        Parameters
        ----------
        fit: fit that found the forces
        response: response of the markers with calibrated silicone
        found, sums: fitted forces and their sums
        read: function that sums forces (n, 3) on the same nodes after splitting them by a skin
        """
        if self._last is None or _far(self._last, sums, self._settings):
            self._last = sums
            shown = response(found.nodes, found.linear)
            for k, other in self._others.items():
                change = other.response(found.nodes, found.linear) - shown
                made = read(other.skin, found.linear + fit.answer(found, change))
                moved = (made.values - sums.values) / sums.values[0]
                self._slopes[:6, k] = moved / other.step
                self._slopes[6, k] = (made.margin - sums.margin) / other.step
        slopes = self._slopes.copy()
        slopes[:6] *= sums.values[0]
        slopes[:6, -1] = sums.values
        return slopes @ self._covariance @ slopes.T


def _far(before: Sums, now: Sums, settings: UnsureSettings) -> bool:
    """Whether the contact has changed too much for the cached derivatives."""
    whole = before.values[0]
    off = np.append(now.net - before.net, now.values[0] - whole)
    away = np.linalg.norm(now.middle - before.middle)
    turned = abs(off).max() > settings.changed * whole
    return bool(turned or away > settings.moved * np.linalg.norm(now.middle))
