"""Where the fit of a contact starts: from rest, and beside a solution that may be a wrong one.

A press tells little of an object: what is softer, bent more and pressed deeper shows almost the
same markers. Such objects lie along a curved valley that a fit from one end does not walk through.
"""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ....model import Dome
from .contact_fit import ContactFit
from .contact_solution import Solution
from .contact_state import CURVES, FRICTION, MOVING, PLACE, PRESS, STIFFNESS, prior_of
from .key_shifts import Key, Shifts
from .keys import Backoff

Array = NDArray[np.float64]
#: An object, and key frames with poses, from which a fit starts.
Start = tuple[Array, tuple[Key, ...]]

#: Starts from rest: angles of the place from the apex [rad], and how many around it.
_PLACES = ((0.0, 1), (0.25, 6), (0.55, 10))
#: Press of a start from rest over the thickness.
_PRESS = 0.1
#: Curvatures times the radius of other objects at the same place.
_CURVES = (0.0, 3.0)
#: Rivals: factors of press and curvature, and of µ. They take turns.
_RIVALS = ((1.6, 1.0), (1.0 / 1.6, 1.0), (1.0, 0.5))
#: Deviations of ln k and ln µ beyond which a rival is not tried.
_PLAUSIBLE = 5.0
#: Power of the press that the stiffness goes with along the valley.
_SOFTER = -1.8
#: A rival is tried once in so many key frames that were added, at first and at last.
_OFTEN, _SELDOM = 2, 32


def start_from_rest(fit: ContactFit, shifts: Shifts) -> Start:
    """The place of a light press whose image is most like the shifts."""
    mean, light = prior_of(fit.dome).mean, _light(fit.dome)
    best, most, press = mean, -math.inf, 0.0
    target = shifts.apply(shifts.values)
    for angle, count in _PLACES:
        for turn in 2.0 * math.pi * np.arange(count) / count:
            tried = mean.copy()
            tried[PLACE] = angle * math.cos(turn), angle * math.sin(turn)
            image = shifts.apply(fit.image(tried, light)[1][shifts.used])
            length = max(float(np.linalg.norm(image)), 1e-9)
            score = float(image @ target) / length
            if score > most:
                # A force, and so the image, grows about as the press to the power of 3/2.
                larger = float(np.clip(max(score / length, 0.05) ** (2.0 / 3.0), 0.2, 4.0))
                best, most, press = tried, score, larger * light[PRESS]
    pose = np.zeros(MOVING)
    pose[PRESS] = press
    return best, (Key(shifts=shifts, pose=pose),)


def light_press(fit: ContactFit) -> tuple[float, Array]:
    """ΣFn [N] of a light press at the apex, and the shifts of all pairs, (P, 6)."""
    return fit.image(prior_of(fit.dome).mean, _light(fit.dome))


def other_objects(dome: Dome, object_: Array, keys: tuple[Key, ...]) -> Iterator[Start]:
    """A flat and a round object at the same place."""
    for curve in _CURVES:
        other = prior_of(dome).mean.copy()
        other[PLACE] = object_[PLACE]
        other[CURVES] = np.array([curve, curve, 0.0]) / dome.radius
        yield other, keys


class Rivals:
    """Starts beside the solutions of a grasp, in turns: softer, stiffer, and of less friction.

    They are tried the less often, the longer none was better.

    Parameters
    ----------
    dome: body
    """

    def __init__(self, dome: Dome) -> None:
        self.dome = dome
        self._turn, self._often = 0, Backoff(_OFTEN, _SELDOM, len(_RIVALS))

    def next(self, solution: Solution) -> Start | None:
        """The next start, once in a while and if it may be the true one; None else."""
        if not self._often.due():
            return None
        deeper, slippery = _RIVALS[self._turn % len(_RIVALS)]
        self._turn += 1
        softer, slips = _SOFTER * math.log(deeper), math.log(slippery)
        known = np.sqrt(np.diag(solution.covariance)[MOVING:])
        if max(abs(softer) / known[STIFFNESS], abs(slips) / known[FRICTION]) > _PLAUSIBLE:
            self.tried(better=False)
            return None
        other = solution.object_.copy()
        # Curvatures count from the dome's own.
        round_ = np.array([1.0, 1.0, 0.0]) / self.dome.radius
        other[CURVES] = deeper * (other[CURVES] + round_) - round_
        other[STIFFNESS] += softer
        other[FRICTION] += slips
        press = np.ones(MOVING)
        press[PRESS] = deeper
        keys = (Key(shifts=key.shifts, pose=press * key.pose) for key in solution.keys)
        return other, tuple(keys)

    def tried(self, better: bool) -> None:
        """Say whether the last start was better."""
        self._often.tried(better)


def _light(dome: Dome) -> Array:
    pose = np.zeros(MOVING)
    pose[PRESS] = _PRESS * dome.thickness
    return pose
