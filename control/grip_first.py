"""The least grip in doubt: where a frame does not exclude that the object slides, grip first.

Γ has an interval. Where its lower end is near 0, the object may slide, whatever the middle says.
More grip settles the doubt: friction that holds stays as it is, and Γ rises.
"""

import math
from dataclasses import dataclass

from .settings import GripFirstSettings
from .sliding import FollowingFriction, SlidingSettings
from .values import GripObservation


@dataclass(frozen=True, kw_only=True)
class DoubtSettings:
    """Tuned numbers of `GripFirst`.

    Attributes
    ----------
    full_doubt: distance of the lower end of Γ below the sliding margin at which the rise is fastest
    growth: relative growth of the grip there, in addition to what the lower end of Γ demands
    later_growth: increase of that growth over `growth_s`: one rise may end a slip, and needs no
        second one
    growth_s: time over which the growth increases [s]
    slid_margin: smallest Γ kept against friction at which the object slid
    near_margin: lower end of Γ below which friction that follows the grip counts as sliding
    certain: number of its standard deviations above which friction is compared with the grip
    longest_period_s: longest time between frames that the rise counts [s]
    release_s: time constant with which the least grip falls [s]
    sliding: comparison of friction with the grip
    """

    full_doubt: float = 0.05
    growth: float = 0.35
    later_growth: float = 0.65
    growth_s: float = 0.1
    slid_margin: float = 0.15
    near_margin: float = 0.2
    certain: float = 3.0
    longest_period_s: float = 0.1
    release_s: float = 0.1
    sliding: SlidingSettings = SlidingSettings()


class GripFirst:
    """Follows the frames of a grasp, and bounds the grip force of the next command.

    Where the lateral displacement is known, sliding is observed, and there is no doubt.

    Parameters
    ----------
    settings: of the scene
    doubt: tuned numbers

    Attributes
    ----------
    doubt: whether the last frame left sliding open
    least, most: lowest and highest grip force to command after it [N]; in doubt `least` is never
        below the last command
    """

    def __init__(self, settings: GripFirstSettings, doubt: DoubtSettings = DoubtSettings()) -> None:
        self.settings, self._doubt = settings, doubt
        self._friction = FollowingFriction(doubt.sliding)
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        self.doubt = False
        self.least, self.most = 0.0, math.inf
        self._time = math.nan
        self._blind_since = math.nan
        self._doubt_since = math.nan
        self._friction.reset()

    def see(self, observation: GripObservation, force: float) -> None:
        """Follow a frame.

        Parameters
        ----------
        observation: observation of the frame
        force: force commanded last [N]
        """
        if not math.isnan(observation.lateral_displacement):
            return
        period = 0.0 if math.isnan(self._time) else observation.time - self._time
        self._time = observation.time
        rise = self.settings.rise_n_per_s * min(period, self._doubt.longest_period_s)
        if observation.no_estimate:
            self._see_nothing(observation.time, force, rise)
        else:
            self._blind_since = math.nan
            self._see_margin(observation, force, rise, period)
        self.most = max(self.settings.ceiling_n, force) if self.doubt else math.inf
        self.least = min(self.least, self.most)

    def _see_nothing(self, time: float, force: float, rise: float) -> None:
        """Hold the grip for a moment, then raise it."""
        if math.isnan(self._blind_since):
            self._blind_since = time
        # Frame times are products of a period: allow for their rounding.
        self.doubt = time - self._blind_since > self.settings.blind_s + 1e-9
        self.least = force + rise if self.doubt else force

    def _see_margin(
        self, observation: GripObservation, force: float, rise: float, period: float
    ) -> None:
        """Raise the least grip to what the interval of Γ asks for at once, and lower it slowly."""
        doubt = self._doubt
        lower = lower_margin(observation)
        if math.isnan(lower):  # nothing touches
            self._friction.reset()
            self.doubt, self.least = False, 0.0
            return
        field, time = observation.field, observation.time
        # An exact Γ needs no second opinion.
        near = lower < min(doubt.near_margin, observation.margin)
        certain = field.total_friction > doubt.certain * math.sqrt(
            max(field.totals_covariance[1, 1], 0.0)
        )
        friction = field.total_friction if certain else 0.0
        compared = self._friction.see(time, field.total_normal, friction, near)
        if self._friction.follows:
            if not compared:  # what the last rise did is not known yet
                self.doubt, self.least = True, max(self.least, force)
                return
            lower = 0.0
        missing = self.settings.sliding_margin - lower
        self.doubt = missing >= 0.0
        if not self.doubt:
            self._doubt_since = math.nan
        elif math.isnan(self._doubt_since):
            self._doubt_since = observation.time
        need = self._need(observation, lower)
        if self.doubt:
            need = max(need, force + _share_of_doubt(missing, doubt.full_doubt) * rise)
        fall = 1.0 - math.exp(-period / doubt.release_s)
        self.least += (need - self.least) * (1.0 if need > self.least else fall)

    def _need(self, observation: GripObservation, lower: float) -> float:
        """Grip force at which the lower end of Γ is the sliding margin [N].

        It is solved like Γ itself, with the friction and the relative errors of this frame. A
        sliding object shows no more friction than there is, so that the answer is too low there.
        """
        doubt = self._doubt
        margin = self.settings.sliding_margin
        need = observation.field.total_normal * (1.0 - lower) / (1.0 - margin)
        if self.doubt:
            share = grown(observation.time - self._doubt_since, doubt.growth_s)
            growth = doubt.growth + doubt.later_growth * share
            need *= 1.0 + growth * _share_of_doubt(margin - lower, doubt.full_doubt)
        if math.isnan(self._friction.slid_ratio):
            return need
        slid = observation.field.total_friction / self._friction.slid_ratio
        return max(need, slid / (1.0 - doubt.slid_margin))


def grown(time: float, growth_s: float) -> float:
    """Share of the growth that is reached after a time of possible sliding [s].

    Parameters
    ----------
    growth_s: time over which the growth increases [s]
    """
    return min(time / growth_s, 1.0)


def lower_margin(observation: GripObservation) -> float:
    """Lower end of the interval of Γ, or Γ itself if its interval is unknown; NaN without contact.

    It is at least 0, the Γ of an object that slides.
    """
    lower = observation.margin_interval[0]
    return max(observation.margin if math.isnan(lower) else lower, 0.0)


def _share_of_doubt(missing: float, full: float) -> float:
    """From 0, where sliding is excluded, to 1 where `full` or more is missing."""
    return min(max(missing / full, 0.0), 1.0)
