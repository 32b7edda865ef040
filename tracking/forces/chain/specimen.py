"""How trained codes move the marker pairs of one specimen, which sit elsewhere than designed."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ....errors import UserError
from ....model import Fingertip
from ....render import SensorDesign
from ..shifts import MEASURED, MarkerShifts
from .readout import ReadOut, limited
from .sensitivity import MarkerResponse

Array = NDArray[np.float64]

#: Columns of the log sizes among the measurements of a pair.
SIZES = np.array([2, 5])
#: Standard deviation of a change of all log sizes of a layer, by focus and blur.
_FOCUS = 0.01
#: Snapshots whose markers are computed at a time: all of them would need much memory.
_AT_ONCE = 20


@dataclass(frozen=True, kw_only=True)
class Specimen:
    """How codes move the P marker pairs of one specimen; U unknowns: K codes, then the log sizes.

    Attributes
    ----------
    shifts: reads the pairs' shifts off tracks
    mean: of the shifts [px, px, 1], shape (P, 6)
    loadings: change of the shifts with each unknown, shape (P, 6, U)
    unexplained: variances that the unknowns leave, shape (P, 6)
    strength: prior variance of each unknown, shape (U,)
    """

    shifts: MarkerShifts
    mean: Array
    loadings: Array
    unexplained: Array
    strength: Array


def read_specimen(readout: ReadOut, fingertip: Fingertip, shifts: MarkerShifts) -> Specimen:
    """Specimen with the pairs of `shifts`, trained on the design's pairs.

    Mean and loadings are those of the design's pairs, and what the read-out's snapshots say of the
    difference.

    Raises
    ------
    UserError
        When no pair is visible at rest.
    """
    design, places = readout.design, shifts.places
    if places.shape[1] == 0:
        raise UserError("the tracker finds no marker pair at rest; is the noise too large?")
    skin = design.shape
    nearest = KDTree(skin.points(design.places, 0.0)).query(skin.points(places[0], 0.0))[1]
    designed = np.stack([design.places[nearest]] * 2)
    chain = np.einsum("sp,pnk->snk", readout.snapshots, readout.modes)
    change = _shifts_of(shifts.sensor, places, fingertip, chain)
    change -= _shifts_of(design, designed, fingertip, chain)
    inputs = readout.snapshot_inputs()
    slopes = np.linalg.lstsq(inputs, change, rcond=None)[0]
    missed = ((change - inputs @ slopes) ** 2).sum(axis=0) / (len(inputs) - inputs.shape[1])

    def of_nearest(values: Array) -> Array:
        """Values of the design's pairs (…, 6M) for the specimen's, shape (…, P, 6)."""
        return values.reshape(*values.shape[:-1], -1, MEASURED)[..., nearest, :]

    unit = of_nearest(readout.noise)
    pairs = len(unit)
    rows = unit * of_nearest(readout.rows) + slopes[:-1].reshape(-1, pairs, MEASURED)
    # A change of all sizes is the camera's, not a press.
    focus = np.broadcast_to(np.eye(MEASURED)[:, SIZES], (pairs, MEASURED, len(SIZES)))
    return Specimen(
        shifts=shifts,
        mean=unit * of_nearest(readout.mean) + slopes[-1].reshape(pairs, MEASURED),
        loadings=np.concatenate([np.moveaxis(rows, 0, 2), focus], axis=2),
        unexplained=unit**2 * of_nearest(readout.left) + missed.reshape(pairs, MEASURED),
        strength=np.append(np.square(readout.scale) - 1.0, [_FOCUS**2] * len(SIZES)),
    )


def _shifts_of(sensor: SensorDesign, places: Array, tip: Fingertip, chain: Array) -> Array:
    """Shifts of pairs at places (2, P, 2) for each of S chains (S, N, 2), shape (S, 6P)."""
    response = MarkerResponse(sensor, places, tip.angles())
    resting = response.measured(np.zeros_like(chain[0]))
    parts = [
        response.measured(chain[k : k + _AT_ONCE]) - resting for k in range(0, len(chain), _AT_ONCE)
    ]
    return limited(np.concatenate(parts)).reshape(len(chain), -1)
