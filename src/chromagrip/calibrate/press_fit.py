"""The least-squares problem of a sensor's calibration: presses predicted from unknown values.

Prediction: the model's equilibrium under a stiff flat plate, carried to the markers. Values that
the pictures do not determine stay near the design, within the stated tolerances.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from msgspec.structs import asdict
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ..errors import located
from ..model import ContactObject, Fingertip, ModelError, equilibrium
from ..tracking import SensorCalibration, Tracks
from ..tracking.forces import CameraPose, MarkerShifts, Values, values_of, with_values
from ..tracking.forces.chain import MarkerResponse
from .presses import Press

Array = NDArray[np.float64]

#: Prior standard deviation of these values around the design's.
DIRECT = {
    "tissue_poisson": 0.05,
    "yellow_follow": 0.2,
    "magenta_depth_mm": 0.05,
    "yellow_depth_mm": 0.05,
}
#: Lowest and highest value.
_LIMITS = {
    "tissue_poisson": (0.0, 0.5),
    "yellow_follow": (0.0, 1.0),
    "magenta_depth_mm": (0.0, math.inf),
    "yellow_depth_mm": (0.0, math.inf),
}
#: Name of the friction coefficient of skin and plate, which is fitted beside the values.
FRICTION = "plate_friction"
#: Nodes of the chain: as dense as at 251 in the contact, and sparser elsewhere.
_STATIONS = Fingertip.graded().stations


@dataclass(frozen=True, kw_only=True)
class Unknowns:
    """Values to fit, as x: their distance from the design in prior standard deviations.

    Attributes
    ----------
    nominal: calibration of the design
    spread: prior standard deviation of each unknown, by name
    needed: friction coefficient without which the plate would have slipped
    """

    #: Prior mean of the friction coefficient.
    usual_friction = 0.6
    #: The friction coefficient is at least this many times the largest ratio of forces, or the
    #: plate would have slipped.
    held = 1.05
    #: Largest distance of a value from the design's [prior standard deviations].
    farthest = 6.0

    nominal: SensorCalibration
    spread: dict[str, float]
    needed: float

    def values(self, x: Array) -> dict[str, float]:
        """Every value by name."""
        values: dict[str, float] = asdict(values_of(self.nominal))
        values[FRICTION] = max(self.usual_friction, self.held**2 * self.needed)
        for (name, by), step in zip(self.spread.items(), x, strict=True):
            if name in DIRECT:
                values[name] += by * float(step)
            else:
                values[name] *= math.exp(by * float(step))
        return values

    def calibration(self, x: Array) -> tuple[SensorCalibration, float]:
        """The calibration, and the friction coefficient on the plate."""
        values = self.values(x)
        friction = values.pop(FRICTION)
        return with_values(self.nominal, Values(**values)), friction

    def deviations(self, x: Array, covariance: Array) -> dict[str, float]:
        """Standard deviation of each value, to first order."""
        values = self.values(x)
        by = np.array([b if n in DIRECT else b * values[n] for n, b in self.spread.items()])
        return dict(zip(self.spread, (by * np.sqrt(np.diag(covariance))).tolist(), strict=True))

    def limits(self) -> tuple[Array, Array]:
        """Lowest and highest x."""
        start = self.values(np.zeros(len(self.spread)))
        edges = dict.fromkeys(self.spread, (-self.farthest, self.farthest))
        for name in self.spread.keys() & _LIMITS.keys():
            low, high = ((edge - start[name]) / self.spread[name] for edge in _LIMITS[name])
            edges[name] = (low, high)
        if self.needed:
            least = math.log(self.held * self.needed / start[FRICTION]) / self.spread[FRICTION]
            edges[FRICTION] = (max(least, -self.farthest), self.farthest)
        lows, highs = np.array(list(edges.values())).T
        return lows, highs


def unknowns_of(nominal: SensorCalibration, presses: list[Press]) -> Unknowns:
    """Values to fit of a sensor; not the yellow layer's motion where it is rigid by design."""
    # Prior standard deviation of the logarithm of these values around the design's.
    logarithmic = {"tissue_stiffness_n_per_m": 0.5, "membrane_stiffness_n_per_m": 0.5}
    friction_spread = 0.4  # prior standard deviation of its logarithm
    spread = logarithmic | DIRECT | {FRICTION: friction_spread}
    if not nominal.sensor.inner.follow:
        del spread["yellow_follow"]
    needed = max(abs(press.lateral) / press.normal for press in presses)
    return Unknowns(nominal=nominal, spread=spread, needed=needed)


