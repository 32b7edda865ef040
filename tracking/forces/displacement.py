"""Displacement of the skin at each marker of a flat sensor, by calibrated gains.

Lin 2019 Eq. 3: δz = (h − h0)/Gz from the hue, δxy = c_xy/(a·δz + b) from the centroid, whose gain
depends on the depth. The marker's size also measures δz; both are weighted by inverse variance.
"""

from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from ...errors import UserError
from ...strict_toml import Table
from ..tracks import Tracks

Array = NDArray[np.float64]
Positive = Annotated[float, Meta(gt=0.0, le=1e6)]


class DisplacementGains(Table, frozen=True, kw_only=True):
    """Gains between the displacement of the skin and the changes of a marker's image.

    `…_deviation` is the standard deviation for a single marker, including noise. Hue or size is
    missing if the tracker does not measure it.
    """

    hue_deg_per_mm: float | None = None
    hue_deviation_deg: Positive | None = None
    log_size_per_mm: float | None = None
    log_size_deviation: Positive | None = None
    shift_px_per_mm: float
    shift_px_per_mm2: float
    shift_deviation_px: Positive


def fit_gains(rest: Tracks, presses: list[Tracks], depth: Array, shear: Array) -> DisplacementGains:
    """Fit gains to presses of a plate that displaces the skin at most markers by the same amount.

    Parameters
    ----------
    rest: tracks of the unloaded sensor
    presses: tracks of K presses
    depth, shear: displacement of the plate, into the skin and along x [m], shape (K,)

    Raises
    ------
    UserError
        When they do not determine every gain.
    """
    depth_mm, shear_mm = 1e3 * depth, 1e3 * shear
    sheared = shear_mm != 0.0
    if len(set(depth_mm)) < 2 or len(set(depth_mm[sheared])) < 2:
        raise UserError(
            f"{len(set(depth_mm))} different depths, {len(set(depth_mm[sheared]))} of them with a "
            "shear, do not determine how the gain of a shear depends on the depth; wanted: at "
            "least two with a shear"
        )
    hue, size, shift = (
        np.stack(values) for values in zip(*(_moved(rest, t) for t in presses), strict=True)
    )
    hues = _gain(hue, depth_mm[:, None])
    sizes = _gain(size, depth_mm[:, None])
    along = _gain(shift[..., 0], np.stack([shear_mm, depth_mm * shear_mm], axis=1))
    if along is None or (hues is None and sizes is None):
        raise UserError("the tracker measured neither hues nor sizes of markers in the presses")
    (shift_gain, shift_slope), deviation = along
    return DisplacementGains(
        hue_deg_per_mm=hues and hues[0][0],
        hue_deviation_deg=hues and hues[1],
        log_size_per_mm=sizes and sizes[0][0],
        log_size_deviation=sizes and sizes[1],
        shift_px_per_mm=shift_gain,
        shift_px_per_mm2=shift_slope,
        shift_deviation_px=deviation,
    )


def skin_displacement(
    gains: DisplacementGains, rest: Tracks, tracks: Tracks
) -> tuple[Array, Array]:
    """Displacement (x, y, depth) at each outer marker [m], (M, 3), and covariance, (M, 3, 3).

    Both are NaN where a marker is not visible, or neither hue nor size is measured.
    """
    hue, size, shift = _moved(rest, tracks)
    measured = [
        (hue, gains.hue_deg_per_mm, gains.hue_deviation_deg),
        (size, gains.log_size_per_mm, gains.log_size_deviation),
    ]
    information, moment = np.zeros(len(hue)), np.zeros(len(hue))
    for value, gain, deviation in measured:
        if gain is not None and deviation is not None:
            known = np.isfinite(value)
            information += np.where(known, (gain / deviation) ** 2, 0.0)
            moment += np.where(known, gain * np.nan_to_num(value) / deviation**2, 0.0)
    information[information == 0.0] = np.nan
    depth = moment / information
    lateral = gains.shift_px_per_mm2 * depth + gains.shift_px_per_mm
    moved = np.column_stack([shift / lateral[:, None], depth])
    # Derivatives by (x, y) in the image and by the depth, which are independent.
    slope = np.zeros((len(hue), 3, 3))
    slope[:, 0, 0] = slope[:, 1, 1] = 1.0 / lateral
    slope[:, :2, 2] = -moved[:, :2] * gains.shift_px_per_mm2 / lateral[:, None]
    slope[:, 2, 2] = 1.0
    variance = np.column_stack(
        [np.full((len(hue), 2), gains.shift_deviation_px**2), 1 / information]
    )
    return 1e-3 * moved, 1e-6 * np.einsum("mij,mj,mkj->mik", slope, variance, slope)


def _moved(rest: Tracks, tracks: Tracks) -> tuple[Array, Array, Array]:
    """Changes of hue [°], log size and position [px] of the outer markers: (M,), (M,), (M, 2)."""
    visible = tracks.visible[0] & rest.visible[0]
    hue = np.where(visible, (tracks.hue - rest.hue + 180.0) % 360.0 - 180.0, np.nan)
    size = np.where(visible, tracks.log_size[0] - rest.log_size[0], np.nan)
    return hue, size, np.where(visible[:, None], tracks.position[0] - rest.position[0], np.nan)


def _gain(values: Array, inputs: Array) -> tuple[list[float], float] | None:
    """Fit factors of the inputs (K, I) to values (K, M) of K presses; also the scatter of markers.

    Markers at the edge, which do not move with the plate, are excluded. None with too few presses.
    """
    known = np.isfinite(values).any(axis=1)
    if known.sum() < inputs.shape[1] + 1:
        return None
    values, inputs = values[known], inputs[known]
    factors = np.linalg.lstsq(inputs, np.nanmedian(values, axis=1), rcond=None)[0]
    for _ in range(3):
        error = values - (inputs @ factors)[:, None]
        # Markers off by more than three standard deviations are at an edge of the plate. 0.6745
        # standard deviations are the median of |error|.
        near = abs(error) <= 3.0 * np.nanmedian(abs(error)) / 0.6745
        factors = np.linalg.lstsq(inputs[np.nonzero(near)[0]], values[near], rcond=None)[0]
    return factors.tolist(), float(error[near].std())
