"""Shifts of one specimen's marker pairs by trained codes, at their actual places."""

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
#: Standard deviation of a common change of all log sizes of a layer, by focus and blur.
FOCUS = 0.01
#: Angle from the apex up to which the rotation of the skin is averaged as twist [rad].
_NEAR = np.deg2rad(30.0)


@dataclass(frozen=True, kw_only=True)
class Specimen:
    """P marker pairs of one specimen; U unknowns: K even codes, odd codes, changes of log size.

    Attributes
    ----------
    shifts: method that computes the pairs' shifts from tracks
    means, loadings: mean field and fields of the codes at the pairs
    unexplained: residual variances, shape (P, 6)
    strength: prior variance of each unknown, shape (U,)
    codes: number K of even codes
    smooth: functions for the residual's statistics
    direction: products that give the azimuth of a shear from codes
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
    azimuth: azimuth of the load's plane [rad]
    mean: mean of the shifts [px, px, 1], shape (P, 6)
    loadings: change of the shifts per unknown, shape (P, 6, U)
    """

    azimuth: float
    mean: Array
    loadings: Array


@dataclass(frozen=True, kw_only=True)
class Direction:
    """Products of the codes that give size and azimuth of the shear.

    Attributes
    ----------
    along, across: matrices from K even codes and 1, and from O odd codes, to the first harmonic of
        the shear along and across the plane [px], shapes (R, K + 1) and (R, O)
    twist: rotation of the skin about the axis by each odd code [rad], shape (O,)
    """

    along: Array
    across: Array
    twist: Array


def read_specimen(readout: ReadOut, shifts: MarkerShifts) -> Specimen:
    """Make a specimen with the pairs of `shifts`.

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
    """Motion of each layer in the image over that in the design, to first order, (2, 1, 1, 1).

    A calibration may have another `follow` and depth of a layer than the design.
    """
    if design.shape.flat:
        return np.ones((2, 1, 1, 1))
    near, far = (one.follow / (one.shape.radius - one.depths) for one in (sensor, design))
    # A layer that does not move has the ratio 1.
    gains = np.divide(near, far, out=np.ones(2), where=far > 0.0)
    return gains.reshape(2, 1, 1, 1)


def with_focus(loadings: Array) -> Array:
    """Append common changes of log size of each layer to loadings (P, 6, U): (P, 6, U + 2).

    Such a change is caused by the camera, not by a press.
    """
    pairs = len(loadings)
    focus = np.broadcast_to(np.eye(MEASURED)[:, SIZES], (pairs, MEASURED, len(SIZES)))
    return np.concatenate([loadings, focus], axis=2)


def with_focus_variances(strength: Array) -> Array:
    """Append variances of common changes of log size to those of codes (U,): (U + 2,)."""
    return np.append(strength, [FOCUS**2] * len(SIZES))


def aligned(specimen: Specimen, azimuth: float) -> Aligned:
    """Mean and loadings of a specimen for an azimuth of the load [rad]."""
    measured = specimen.shifts.measured
    return Aligned(
        azimuth=azimuth,
        mean=measured * specimen.means.at(azimuth)[..., 0],
        loadings=measured[..., None] * with_focus(specimen.loadings.at(azimuth)),
    )


def _direction(readout: ReadOut) -> Direction:
    """Compute the matrices that give shear and twist from codes."""
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
