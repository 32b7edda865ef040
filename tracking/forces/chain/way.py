"""Search for the object of a contact that explains the way of the markers.

Candidates of several curvatures follow the contact from its first frames on. Where the sum of
squares near a candidate's constants has its minimum far off, it follows the way again with other
constants, a few frames at a time, and takes these if they explain it better.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ....errors import UserError
from .way_fit import Followed, Quadratic, WayFit, WayFrame

Array = NDArray[np.float64]


@dataclass(kw_only=True)
class Candidate:
    """Copies that have followed all frames, and their search for better constants.

    Attributes
    ----------
    now: these copies
    again: copies that follow the frames again with other constants, until they have caught up
    damping: share by which the information is increased for the next search
    wait: number of turns before the next search
    """

    now: Followed
    again: Followed | None = None
    damping: float = 0.0
    wait: int = 0


@dataclass(kw_only=True)
class Way:
    """Frames from the first touch on, and candidates for the object that explains them.

    Attributes
    ----------
    fit: what follows
    frames: frames so far
    candidates: the best first; none until there are enough frames for a start
    turn: number of searches so far
    begun: whether there were candidates
    """

    fit: WayFit
    frames: list[WayFrame] = field(default_factory=list)
    candidates: list[Candidate] = field(default_factory=list)
    turn: int = 0
    begun: bool = False

    @property
    def now(self) -> Followed | None:
        """Copies of the best candidate."""
        return self.candidates[0].now if self.candidates else None

    @property
    def weights(self) -> Array:
        """Weights of the frames: a light touch tells less of what happens under larger forces."""
        forces = np.array([0.0 if one.sums is None else one.sums[0] for one in self.frames])
        share = forces / (forces + self.fit.settings.light * max(forces.max(), 1e-6))
        return np.array([one.weight for one in self.frames]) * share**2

    def add(self, frame: WayFrame, friction: float = math.nan) -> None:
        """Follow a frame, and go on with the search.

        Parameters
        ----------
        friction: µ by another method, from which a search starts; NaN: unknown
        """
        settings = self.fit.settings
        kept = len(self.frames) < settings.most_frames
        if kept:
            self.frames.append(frame)
        if friction > 0.0:
            self.fit.believe(friction)
        if not self.begun:
            pressed = frame.sums is not None and frame.sums[0] > settings.first_force
            if len(self.frames) >= settings.first_frames and pressed:
                self._start(friction)
            return
        following = []
        for one in self.candidates:
            try:
                self.fit.advance(one.now, frame)
            except UserError:
                continue
            if not kept:
                one.now.forget_before_last()
            following.append(one)
        self.candidates = following
        self._sort()
        self.search()

    def _sort(self) -> None:
        """Put the best candidate first, and drop those that the markers rule out."""
        settings, weights = self.fit.settings, self.weights
        costs = [self.fit.costs(one.now, one.now.gram(weights))[0] for one in self.candidates]
        order = np.argsort(costs)
        limit = settings.ruled_out * min(costs, default=0.0) + settings.ruled_out_by
        many = len(self.frames) > settings.tried
        self.candidates = [self.candidates[k] for k in order if not (many and costs[k] > limit)]

    def search(self) -> None:
        """Go on with the search for better constants, of the best candidate in every other turn."""
        if not self.candidates:
            return
        self.turn += 1
        others = self.turn // 2 % len(self.candidates)
        one = self.candidates[0 if self.turn % 2 else others]
        budget = self.fit.settings.catch_up
        while budget > 0:
            budget = self._search(one, budget)
        self._sort()

    def quadratic(self) -> Quadratic:
        """Minimum of the sum of squares near the best constants."""
        assert self.now is not None
        return self.fit.quadratic(self.now, self.now.gram(self.weights))

    def cost(self) -> float:
        """Sum of squares of the best constants."""
        assert self.now is not None
        return max(float(self.fit.costs(self.now, self.now.gram(self.weights))[0]), 1e-9)

    def misfit(self) -> tuple[float, float]:
        """Weighted mean over the frames of the mean squared residual, and that of the last one."""
        assert self.now is not None
        each = np.array(self.now.misfits)
        return float(np.average(each, weights=self.weights + 1e-9)), float(each[-1])

    def _start(self, friction: float) -> None:
        """Follow the first frames with a candidate of each curvature."""
        settings, self.begun = self.fit.settings, True
        for curvature in settings.curvatures:
            best, constants = math.inf, None
            for stiffness in settings.stiffnesses:
                tried = np.array(settings.mean)
                tried[1:3] = curvature, math.log(stiffness)
                if friction > 0.0:
                    tried[0] = math.log(min(max(friction, 0.1), 1.5))
                way = self._followed(tried, 0.0)
                if way is None:
                    continue
                cost = float(self.fit.costs(way, way.gram(self.weights))[0])
                if cost < best:
                    best, constants = cost, tried
            way = None if constants is None else self._followed(constants, 1.0)
            if way is not None:
                self.candidates.append(Candidate(now=way))
        self._sort()

    def _followed(self, constants: Array, spread: float) -> Followed | None:
        """Copies around some constants that have followed all frames; None if they cannot."""
        way = self.fit.begin(constants, spread)
        try:
            for frame in self.frames:
                self.fit.advance(way, frame)
        except UserError:
            return None
        return way

    def _search(self, one: Candidate, budget: int) -> int:
        """Do a part of a search, of at most so many frames; return what is left of the budget."""
        fit, now, settings, weights = self.fit, one.now, self.fit.settings, self.weights
        gram = now.gram(weights)
        costs = fit.costs(now, gram)
        if one.again is None:
            if one.wait > 0 or len(self.frames) == settings.most_frames:
                one.wait -= 1
                return 0
            found = fit.quadratic(now, gram, one.damping)
            if not found.gain > settings.gain + settings.gain_share * costs[0]:
                if one.damping > 0.0:
                    one.damping, one.wait = 0.0, settings.patience
                return 0
            near = abs(found.step).max() < 1.5
            constants = fit.moved(now.constants[0], found.step)
            if one.damping > 0.0 and costs.min() < costs[0] - settings.gain:
                # A copy that is known to be better; a longer step was not.
                constants = now.constants[int(costs.argmin())]
            one.again = fit.begin(constants, settings.near if near else 1.0)
        again, failed = one.again, False
        before = np.cumsum(weights * [gram[0, 0] for gram in now.grams])
        try:
            while again.done < now.done and budget > 0 and not failed:
                fit.advance(again, self.frames[again.done])
                budget -= 1
                so_far = float(weights[: again.done] @ [gram[0, 0] for gram in again.grams])
                allowed = settings.worse * before[again.done - 1] + settings.slack * before[-1]
                failed = not again.alive[0] or so_far > allowed
        except UserError:
            failed = True
        if not failed and again.done < now.done:
            return 0
        if not failed and fit.costs(again, again.gram(weights))[0] < costs[0]:
            one.now, one.damping = again, one.damping / 4.0 if one.damping > 1.0 else 0.0
        else:
            one.damping = 4.0 * one.damping + 1.0
            if one.damping > settings.most_damping:
                one.damping, one.wait = 0.0, settings.patience
        one.again = None
        return budget
