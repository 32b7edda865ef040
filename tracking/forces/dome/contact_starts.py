"""Starts of the fit of a contact: from rest, and next to a solution that may be wrong.

A press hardly determines an object: a softer one with more curvature that is pressed deeper shows
almost the same markers. The cost has a curved valley, which a fit from one end does not cross.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ....model import Dome
from .contact_fit import ContactFit
from .contact_solution import Solution
from .contact_state import CURVES, FRICTION, MOVING, PLACE, PRESS, STIFFNESS, prior_of
from .key_shifts import Key, Shifts
from .keys import Backoff
from .settings import StartSettings

Array = NDArray[np.float64]
#: An object, and key frames with poses, from which a fit starts.
Start = tuple[Array, tuple[Key, ...]]


@dataclass(frozen=True, kw_only=True)
class LightPress:
    """A light press of the prior's object at one place.

    Attributes
    ----------
    object_: unknowns of the object, shape (8,)
    force: ΣFn [N]
    image: shifts of all pairs, shape (P, 6)
    """

    object_: Array
    force: float
    image: Array


def light_presses(fit: ContactFit, settings: StartSettings) -> list[LightPress]:
    """Simulate light presses at all places from which a fit may start, the apex first."""
    mean, light = prior_of(fit.dome).mean, _light(fit.dome, settings)
    presses = []
    for angle, count in settings.places:
        for turn in 2.0 * math.pi * np.arange(count) / count:
            tried = mean.copy()
            tried[PLACE] = angle * math.cos(turn), angle * math.sin(turn)
            force, image = fit.image(tried, light)
            presses.append(LightPress(object_=tried, force=force, image=image))
    return presses


def start_from_rest(
    fit: ContactFit, presses: Sequence[LightPress], shifts: Shifts, settings: StartSettings
) -> Start:
    """Find the place where a light press would cause the most similar shifts."""
    best, most, larger = presses[0].object_, -math.inf, 0.0
    target = shifts.apply(shifts.values)
    for each in presses:
        image = shifts.apply(each.image[shifts.used])
        length = max(float(np.linalg.norm(image)), 1e-9)
        score = float(image @ target) / length
        if score > most:
            # Force and shifts grow roughly with the press to the power of 3/2.
            larger = float(np.clip(max(score / length, 0.05) ** (2.0 / 3.0), 0.2, 4.0))
            best, most = each.object_, score
    return best, (Key(shifts=shifts, pose=larger * _light(fit.dome, settings)),)


def other_objects(
    dome: Dome, object_: Array, keys: tuple[Key, ...], settings: StartSettings
) -> Iterator[Start]:
    """Yield starts with a flat and a round object at the same place."""
    for curve in settings.curves:
        other = prior_of(dome).mean.copy()
        other[PLACE] = object_[PLACE]
        other[CURVES] = np.array([curve, curve, 0.0]) / dome.radius
        yield other, keys


@dataclass(frozen=True, kw_only=True)
class Rivals:
    """Starts next to the solutions of a grasp, in turns: softer, stiffer, and with less friction.

    Attributes
    ----------
    settings: tuned parameters
    backoff: interval from one rival to the next, which grows while none is better
    turn: number of rivals so far
    """

    settings: StartSettings
    backoff: Backoff
    turn: int = 0

    @classmethod
    def from_first(cls, settings: StartSettings) -> Self:
        """State before the first rival."""
        first, most = settings.rivals_first, settings.rivals_most
        backoff = Backoff.from_first(first, most, len(settings.rivals))
        return cls(settings=settings, backoff=backoff)

    def next(self, dome: Dome, solution: Solution) -> tuple[Self, Start | None]:
        """State after another key frame, and a start if one is due and plausible."""
        settings, backoff = self.settings, self.backoff.next_chance()
        if not backoff.due:
            return replace(self, backoff=backoff), None
        deeper, slippery = settings.rivals[self.turn % len(settings.rivals)]
        after = replace(self, backoff=backoff, turn=self.turn + 1)
        softer, slips = settings.softening * math.log(deeper), math.log(slippery)
        known = np.sqrt(np.diag(solution.covariance)[MOVING:])
        if max(abs(softer) / known[STIFFNESS], abs(slips) / known[FRICTION]) > settings.plausible:
            return after.tried(better=False), None
        other = solution.object_.copy()
        # Curvatures are relative to the dome's own.
        round_ = np.array([1.0, 1.0, 0.0]) / dome.radius
        other[CURVES] = deeper * (other[CURVES] + round_) - round_
        other[STIFFNESS] += softer
        other[FRICTION] += slips
        press = np.ones(MOVING)
        press[PRESS] = deeper
        keys = (Key(shifts=key.shifts, pose=press * key.pose) for key in solution.keys)
        return after, (other, tuple(keys))

    def tried(self, better: bool) -> Self:
        """State after the last start succeeded or failed."""
        return replace(self, backoff=self.backoff.tried(better))


def _light(dome: Dome, settings: StartSettings) -> Array:
    """Pose of a light press."""
    pose = np.zeros(MOVING)
    pose[PRESS] = settings.press * dome.thickness
    return pose
