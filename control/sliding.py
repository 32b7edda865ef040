"""Detection of sliding in addition to Γ: friction that follows the grip.

Friction of a held object equals the load, whatever the grip is. Friction of a sliding object is
µ times the grip. So a change of the grip distinguishes them, without a value of µ. At a constant
grip they look alike.
"""

import math
from collections import deque
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class SlidingSettings:
    """Tuned numbers of `FollowingFriction`.

    Attributes
    ----------
    compared_s: time over which friction and grip are compared [s]
    remembered_s: memory of the largest ratio of friction to grip [s]
    spacing_s: shortest time between compared frames [s]; faster cameras are thinned out
    fewest_frames: number of frames below which a constant ratio shows no sliding
    least_change: smallest change of ln ΣFn, or rise of ln ΣFf, that counts
    ratio_change: largest change of ln(ΣFf/ΣFn) of a sliding object, as a share of the change of
        ln ΣFn; friction that a controller follows with the grip leads it, and changes more
    fallen_share: share of the largest remembered ratio below which friction stopped following
    slid_share: share of the first ratio above which a ratio under rising grip has slid
    slid_s: memory of that ratio [s]
    """

    compared_s: float = 0.15
    remembered_s: float = 0.5
    spacing_s: float = 0.009
    fewest_frames: int = 4
    least_change: float = 0.1
    ratio_change: float = 0.3
    fallen_share: float = 0.92
    slid_share: float = 0.95
    slid_s: float = 1.0


class FollowingFriction:
    """Compares friction with the grip, frame after frame.

    Parameters
    ----------
    settings: tuned numbers

    Attributes
    ----------
    follows: whether friction followed the grip, or rose to a share of it that was not seen before,
        since it last fell short of what it was
    slid_ratio: ΣFf/ΣFn at which it kept following a grip that rose; NaN where none is known
    """

    def __init__(self, settings: SlidingSettings = SlidingSettings()) -> None:
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        self.follows = False
        self.slid_ratio = math.nan
        self._frames: deque[tuple[float, float, float]] = deque()
        self._began = (math.nan, math.nan)
        self._slid_at = math.nan

    def see(self, time: float, normal: float, friction: float, near: bool) -> bool:
        """Follow a frame; returns False if it came too soon after another to be compared.

        Parameters
        ----------
        time: instant of the frame [s]
        normal, friction: ΣFn and ΣFf [N]; if one is 0, all frames are forgotten
        near: whether Γ is so low that sliding is plausible
        """
        settings = self._settings
        if not (normal > 0.0 and friction > 0.0):
            self.reset()
            return False
        if self._frames and time - self._frames[-1][0] < settings.spacing_s:
            return False
        self._frames.append((time, math.log(normal), math.log(friction)))
        while self._frames[0][0] < time - settings.remembered_s:
            self._frames.popleft()
        ratio = friction / normal
        largest = math.exp(max(f - n for _, n, f in self._frames))
        # More is held than it slid at, or that was long ago.
        if ratio > self.slid_ratio / settings.slid_share or time - self._slid_at > settings.slid_s:
            self.slid_ratio = math.nan
        if ratio < settings.fallen_share * largest:
            self.follows = False
        elif not self.follows:
            self.follows = near and self._looks_like_sliding(time - settings.compared_s)
            self._began = (normal, ratio)
        elif normal > math.exp(settings.least_change) * self._began[0]:
            if ratio > settings.slid_share * self._began[1]:
                self.slid_ratio, self._slid_at = ratio, time
            self._began = (normal, ratio)
        return True

    def _looks_like_sliding(self, start: float) -> bool:
        """Return True if friction since `start` changed as the grip did, or rose without it."""
        settings = self._settings
        frames = [(n, f) for time, n, f in self._frames if time >= start - 1e-9]
        normals, frictions = [n for n, _ in frames], [f for _, f in frames]
        ratios = [f - n for n, f in frames]
        risen = min(ratios[-1] - min(ratios), frictions[-1] - min(frictions))
        if risen > settings.least_change:
            return True
        change = max(normals) - min(normals)
        if len(frames) < settings.fewest_frames or change < settings.least_change:
            return False
        return max(ratios) - min(ratios) <= settings.ratio_change * change
