"""Detection of sliding in addition to Γ: friction that follows the grip.

Friction of a held object equals the load, whatever the grip is. Friction of a sliding object is
µ times the grip. So a change of the grip distinguishes them, without a value of µ. At a constant
grip they look alike.
"""

import math
from collections import deque

#: Time over which friction and grip are compared [s].
COMPARED_S = 0.15
#: Time for which the largest ratio of friction to grip is remembered [s].
REMEMBERED_S = 0.5
#: Shortest time between frames that are compared [s]; faster cameras are thinned out.
SPACING_S = 0.009
#: Fewest frames that are compared.
FEWEST = 4
#: Smallest change of the grip that shows something, in its logarithm.
LEAST_CHANGE = 0.1
#: The ratio of friction to grip of an object that slides changes by no more than this share of the
#: grip's change. Friction that a controller follows with the grip leads it, and changes more.
RATIO_CHANGE = 0.3
#: A ratio below this share of the largest remembered one is held.
HELD_SHARE = 0.92
#: A ratio that stays above this share while the grip rises has slid.
SLID_SHARE = 0.95
#: Time for which that ratio is remembered [s].
SLID_S = 1.0


class FollowingFriction:
    """Compares friction with the grip, frame after frame.

    Attributes
    ----------
    follows: whether friction followed the grip, or rose to a share of it that was not seen before,
        since it last fell short of what it was
    slid_ratio: ΣFf/ΣFn at which it kept following a grip that rose; NaN where none is known
    """

    def __init__(self) -> None:
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
        if not (normal > 0.0 and friction > 0.0):
            self.reset()
            return False
        if self._frames and time - self._frames[-1][0] < SPACING_S:
            return False
        self._frames.append((time, math.log(normal), math.log(friction)))
        while self._frames[0][0] < time - REMEMBERED_S:
            self._frames.popleft()
        ratio = friction / normal
        largest = math.exp(max(f - n for _, n, f in self._frames))
        # More is held than it slid at, or that was long ago.
        if ratio > self.slid_ratio / SLID_SHARE or time - self._slid_at > SLID_S:
            self.slid_ratio = math.nan
        if ratio < HELD_SHARE * largest:
            self.follows = False
        elif not self.follows:
            self.follows = near and self._looks_like_sliding(time - COMPARED_S)
            self._began = (normal, ratio)
        elif normal > math.exp(LEAST_CHANGE) * self._began[0]:
            if ratio > SLID_SHARE * self._began[1]:
                self.slid_ratio, self._slid_at = ratio, time
            self._began = (normal, ratio)
        return True

    def _looks_like_sliding(self, start: float) -> bool:
        """Return True if friction since `start` changed as the grip did, or rose without it."""
        frames = [(n, f) for time, n, f in self._frames if time >= start - 1e-9]
        normals, frictions = [n for n, _ in frames], [f for _, f in frames]
        ratios = [f - n for n, f in frames]
        risen = min(ratios[-1] - min(ratios), frictions[-1] - min(frictions)) > LEAST_CHANGE
        if risen:
            return True
        if len(frames) < FEWEST or max(normals) - min(normals) < LEAST_CHANGE:
            return False
        return max(ratios) - min(ratios) <= RATIO_CHANGE * (max(normals) - min(normals))
