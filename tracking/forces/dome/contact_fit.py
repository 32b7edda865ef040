"""Least squares on contacts: an object and its poses that explain the shifts of the markers.

The object and the poses of a few key frames are fitted together, over the whole way from rest
(`fit_keys`). Between key frames the object is held and the pose alone is followed (`follow`).
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ....errors import UserError
from ....model import Dome
from ....model.dome import PosedContact
from .contact_cost import ContactCost
from .contact_state import (
    FRICTION,
    MOVING,
    OBJECT,
    limited_object,
    limited_pose,
    longest_of,
    moves_of,
    units_of,
)
from .contact_way import Changes, ContactWay, sums_of
from .key_shifts import Key, Shifts
from .marker_response import DomeResponse

Array = NDArray[np.float64]

#: Smallest gain of a round, in squared deviations.
_GAIN = 0.3
#: Rounds of a rival after which it must promise to become better.
_PROMISING = 2
#: Rounds with the derivatives of a former solution, and how far the object may be from it: so many
#: of the longest steps.
_CHORDS, _NEAR = 3, 0.25
#: Changes for which no object is fitted anew: of ln ΣFn, ln µ and Γ, small beside what the silicone
#: and the friction law leave unsure; the same in their deviations; and the gain in squared
#: deviations, over the misfit and the number of key frames.
_LITTLE, _UNSURE, _TOLD = 0.003, 0.05, 50.0
#: Places of the last pose and the object among the unknowns of several key frames.
_LAST = np.r_[-MOVING:0, 0 : len(OBJECT)]
#: Most steps of a pose that is followed, the gain below which it stays as it is, in squared
#: deviations, and the share of the gain before above which slopes are made anew.
_STEPS, _STILL, _SLOW = 4, 0.03, 0.1


@dataclass(frozen=True, kw_only=True)
class Solution:
    """An object and its poses, that explain key frames.

    Attributes
    ----------
    object_: unknowns of the object, shape (8,)
    keys: with their poses
    slopes: of the shifts in each by the unknowns over their units, shapes (12, P, 6)
    predicted: shifts of all pairs in each, shapes (P, 6)
    contact: in the last of them
    changes: of it by each unknown
    covariance: of the pose in the last key frame and the object, shape (12, 12)
    cost: what a fit makes least
    misfit: mean square of what is left of the shifts, in deviations, odd pairs held down
    typical: median over pairs that have moved of what is left of their shifts, squared
    """

    object_: Array
    keys: tuple[Key, ...]
    slopes: tuple[Array, ...]
    predicted: tuple[Array, ...]
    contact: PosedContact
    changes: Changes
    covariance: Array
    cost: float
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
        self._cost = ContactCost(dome)

    def fit_keys(
        self, object_: Array, keys: tuple[Key, ...], rounds: int, rival_of: Solution | None = None
    ) -> Solution:
        """Object and poses that explain key frames best, near given ones.

        Parameters
        ----------
        rival_of: the fit ends early where it does not promise to become better than this one

        Raises
        ------
        UserError
            When the contact does not converge.
        """
        object_ = limited_object(self.dome, object_)
        poses = limited_pose(self.dome, np.stack([key.pose for key in keys]))
        shifts = [key.shifts for key in keys]
        damping = 1e-3
        contacts, changes, slopes, predicted = self._whole_way(object_, poses)
        cost = self._cost.of(shifts, object_, poses, predicted)
        information, gradient = self._cost.normal(shifts, object_, poses, predicted, slopes)
        known = math.inf if rival_of is None else rival_of.cost
        for turn in range(rounds):
            if (
                turn >= _PROMISING
                and cost - gradient @ np.linalg.solve(information, gradient) > known
            ):
                break
            damped = information + damping * np.diag(np.diag(information))
            step = np.asarray(np.linalg.solve(damped, gradient), np.float64)
            step *= min(1.0, 1.0 / self._length(step))
            tried = self._moved(object_, poses, step)
            try:
                reached, seen = self._predicted(*tried, contacts)
            except UserError:
                damping = max(10.0 * damping, 1e-2)
                continue
            after = self._cost.of(shifts, *tried, seen)
            if after >= cost:
                damping *= 10.0
                if damping > 1e3:
                    break
                continue
            gain, cost, (object_, poses) = cost - after, after, tried
            damping = max(0.1 * damping, 1e-6)
            contacts, changes, slopes, predicted = self._whole_way(object_, poses, reached)
            information, gradient = self._cost.normal(shifts, object_, poses, predicted, slopes)
            if gain < _GAIN:
                break
        return self._solution(object_, poses, shifts, contacts[-1], changes, slopes, predicted)

    def hold(self, last: Solution, keys: tuple[Key, ...], now: Followed) -> tuple[Solution, bool]:
        """A solution with one more key frame and the same object, and whether that tells more.

        Poses, shifts and slopes of the other key frames stay as they are, also those after one that
        is left out: what has been followed knows the way better than key frames do.

        Parameters
        ----------
        keys: some of those of the solution, and the new one
        now: the contact in the new one

        Raises
        ------
        UserError
            When the contact does not converge.
        """
        known = {
            id(key.shifts): each
            for key, *each in zip(last.keys, last.slopes, last.predicted, strict=True)
        }
        shifts = [key.shifts for key in keys]
        object_, poses = last.object_, np.stack([key.pose for key in keys])
        _, changes = self._way.step_and_changes(
            last.contact, last.changes, object_, last.keys[-1].pose, poses[-1]
        )
        new = [self._slopes(changes), now.seen]
        slopes, predicted = map(list, zip(*(known.get(id(s), new) for s in shifts), strict=True))
        held = self._solution(object_, poses, shifts, now.contact, changes, slopes, predicted)
        information, gradient = self._cost.normal(shifts, object_, poses, predicted, slopes)
        step = np.asarray(np.linalg.solve(information, gradient), np.float64)
        gain = float(gradient @ step)
        step = self.units * step[_LAST]
        tells = self._tells(held, gain, step)
        # What the object is held against is unsure, too.
        return replace(held, covariance=held.covariance + np.outer(step, step)), tells

    def _tells(self, held: Solution, gain: float, step: Array) -> bool:
        """Whether a step of the last pose and the object changes what is told in the last frame.

        Parameters
        ----------
        gain: of that step in all key frames, in squared deviations
        """
        sums, mu = sums_of(held.changes.contact), math.exp(held.object_[FRICTION])
        slopes = np.zeros((3, MOVING + len(OBJECT)))  # of ln ΣFn, ln µ and Γ
        normal, across = (sums_of(held.changes.changed) - sums).T / max(float(sums[0]), 1e-12)
        slopes[0], slopes[1, MOVING + FRICTION] = normal / self.units, 1.0
        share = float(sums[1]) / max(mu * float(sums[0]), 1e-12)
        slopes[2] = share * (slopes[0] + slopes[1]) - across / (mu * self.units)
        known = np.sqrt(np.diag(slopes @ held.covariance @ slopes.T))
        much = abs(slopes @ step) > np.maximum(_UNSURE * known, _LITTLE)
        return bool(much.any()) or gain > _TOLD * held.misfit * len(held.keys)

    def along_chord(self, held: Solution) -> Solution | None:
        """As `fit_keys` near a solution, with its derivatives.

        None is where the object becomes another one, so that they no longer hold.

        Raises
        ------
        UserError
            When the contact does not converge.
        """
        shifts, slopes = [key.shifts for key in held.keys], list(held.slopes)
        object_, poses = held.object_, np.stack([key.pose for key in held.keys])
        contacts, predicted = self._predicted(object_, poses)
        cost = self._cost.of(shifts, object_, poses, predicted)
        for _ in range(_CHORDS):
            information, gradient = self._cost.normal(shifts, object_, poses, predicted, slopes)
            step = np.asarray(np.linalg.solve(information, gradient), np.float64)
            tried = self._moved(object_, poses, step)
            moved = abs(tried[0] - held.object_) / self._longest[MOVING:]
            if self._length(step) > 1.0 or moved.max() > _NEAR:
                return None
            reached, seen = self._predicted(*tried, contacts)
            after = self._cost.of(shifts, *tried, seen)
            if after > cost + _GAIN:
                return None
            gain, cost = cost - after, after
            (object_, poses), contacts, predicted = tried, reached, seen
            if gain < _GAIN:
                break
        return self._solution(object_, poses, shifts, contacts[-1], held.changes, slopes, predicted)

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
        information, _ = self._cost.normal(shifts, object_, poses, predicted, slopes)
        misfit = sum(s.cost(p) for s, p in zip(shifts, predicted, strict=True))
        misfit /= sum(s.count for s in shifts)
        typical = [s.typical(p) for s, p in zip(shifts, predicted, strict=True)]
        inverse = np.linalg.inv(information)[np.ix_(_LAST, _LAST)]
        return Solution(
            object_=object_,
            keys=tuple(Key(shifts=s, pose=p) for s, p in zip(shifts, poses, strict=True)),
            slopes=tuple(slopes),
            predicted=tuple(predicted),
            contact=contact,
            changes=changes,
            covariance=max(1.0, misfit) * inverse * np.outer(self.units, self.units),
            cost=self._cost.of(shifts, object_, poses, predicted),
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
                    last.contact, None, object_, last.pose, pose, moving, reached
                )
                slopes, fresh = self._slopes(changes), True
                whole = shifts.apply(slopes[:, shifts.used])
                step, gain = self._pose_step(last.pose, pose, shifts, whole, seen)
            if gain < _STILL:
                break
            before = gain
            step *= min(1.0, 1.0 / float(abs(units * step / self._longest[:MOVING]).max()))
            pose = limited_pose(self.dome, pose + units * step)
            reached = way.step(last.contact, object_, last.pose, pose, reached)
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

    def _predicted(
        self, object_: Array, poses: Array, alike: list[PosedContact] | None = None
    ) -> tuple[list[PosedContact], list[Array]]:
        """Contact in each key frame, and shifts of all pairs in it.

        Parameters
        ----------
        alike: contacts near those
        """
        contact, before = self._way.untouched(object_), np.zeros(MOVING)
        contacts, seen = [], []
        for k, pose in enumerate(poses):
            near = alike[k] if alike else None
            contact = self._way.step(contact, object_, before, pose, near)
            before = pose
            contacts.append(contact)
            seen.append(self._seen(contact))
        return contacts, seen

    def _whole_way(
        self, object_: Array, poses: Array, alike: list[PosedContact] | None = None
    ) -> tuple[list[PosedContact], Changes, list[Array], list[Array]]:
        """Contact, slopes (12, P, 6) and shifts (P, 6) in each key frame; changes of the last."""
        contact, before = self._way.untouched(object_), np.zeros(MOVING)
        changes: Changes | None = None
        contacts, slopes, predicted = [], [], []
        for k, pose in enumerate(poses):
            near = alike[k] if alike else None
            contact, changes = self._way.step_and_changes(
                contact, changes, object_, before, pose, alike=near
            )
            before = pose
            contacts.append(contact)
            slopes.append(self._slopes(changes))
            predicted.append(self._seen(contact))
        assert changes is not None
        return contacts, changes, slopes, predicted

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