@lru_cache(maxsize=256)
def pressed(fingertip: Fingertip, friction: float, normal: float, lateral: float) -> Array:
    """Node displacements relative to the rigid part [m], shape (N, 2)."""
    # Penalty stiffness of the plate [N/m]; tenfold less moves no marker by more than 0.3 % more.
    plate_n_per_m = 1e6
    plate = ContactObject(stiffness=plate_n_per_m, friction=friction)
    return equilibrium(fingertip, plate, normal, lateral).deformation.seen


def predict(
    calibration: SensorCalibration,
    friction: float,
    rest: Tracks,
    presses: list[Press],
    pose: CameraPose | None = None,
) -> Array:
    """Shifts of (x, y, log size) of both layers under each press, shape (K, P, 6).

    `pose` is the camera's, where it is known.
    """
    places = MarkerShifts(calibration, rest, np.inf, pose).places
    assert _STATIONS is not None
    tip = replace(calibration.fingertip, nodes=len(_STATIONS), stations=_STATIONS)
    response = MarkerResponse(calibration.sensor, places, tip.angles())
    displacements = [np.zeros((tip.nodes, 2))]
    for press in presses:
        with located(f"press {press.name} cannot be calculated"):
            displacements.append(pressed(tip, friction, press.normal, press.lateral))
    seen = response.measured(np.stack(displacements))
    return seen[1:] - seen[0]


def solve(
    missed: Callable[[Array], Array], unknowns: Unknowns, weights: Array, x: Array, robust: bool
) -> tuple[Array, Array]:
    """Best x from there on, and the derivative of the residuals, the priors' below."""

    def whitened(x: Array) -> Array:
        by_pair = missed(x).swapaxes(0, 1).reshape(len(weights), -1)
        return np.concatenate([np.einsum("pij,pj->pi", weights, by_pair).ravel(), x])

    def residuals(x: Array) -> Array:
        try:
            return whitened(x)
        except ModelError:  # too large a step, which the solver then shortens
            return np.full(weights[..., 0].size + len(x), np.inf)

    # Step of derivatives in prior standard deviations, far above the noise of an equilibrium.
    step_size = 0.02

    def jacobian(x: Array) -> Array:
        here = whitened(x)
        steps = np.diag(np.where(x - low > high - x, -step_size, step_size))
        return np.stack([(whitened(x + h) - here) / h.sum() for h in steps], axis=1)

    low, high = unknowns.limits()
    arrived = 1e-4  # relative change of x, or of the sum of squares, at which a fit ends
    rough = 1e-2  # relative change of the sum of squares at which the first, robust fit ends
    result = least_squares(
        residuals,
        x,
        jacobian,
        bounds=(low, high),
        loss="soft_l1" if robust else "linear",
        f_scale=3.0,
        xtol=arrived,
        ftol=rough if robust else arrived,
    )
    return result.x, np.asarray(result.jac)


def whitening(own: Array, shared: Array) -> Array:
    """Matrices that make the errors of a pair in all presses independent, (P, 6K, 6K).

    Parameters
    ----------
    own: covariance of each press alone, shape (K, P, 6, 6); or of any other number than 6
    shared: covariance that all presses have in common, shape (P, 6, 6)
    """
    presses, each = len(own), shared.shape[-1]
    covariance = np.tile(shared, (1, presses, presses))
    for k in range(presses):
        block = slice(each * k, each * (k + 1))
        covariance[:, block, block] += own[k]
    return np.linalg.inv(np.linalg.cholesky(covariance))
