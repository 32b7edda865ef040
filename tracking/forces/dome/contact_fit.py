"""Least-squares fit of an object and its poses to the shifts of the markers.

The object and the poses of a few key frames are fitted together, over the whole path from rest
(`fit_keys`). Between key frames the object is fixed and only the pose is fitted (`follow`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ....errors import UserError
from ....model import Dome
from ....model.dome import PosedContact
from .contact_cost import ContactCost
from .contact_solution import Followed, Solution, tells_more
from .contact_state import (
    MOVING,
    OBJECT,
    limited_object,
    limited_pose,
    longest_of,
    moves_of,
    units_of,
)
from .contact_way import Changes, ContactWay
from .key_shifts import Explained, Key, Shifts
from .marker_response import DomeResponse
from .settings import ContactFitSettings

Array = NDArray[np.float64]

#: Indices of the last pose and the object among the unknowns of several key frames.
_LAST = np.r_[-MOVING:0, 0 : len(OBJECT)]


@dataclass(frozen=True, kw_only=True)
class _Point:
    """An object and its poses in a fit, with the contact and the shifts of all pairs in each."""

    object_: Array
    poses: Array
    contacts: list[PosedContact]
    seen: list[Array]
    cost: float


class ContactFit:
    """Fits contacts of one dome to shifts of its markers.

    Parameters
    ----------
    dome: body
    response: response of its markers to forces
    settings: tuned parameters
    """

    def __init__(
        self,
        dome: Dome,
        response: DomeResponse,
        settings: ContactFitSettings = ContactFitSettings(),
    ) -> None:
        self.dome, self._settings = dome, settings
        self.units = units_of(dome)
        self._response = response
        self._way = ContactWay(dome, settings.model)
        self._longest = longest_of(dome)
        self._cost = ContactCost(dome, settings)

    def fit_keys(
        self, object_: Array, keys: tuple[Key, ...], rounds: int, rival_of: Solution | None = None
    ) -> Solution:
        """Fit object and poses to key frames, starting from given ones.

        Parameters
        ----------
        rival_of: solution to beat; the fit ends early if that is unlikely

        Raises
        ------
        UserError
            When the contact does not converge.
        """
        settings = self._settings
        object_ = limited_object(self.dome, object_, settings.model)
        poses = limited_pose(self.dome, np.stack([key.pose for key in keys]), settings.model)
        shifts = [key.shifts for key in keys]
        damping = 1e-3
        at = self._point(object_, poses, shifts)
        explained, slopes, changes = self._explained(at, shifts)
        for turn in range(rounds):
            if rival_of is not None and turn >= settings.promising_rounds:
                information, gradient = self._cost.normal(explained, at.object_, at.poses)
                if at.cost - gradient @ np.linalg.solve(information, gradient) > rival_of.cost:
                    break
            better = self._better(at, explained, damping)
            if better is None:
                damping *= 10.0
                if damping > 1e3:
                    break
                continue
            gain, at = at.cost - better.cost, better
            damping = max(0.1 * damping, 1e-6)
            explained, slopes, changes = self._explained(at, shifts)
            if gain < settings.least_gain:
                break
        return self._solution(at.object_, at.poses, explained, at.contacts[-1], changes, slopes)

    def _better(self, at: "_Point", explained: list[Explained], damping: float) -> "_Point | None":
        """Best point after a damped step and its corrections; None if no point is better.

        The corrections have the same derivatives, as in Shamanskii's method. A soft object pressed
        deep shows almost the same shifts as a stiffer one pressed less: the cost has a narrow,
        bent valley, and single steps leave it before they have gone far.
        """
        shifts = [each.shifts for each in explained]
        best, there = at, at
        for _ in range(1 + self._settings.corrections):
            information, gradient = self._cost.normal(explained, there.object_, there.poses)
            damped = information + damping * np.diag(np.diag(information))
            step = np.asarray(np.linalg.solve(damped, gradient), np.float64)
            step *= min(1.0, 1.0 / self._length(step))
            tried = self._moved(there.object_, there.poses, step)
            try:
                after = self._point(*tried, shifts, there.contacts)
            except UserError:
                break
            first = there is at
            if not first and after.cost >= there.cost:
                break
            slow = there.cost - after.cost < self._settings.slow * (at.cost - after.cost)
            there = after
            if there.cost < best.cost:
                best = there
                if not first and slow:
                    break
            explained = _seen_as(explained, there.seen)
        return None if best is at else best

    def hold(self, last: Solution, keys: tuple[Key, ...], now: Followed) -> tuple[Solution, bool]:
        """Add a key frame with the same object; also return whether to refit the object.

        Poses, predicted shifts and derivatives of other key frames stay, even after an omitted one:
        the contact that was followed frame by frame knows the path better than key frames do.

        Parameters
        ----------
        keys: some of the solution's key frames, and the new one
        now: contact in the new one

        Raises
        ------
        UserError
            When the contact does not converge.
        """
        before = {id(each.shifts): each for each in last.explained}
        object_, poses = last.object_, np.stack([key.pose for key in keys])
        _, changes = self._way.step_and_changes(
            last.contact, last.changes, object_, last.keys[-1].pose, poses[-1], alike=now.contact
        )
        slopes = self._slopes(changes)
        new = _explained(keys[-1].shifts, now.seen, slopes)
        explained = [before.get(id(key.shifts), new) for key in keys]
        solution = self._solution(object_, poses, explained, now.contact, changes, slopes)
        information, gradient = self._cost.normal(explained, object_, poses)
        step = np.asarray(np.linalg.solve(information, gradient), np.float64)
        gain = float(gradient @ step)
        step = self.units * step[_LAST]
        tells = tells_more(solution, self.units, gain, step, self._settings)
        # The step that is not made adds to the uncertainty of the object.
        covariance = solution.covariance + np.outer(step, step)
        return replace(solution, covariance=covariance), tells

    def along_chord(self, held: Solution, doubtful: bool) -> Solution | None:
        """Do `fit_keys` near a solution, with the derivatives of that solution.

        None if the object changes too much for these derivatives. The path through key frames alone
        differs slightly from the one that was followed. If no object along it promises a better
        fit, the solution is returned unchanged.

        Parameters
        ----------
        doubtful: whether the misfit is so large that anything is tried

        Raises
        ------
        UserError
            When the contact does not converge.
        """
        settings = self._settings
        shifts = [key.shifts for key in held.keys]
        object_, poses = held.object_, np.stack([key.pose for key in held.keys])
        contacts, seen = self._predicted(object_, poses)
        explained = _seen_as(held.explained, seen)
        cost = self._cost.of([each.loss for each in explained], object_, poses)
        for _ in range(settings.chord_rounds):
            information, gradient = self._cost.normal(explained, object_, poses)
            step = np.asarray(np.linalg.solve(information, gradient), np.float64)
            if cost - gradient @ step > held.cost and not doubtful:
                return held
            tried = self._moved(object_, poses, step)
            moved = abs(tried[0] - held.object_) / self._longest[MOVING:]
            if self._length(step) > 1.0 or moved.max() > settings.chord_reach:
                return None
            reached, seen = self._predicted(*tried, contacts)
            after = self._cost.of(_losses(shifts, seen), *tried)
            if after > cost + settings.least_gain:
                return None
            gain, cost = cost - after, after
            (object_, poses), contacts = tried, reached
            explained = _seen_as(held.explained, seen)
            if gain < settings.least_gain:
                break
        return self._solution(object_, poses, explained, contacts[-1], held.changes, held.slopes)

    def _solution(
        self,
        object_: Array,
        poses: Array,
        explained: list[Explained],
        contact: PosedContact,
        changes: Changes,
        slopes: Array,
    ) -> Solution:
        information, _ = self._cost.normal(explained, object_, poses)
        misfit = sum(each.cost for each in explained)
        misfit /= sum(each.shifts.count for each in explained)
        inverse = np.linalg.inv(information)[np.ix_(_LAST, _LAST)]
        return Solution(
            object_=object_,
            keys=tuple(
                Key(shifts=each.shifts, pose=pose)
                for each, pose in zip(explained, poses, strict=True)
            ),
            explained=tuple(explained),
            slopes=slopes,
            contact=contact,
            changes=changes,
            covariance=max(1.0, misfit) * inverse * np.outer(self.units, self.units),
            cost=self._cost.of([each.loss for each in explained], object_, poses),
            misfit=misfit,
            odd_misfit=_odd_misfit(explained),
        )

    def last_of(self, solution: Solution) -> Followed:
        """Contact in the last key frame of a solution, from which the next frame is followed."""
        return Followed(
            contact=solution.contact,
            pose=solution.keys[-1].pose,
            seen=self._seen(solution.contact),
            slopes=solution.slopes[:MOVING],
        )

    def follow(self, object_: Array, last: Followed, shifts: Shifts) -> tuple[Followed, float]:
        """Fit the pose in the next frame with a fixed object; return the contact and its misfit.

        Derivatives of an earlier frame are used as long as they converge fast.

        Raises
        ------
        UserError
            When the contact does not converge.
        """
        settings = self._settings
        way, units = self._way, self.units[:MOVING]
        moving = tuple(range(MOVING))
        reached, pose, seen, slopes = last.contact, last.pose, last.seen, last.slopes
        whole = shifts.apply(slopes[:, shifts.used])
        before, fresh = math.inf, False
        for _ in range(settings.follow_steps):
            step, gain = self._pose_step(last.pose, pose, shifts, whole, seen)
            if gain > settings.slow * before and gain > settings.follow_gain and not fresh:
                reached, changes = way.step_and_changes(
                    last.contact, None, object_, last.pose, pose, moving, reached, solved=True
                )
                slopes, fresh = self._slopes(changes), True
                whole = shifts.apply(slopes[:, shifts.used])
                step, gain = self._pose_step(last.pose, pose, shifts, whole, seen)
            if gain < settings.follow_gain:
                break
            before = gain
            step *= min(1.0, 1.0 / float(abs(units * step / self._longest[:MOVING]).max()))
            pose = limited_pose(self.dome, pose + units * step, settings.model)
            reached = way.step(last.contact, object_, last.pose, pose, reached)
            seen = self._seen(reached)
        now = Followed(contact=reached, pose=pose, seen=seen, slopes=slopes)
        return now, shifts.cost(shifts.residual(seen)) / shifts.count

    def _pose_step(
        self, last: Array, pose: Array, shifts: Shifts, whole: Array, seen: Array
    ) -> tuple[Array, float]:
        """Step of a pose in its units, and its expected gain [squared standard deviations].

        Parameters
        ----------
        last: pose in the previous frame
        pose: present pose
        whole: derivatives of the whitened shifts of used pairs by the pose, shape (4, V·W)
        seen: predicted shifts of all pairs at the present pose, shape (P, 6)
        """
        units = self.units[:MOVING]
        known = (units / moves_of(self.dome, last, self._settings.model)) ** 2
        residual = shifts.residual(seen)
        weighted = whole * shifts.weights(residual)
        gradient = weighted @ residual + known * (last - pose) / units
        step = np.linalg.solve(weighted @ whole.T + np.diag(known), gradient)
        return np.asarray(step, np.float64), float(gradient @ step)

    def image(self, object_: Array, pose: Array) -> tuple[float, Array]:
        """Simulate a press from rest; return ΣFn [N] and the shifts of all P pairs, (P, 6)."""
        rest = np.zeros(MOVING)
        contact = self._way.step(self._way.untouched(object_), object_, rest, pose)
        return float(contact.normal.sum()), self._seen(contact)

    def _seen(self, contact: PosedContact) -> Array:
        """Predicted shifts of all pairs in a contact, (P, 6)."""
        return self._response(contact.nodes, contact.linear)

    def _slopes(self, changes: Changes) -> Array:
        """Derivatives of predicted shifts by each of C unknowns, per unit of it, (C, P, 6)."""
        return self._response.along(changes.contact.nodes, changes.linear)

    def _point(
        self,
        object_: Array,
        poses: Array,
        shifts: list[Shifts],
        alike: list[PosedContact] | None = None,
    ) -> "_Point":
        """Predict the key frames for an object and its poses, see `_predicted`."""
        contacts, seen = self._predicted(object_, poses, alike)
        cost = self._cost.of(_losses(shifts, seen), object_, poses)
        return _Point(object_=object_, poses=poses, contacts=contacts, seen=seen, cost=cost)

    def _predicted(
        self, object_: Array, poses: Array, alike: list[PosedContact] | None = None
    ) -> tuple[list[PosedContact], list[Array]]:
        """Simulate the contact in each key frame; also return the shifts of all pairs in it.

        Parameters
        ----------
        alike: similar contacts, as initial guesses
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

    def _explained(
        self, at: "_Point", shifts: list[Shifts]
    ) -> tuple[list[Explained], Array, Changes]:
        """Explain the key frames; also return derivatives (12, P, 6) and changes of the last."""
        contact, before = self._way.untouched(at.object_), np.zeros(MOVING)
        changes: Changes | None = None
        explained = []
        for frame, pose, reached, predicted in zip(
            shifts, at.poses, at.contacts, at.seen, strict=True
        ):
            contact, changes = self._way.step_and_changes(
                contact, changes, at.object_, before, pose, alike=reached, solved=True
            )
            before, slopes = pose, self._slopes(changes)
            explained.append(_explained(frame, predicted, slopes))
        assert changes is not None
        return explained, slopes, changes

    def _moved(self, object_: Array, poses: Array, step: Array) -> tuple[Array, Array]:
        """Add a step, in units of the unknowns, to object and poses, within their limits."""
        moved = object_ + self.units[MOVING:] * step[: len(OBJECT)]
        on = self.units[:MOVING] * step[len(OBJECT) :].reshape(-1, MOVING)
        dome, model = self.dome, self._settings.model
        return limited_object(dome, moved, model), limited_pose(dome, poses + on, model)

    def _length(self, step: Array) -> float:
        """Largest component of a step, relative to the longest allowed one."""
        share = self.units / self._longest
        on_object = abs(step[: len(OBJECT)] * share[MOVING:]).max()
        on_poses = abs(step[len(OBJECT) :].reshape(-1, MOVING) * share[:MOVING]).max()
        return float(max(on_object, on_poses))


def _explained(shifts: Shifts, predicted: Array, slopes: Array) -> Explained:
    whole = shifts.apply(slopes[:, shifts.used])
    return Explained(shifts=shifts, predicted=predicted, whole=whole)


def _seen_as(explained: Sequence[Explained], seen: list[Array]) -> list[Explained]:
    """Replace the predicted shifts of key frames, and keep their derivatives."""
    return [replace(each, predicted=new) for each, new in zip(explained, seen, strict=True)]


def _losses(shifts: list[Shifts], seen: list[Array]) -> list[float]:
    """Loss of each key frame for predicted shifts."""
    return [frame.loss(frame.residual(each)) for frame, each in zip(shifts, seen, strict=True)]


def _odd_misfit(explained: list[Explained]) -> float:
    """Median over the key frames in which enough pairs have moved; 0 if there is none."""
    each = [one.odd_misfit for one in explained if not math.isnan(one.odd_misfit)]
    return float(np.median(each)) if each else 0.0
