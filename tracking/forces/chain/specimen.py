"""How trained codes move the marker pairs of one specimen, which sit elsewhere than designed."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....errors import UserError
from ....render import SensorDesign
from ..shifts import MEASURED, MarkerShifts
from .fields import STATIONS, Azimuths, at_angles, at_places
from .readout import ReadOut
from .residual import Smooth, smooth_functions

Array = NDArray[np.float64]

#: Columns of the log sizes among the measurements of a pair.
SIZES = np.array([2, 5])
#: Standard deviation of a change of all log sizes of a layer, by focus and blur.
FOCUS = 0.01
#: A twist is the mean turn of the skin up to this angle from the apex [rad].
_NEAR = np.deg2rad(30.0)


@dataclass(frozen=True, kw_only=True)
class Specimen:
    """The P marker pairs of one specimen; U unknowns: K even codes, odd codes, then the log sizes.

    Attributes
    ----------
    shifts: reads the pairs' shifts off tracks
    means, loadings: fields of the mean and of the codes on the pairs' circles
    unexplained: variances that the unknowns leave, shape (P, 6)
    strength: prior variance of each unknown, shape (U,)
    codes: number of even codes
    smooth: functions of the residual's statistics
    direction: by which the azimuth of a shear follows from codes
    """

    shifts: MarkerShifts
    means: Azimuths
    loadings: Azimuths
    unexplained: Array
    strength: Array
    codes: int
    smooth: Smooth
    direction: "Direction"


@dataclass(frozen=True, kw_only=True)
class Aligned:
    """Mean and loadings of a specimen for a load of one azimuth.

    Attributes
    ----------
    azimuth: of the load's plane [rad]
    mean: of the shifts [px, px, 1], shape (P, 6)
    loadings: change of the shifts with each unknown, shape (P, 6, U)
    """

    azimuth: float
    mean: Array
    loadings: Array


@dataclass(frozen=True, kw_only=True)
class Direction:
    """Products of the codes that give size and azimuth of the shear.

    Attributes
    ----------
    along, across: factor of the first harmonic's magnitude along the plane and across it [px], of
        codes and 1, shapes (R, K + 1) and (R, O)
    twist: turn of the skin about the axis by each odd code [rad], shape (O,)
    """

    along: Array
    across: Array
    twist: Array


def read_specimen(readout: ReadOut, shifts: MarkerShifts) -> Specimen:
    """Specimen with the pairs of `shifts`.

    Raises
    ------
    UserError
        When no pair is visible at rest.
    """
    places = shifts.places
    if places.shape[1] == 0:
        raise UserError("the tracker finds no marker pair at rest; is the noise too large?")
    left = np.stack([at_angles(readout.left[k], places[k, :, 0], axis=1) for k in range(2)])
    pairs = places.shape[1]
    gains = _gains(readout.design, shifts.sensor)
    return Specimen(
        shifts=shifts,
        means=at_places(gains * readout.mean[None], np.array([False]), places),
        loadings=at_places(gains * readout.fields, readout.odd, places),
        unexplained=np.moveaxis(left, 2, 0).reshape(pairs, MEASURED),
        strength=with_focus_variances(readout.strength),
        codes=readout.codes,
        smooth=smooth_functions(places[0]),
        direction=_direction(readout),
    )


def _gains(design: SensorDesign, sensor: SensorDesign) -> Array:
    """Motion of each layer in the image over that of the design, to first order, (2, 1, 1, 1).

    A calibration may state another `follow` and depth of a layer than the design.
    """
    if design.shape.flat:
        return np.ones((2, 1, 1, 1))
    near, far = (one.follow / (one.shape.radius - one.depths) for one in (sensor, design))
    # A layer that does not move at all has no other size of motion.
    gains = np.divide(near, far, out=np.ones(2), where=far > 0.0)
    return gains.reshape(2, 1, 1, 1)


def with_focus(loadings: Array) -> Array:
    """Loadings (P, 6, U) of codes, and of a change of all log sizes of each layer, (P, 6, U + 2).

    A change of all sizes is the camera's, not a press.
    """
    pairs = len(loadings)
    focus = np.broadcast_to(np.eye(MEASURED)[:, SIZES], (pairs, MEASURED, len(SIZES)))
    return np.concatenate([loadings, focus], axis=2)


def with_focus_variances(strength: Array) -> Array:
    """Prior variances of codes (U,), and of a change of all log sizes of each layer, (U + 2,)."""
    return np.append(strength, [FOCUS**2] * len(SIZES))


def aligned(specimen: Specimen, azimuth: float) -> Aligned:
    """Mean and loadings for a load of that azimuth [rad]."""
    measured = specimen.shifts.measured
    return Aligned(
        azimuth=azimuth,
        mean=measured * specimen.means.at(azimuth)[..., 0],
        loadings=measured[..., None] * with_focus(specimen.loadings.at(azimuth)),
    )


def _direction(readout: ReadOut) -> Direction:
    """Products of the codes that give the azimuth of a shear, and the turn of the skin."""
    weight = np.sqrt(np.sin(STATIONS))

    def first_harmonic(fields: Array) -> Array:
        """Radial and tangential first harmonics of fields (K, …), shape (R, K)."""
        return np.asarray((fields[:, :, :2, :, 1] * weight).reshape(len(fields), -1).T)

    even, odd = readout.fields[: readout.codes], readout.fields[readout.codes :].copy()
    circling = odd[:, 0, 1, :, 0].T.copy()
    # sin(φ − ψ) = sin φ·cos ψ − cos φ·sin ψ, but cos(φ − ψ) = cos φ·cos ψ + sin φ·sin ψ.
    odd[:, :, 1] *= -1.0
    skin, view = readout.design.shape, readout.design.view
    on_axis, at = (
        view.project(skin.points(np.stack([theta, np.zeros_like(theta)], axis=-1), 0.0))[:, 0]
        for theta in (np.zeros(1), STATIONS)
    )
    radius = at - on_axis
    near = np.where(STATIONS < _NEAR, np.sin(STATIONS), 0.0)
    return Direction(
        along=np.concatenate([first_harmonic(even), first_harmonic(readout.mean[None])], axis=1),
        across=first_harmonic(odd),
        twist=(near * radius) @ circling / (near @ radius**2),
    )
