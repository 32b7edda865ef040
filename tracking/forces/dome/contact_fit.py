"""Least squares on contacts: an object and its poses that explain the shifts of the markers.

The object and the poses of a few key frames are fitted together, over the whole way from rest
(`fit_keys`). Between key frames the object is held and the pose alone is followed (`follow`).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....errors import UserError
from ....model import Dome
from ....model.dome import PosedContact
from .contact_state import (
    CURVES,
    HOLLOW,
    MOVING,
    OBJECT,
    limited_object,
    limited_pose,
    longest_of,
    moves_of,
    prior_of,
    units_of,
)
from .contact_way import Changes, ContactWay
from .marker_response import DomeResponse

Array = NDArray[np.float64]

#: Root mean square of a pair's residuals in deviations at which it counts half in a fit, …
_ODD = 1.5
#: … and from which on it counts less in a misfit.
_OFF = 2.0
#: Mean square of a pair's shifts in deviations above which it has moved, and how many are not few.
_MOVED, _SEVERAL = 25.0, 12
#: Key frames count as so many independent ones at most: errors of the model are alike in all.
INDEPENDENT = 3.0
#: Smallest gain of a round, in squared deviations.
_GAIN = 0.3
#: Rounds with the derivatives of a former solution, and how far the object may be from it: so many
#: of the longest steps.
_CHORDS, _NEAR = 3, 0.25
#: Most steps of a pose that is followed, the gain below which it stays as it is, in squared
#: deviations, and the share of the gain before above which slopes are made anew.
_STEPS, _STILL, _SLOW = 4, 0.03, 0.1


@dataclass(frozen=True, kw_only=True)
class Shifts:
    """Shifts of the pairs of a frame, V of them, whitened as they are compared.

    Attributes
    ----------
    values: (x, y, log size) of both layers, shape (V, 6)
    whiten: of each pair, to W independent values, shape (V, W, 6)
    used: which of all pairs they are, shape (P,)
    """

    values: Array
    whiten: Array
    used: NDArray[np.bool_]

    def apply(self, shifts: Array) -> Array:
        """Whitened shifts (…, V, 6) as one vector, shape (…, V·W)."""
        return np.einsum("vij,...vj->...vi", self.whiten, shifts).reshape(*shifts.shape[:-2], -1)

    def residual(self, predicted: Array) -> Array:
        """What is left of the shifts (…, P, 6) in deviations, shape (…, V·W)."""
        return self.apply(self.values - predicted[..., self.used, :])

    def weights(self, residual: Array) -> Array:
        """Weight of every value: the less, the worse its pair is explained (Cauchy's)."""
        return 1.0 / (1.0 + self._each(residual) / _ODD**2)

    def loss(self, predicted: Array) -> float:
        """What a fit makes least: of pairs that nothing explains it hardly grows (Cauchy's)."""
        each = self._each(self.residual(predicted))
        return float(_ODD**2 * np.log1p(each / _ODD**2).sum())

    def cost(self, predicted: Array) -> float:
        """Sum of squares of the residual, of which odd pairs' parts grow linearly (Huber's)."""
        size = np.sqrt(self._each(self.residual(predicted)))
        share = np.minimum(1.0, _OFF / np.maximum(size, _OFF))
        return float((share * (2.0 - share) * size**2).sum())

    def typical(self, predicted: Array) -> float:
        """Median of what is left of the pairs that have moved, in squared deviations.

        It is 0 where these are few.
        """
        pairs = len(self.whiten)
        moved = (self.apply(self.values).reshape(pairs, -1) ** 2).mean(axis=1) > _MOVED
        left = (self.residual(predicted).reshape(pairs, -1) ** 2).mean(axis=1)
        return float(np.median(left[moved])) if moved.sum() >= _SEVERAL else 0.0

    def _each(self, residual: Array) -> Array:
        """Mean square of its pair's residual for every value, shape (V·W,)."""
        each = residual.reshape(len(self.whiten), -1)
        return np.repeat((each**2).mean(axis=1), each.shape[1])

    @property
    def count(self) -> int:
        """How many independent values there are."""
        return max(self.whiten.shape[0] * self.whiten.shape[1], 1)


@dataclass(frozen=True, kw_only=True)
class Key:
    """A key frame: its shifts, and the pose in it, shape (4,)."""

    shifts: Shifts
    pose: Array


@dataclass(frozen=True, kw_only=True)
class Solution:
    """An object and its poses, that explain key frames.

    Attributes
    ----------
    object_: unknowns of the object, shape (8,)
    keys: with their poses
    slopes: of the shifts in each by the unknowns over their units, shapes (12, P, 6)
    contact: in the last of them
    changes: of it by each unknown
    covariance: of the pose in the last key frame and the object, shape (12, 12)
    misfit: mean square of what is left of the shifts, in deviations, odd pairs held down
    typical: median over pairs that have moved of what is left of their shifts, squared
    """

    object_: Array
    keys: tuple[Key, ...]
    slopes: tuple[Array, ...]
    contact: PosedContact
    changes: Changes
    covariance: Array
    misfit: float
    typical: float


@dataclass(frozen=True, kw_only=True)
class Followed:
    """A contact that is followed with its object held.

    Attributes
    ----------
    contact, pose: in the last frame
    seen: shifts of all pairs in it, shape (P, 6)
    slopes: of the shifts by the pose over its units, in that frame or a frame before, (4, P, 6)
    """

    contact: PosedContact
    pose: Array
    seen: Array
    slopes: Array


class ContactFit:
    """Fits contacts of one dome to shifts of its markers.

    Parameters
    ----------
    dome: body
    response: of its markers
    """

    def __init__(self, dome: Dome, response: DomeResponse) -> None:
        self.dome = dome
        self.units = units_of(dome)
        self._response = response
        self._way = ContactWay(dome)
        self._longest = longest_of(dome)
        self._prior = prior_of(dome)
        self._hollow = HOLLOW / dome.radius

    def fit_keys(self, object_: Array, keys: tuple[Key, ...], rounds: int) -> Solution:
        """Object and poses that explain key frames best, near given ones.

        Raises
        ------
        UserError
            When the contact does not converge.
        """
        object_ = limited_object(self.dome, object_)
        poses = limited_pose(self.dome, np.stack([key.pose for key in keys]))
        shifts = [key.shifts for key in keys]
        damping = 1e-3
        contact, changes, slopes, predicted = self._whole_way(object_, poses)
        cost = self._cost(shifts, object_, poses, predicted)
        information, gradient = self._normal(shifts, object_, poses, predicted, slopes)
        for _ in range(rounds):
            damped = information + damping * np.diag(np.diag(information))
            step = np.asarray(np.linalg.solve(damped, gradient), np.float64)
            step *= min(1.0, 1.0 / self._length(step))
            tried = self._moved(object_, poses, step)
            try:
                _, seen = self._predicted(*tried)
            except UserError:
                damping = max(10.0 * damping, 1e-2)
                continue
            after = self._cost(shifts, *tried, seen)
            if after >= cost:
                damping *= 10.0
                if damping > 1e3:
                    break
                continue
            gain, cost, (object_, poses) = cost - after, after, tried
            damping = max(0.1 * damping, 1e-6)
            contact, changes, slopes, predicted = self._whole_way(object_, poses)
            information, gradient = self._normal(shifts, object_, poses, predicted, slopes)
            if gain < _GAIN:
                break
        return self._solution(object_, poses, shifts, contact, changes, slopes, predicted)

    def add_key(self, last: Solution, keys: tuple[Key, ...]) -> Solution | None:
        """As `fit_keys` near a solution, of which only the last key frame is new.

        The derivatives of the other key frames are those of the solution. None is where the object
        becomes another one, so that they no longer hold.

        Raises
        ------
        UserError
            When the contact does not converge.
        """
        known = {id(key.shifts): slope for key, slope in zip(last.keys, last.slopes, strict=True)}
        slopes = [known[id(key.shifts)] for key in keys[:-1]]
        shifts = [key.shifts for key in keys]
        object_, poses = last.object_, np.stack([key.pose for key in keys])
        contact, predicted = self._predicted(object_, poses[:-1])
        reached, changes = self._way.step_and_changes(
            contact, last.changes, object_, poses[-2], poses[-1]
        )
        slopes.append(self._slopes(changes))
        predicted.append(self._seen(reached))
        cost = self._cost(shifts, object_, poses, predicted)
        for _ in range(_CHORDS):
            information, gradient = self._normal(shifts, object_, poses, predicted, slopes)
            step = np.asarray(np.linalg.solve(information, gradient), np.float64)
            tried = self._moved(object_, poses, step)
            moved = abs(tried[0] - last.object_) / self._longest[MOVING:]
            if self._length(step) > 1.0 or moved.max() > _NEAR:
                return None
            contact, seen = self._predicted(*tried)
            after = self._cost(shifts, *tried, seen)
            if after > cost + _GAIN:
                return None
            gain, cost = cost - after, after
            (object_, poses), reached, predicted = tried, contact, seen
            if gain < _GAIN:
                break
        return self._solution(object_, poses, shifts, reached, changes, slopes, predicted)

    def _solution(
        self,
        object_: Array,
        poses: Array,
        shifts: list[Shifts],
        contact: PosedContact,
        changes: Changes,
        slopes: list[Array],
        predicted: list[Array],
    ) -> Solution:
        information, _ = self._normal(shifts, object_, poses, predicted, slopes)
        misfit = sum(s.cost(p) for s, p in zip(shifts, predicted, strict=True))
        misfit /= sum(s.count for s in shifts)
        typical = [s.typical(p) for s, p in zip(shifts, predicted, strict=True)]
        places = np.r_[-MOVING:0, 0 : len(OBJECT)]  # the last pose, then the object
        inverse = np.linalg.inv(information)[np.ix_(places, places)]
        return Solution(
            object_=object_,
            keys=tuple(Key(shifts=s, pose=p) for s, p in zip(shifts, poses, strict=True)),
            slopes=tuple(slopes),
            contact=contact,
            changes=changes,
            covariance=max(1.0, misfit) * inverse * np.outer(self.units, self.units),
            misfit=misfit,
            typical=float(np.median(typical)),
        )

    def last_of(self, solution: Solution) -> Followed:
        """The last key frame of a solution, from which the next frame is followed."""
        return Followed(
            contact=solution.contact,
            pose=solution.keys[-1].pose,
            seen=self._seen(solution.contact),
            slopes=solution.slopes[-1][:MOVING],
        )

    def follow(self, object_: Array, last: Followed, shifts: Shifts) -> tuple[Followed, float]:
        """Contact and pose in the next frame, with the object held, and the misfit.

        Slopes of a frame before serve for as long as they lead fast to the pose.

        Raises
        ------
        UserError
            When the contact does not converge.
        """
        way, units = self._way, self.units[:MOVING]
        moving = tuple(range(MOVING))
        reached, pose, seen, slopes = last.contact, last.pose, last.seen, last.slopes
        whole = shifts.apply(slopes[:, shifts.used])
        before, fresh = math.inf, False
        for _ in range(_STEPS):
            step, gain = self._pose_step(last.pose, pose, shifts, whole, seen)
            if gain > _SLOW * before and gain > _STILL and not fresh:
                reached, changes = way.step_and_changes(
                    last.contact, None, object_, last.pose, pose, moving
                )
                slopes, fresh = self._slopes(changes), True
                whole = shifts.apply(slopes[:, shifts.used])
                step, gain = self._pose_step(last.pose, pose, shifts, whole, seen)
            if gain < _STILL:
                break
            before = gain
            step *= min(1.0, 1.0 / float(abs(units * step / self._longest[:MOVING]).max()))
            pose = limited_pose(self.dome, pose + units * step)
            reached = way.step(last.contact, object_, last.pose, pose)
            seen = self._seen(reached)
        now = Followed(contact=reached, pose=pose, seen=seen, slopes=slopes)
        return now, shifts.cost(seen) / shifts.count

    def _pose_step(
        self, last: Array, pose: Array, shifts: Shifts, whole: Array, seen: Array
    ) -> tuple[Array, float]:
        """Step of a pose over its units, and what it should gain in squared deviations.

        Parameters
        ----------
        last: pose in the frame before
        pose: that shows the shifts `seen`
        whole: slopes of the used pairs there in deviations, shape (4, V·W)
        """
        units = self.units[:MOVING]
        known = (units / moves_of(self.dome, last)) ** 2
        residual = shifts.residual(seen)
        weighted = whole * shifts.weights(residual)
        gradient = weighted @ residual + known * (last - pose) / units
        step = np.linalg.solve(weighted @ whole.T + np.diag(known), gradient)
        return np.asarray(step, np.float64), float(gradient @ step)

    def image(self, object_: Array, pose: Array) -> tuple[float, Array]:
        """ΣFn [N] and shifts of all pairs in a contact that is pressed from rest, (P, 6)."""
        rest = np.zeros(MOVING)
        contact = self._way.step(self._way.untouched(object_), object_, rest, pose)
        return float(contact.normal.sum()), self._seen(contact)

    def _seen(self, contact: PosedContact) -> Array:
        """Shifts of all pairs in a contact, (P, 6)."""
        return self._response(contact.nodes, contact.linear)

    def _slopes(self, changes: Changes) -> Array:
        """What each unknown changes of them over its unit, (C, P, 6)."""
        return self._response.along(changes.contact.nodes, changes.linear)

    def _predicted(self, object_: Array, poses: Array) -> tuple[PosedContact, list[Array]]:
        """Contact in the last key frame, and shifts of all pairs in each."""
        contact, before, out = self._way.untouched(object_), np.zeros(MOVING), []
        for pose in poses:
            contact = self._way.step(contact, object_, before, pose)
            before = pose
            out.append(self._seen(contact))
        return contact, out

    def _whole_way(
        self, object_: Array, poses: Array
    ) -> tuple[PosedContact, Changes, list[Array], list[Array]]:
        """Last contact and its changes; slopes (12, P, 6) and shifts (P, 6) in each key frame."""
        contact, before = self._way.untouched(object_), np.zeros(MOVING)
        changes: Changes | None = None
        slopes, predicted = [], []
        for pose in poses:
            contact, changes = self._way.step_and_changes(contact, changes, object_, before, pose)
            before = pose
            slopes.append(self._slopes(changes))
            predicted.append(self._seen(contact))
        assert changes is not None
        return contact, changes, slopes, predicted

    def _moved(self, object_: Array, poses: Array, step: Array) -> tuple[Array, Array]:
        moved = object_ + self.units[MOVING:] * step[: len(OBJECT)]
        on = self.units[:MOVING] * step[len(OBJECT) :].reshape(-1, MOVING)
        return limited_object(self.dome, moved), limited_pose(self.dome, poses + on)

    def _length(self, step: Array) -> float:
        """Largest part of a step over the longest one."""
        share = self.units / self._longest
        on_object = abs(step[: len(OBJECT)] * share[MOVING:]).max()
        on_poses = abs(step[len(OBJECT) :].reshape(-1, MOVING) * share[:MOVING]).max()
        return float(max(on_object, on_poses))

    def _share(self, keys: int) -> float:
        return min(1.0, INDEPENDENT / keys)

    def _cost(
        self, shifts: list[Shifts], object_: Array, poses: Array, predicted: list[Array]
    ) -> float:
        seen = sum(s.loss(p) for s, p in zip(shifts, predicted, strict=True))
        off = (object_ - self._prior.mean) / self._prior.deviation
        hollow = np.minimum(object_[CURVES], 0.0)[:2] / self._hollow
        moves = np.diff(poses, axis=0, prepend=0.0) / moves_of(self.dome, poses)
        known = float(off @ off + hollow @ hollow)
        return self._share(len(shifts)) * seen + known + float((moves**2).sum())

    def _normal(
        self,
        shifts: list[Shifts],
        object_: Array,
        poses: Array,
        predicted: list[Array],
        slopes: list[Array],
    ) -> tuple[Array, Array]:
        """Information and gradient of the object, then of each pose, over their units."""
        first = len(OBJECT)
        size = first + MOVING * len(poses)
        information, gradient = np.zeros((size, size)), np.zeros(size)
        share = self._share(len(shifts))
        for k, (frame, seen, slope) in enumerate(zip(shifts, predicted, slopes, strict=True)):
            own = np.r_[first + MOVING * k : first + MOVING * (k + 1), 0:first]
            whole = frame.apply(slope[:, frame.used])
            residual = frame.residual(seen)
            weighted = share * whole * frame.weights(residual)
            information[np.ix_(own, own)] += weighted @ whole.T
            gradient[own] += weighted @ residual
        known = (self.units[MOVING:] / self._prior.deviation) ** 2
        information[:first, :first] += np.diag(known)
        gradient[:first] += known * (self._prior.mean - object_) / self.units[MOVING:]
        hollow = np.flatnonzero(object_[CURVES][:2] < 0.0) + CURVES.start
        units = self.units[MOVING:][hollow]
        information[hollow, hollow] += (units / self._hollow) ** 2
        gradient[hollow] -= units * object_[hollow] / self._hollow**2
        # Each pose is near the one before, the first one near rest.
        each = (self.units[:MOVING] / moves_of(self.dome, poses)) ** 2
        moves = np.diff(poses, axis=0, prepend=0.0) / self.units[:MOVING]
        for k, (move, known) in enumerate(zip(moves, each, strict=True)):
            own = np.arange(first + MOVING * k, first + MOVING * (k + 1))
            information[own, own] += known
            gradient[own] -= known * move
            if k:
                information[own - MOVING, own - MOVING] += known
                information[own, own - MOVING] -= known
                information[own - MOVING, own] -= known
                gradient[own - MOVING] += known * move
        return information, gradient
