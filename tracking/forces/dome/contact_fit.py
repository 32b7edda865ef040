"""Least-squares fit of an object and its poses to the shifts of the markers.

The object and the poses of a few key frames are fitted together, over the whole path from rest
(`Fitting`). Between key frames the object is fixed and only the pose is fitted (`follow`).
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ....errors import UserError
from ....model import Dome
from ....model.dome import PosedContact
from .contact_cost import ContactCost
from .contact_solution import Followed, Held, Solution, tells_more
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
from .fitting import Fitting, Slopes
from .key_shifts import Explained, Key, Shifts
from .marker_response import DomeResponse
from .settings import ContactFitSettings

Array = NDArray[np.float64]

#: Indices of the last pose and the object among the unknowns of several key frames.
_LAST = np.r_[-MOVING:0, 0 : len(OBJECT)]


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

    def begun(
        self, object_: Array, keys: tuple[Key, ...], rounds: int, rival_of: Solution | None = None
    ) -> Fitting:
        """Begin to fit object and poses to key frames, starting from given ones.

        Parameters
        ----------
        rival_of: solution to beat; the fit ends early if that is unlikely
        """
        model = self._settings.model
        object_ = limited_object(self.dome, object_, model)
        poses = limited_pose(self.dome, np.stack([key.pose for key in keys]), model)
        return Fitting(
            shifts=tuple(key.shifts for key in keys),
            object_=object_,
            poses=poses,
            tried=(object_, poses),
            rounds=rounds,
            known=math.inf if rival_of is None else rival_of.cost,
        )

    def advanced(self, fitting: Fitting) -> Fitting:
        """Simulate the next key frame of a fit, or its derivatives.

        Raises
        ------
        UserError
            When the contact does not converge.
        """
        return self._told(fitting) if fitting.telling else self._simulated(fitting)

    def solution_of(self, fitting: Fitting) -> Solution:
        """Solution of a fit that has ended."""
        slopes = fitting.slopes
        assert slopes is not None
        return self._solution(
            fitting.object_,
            fitting.poses,
            list(slopes.explained),
            fitting.contacts[-1],
            slopes.changes,
        )

    def fit_keys(
        self, object_: Array, keys: tuple[Key, ...], rounds: int, rival_of: Solution | None = None
    ) -> Solution:
        """Fit object and poses to key frames at once, see `begun`.

        Raises
        ------
        UserError
            When the contact does not converge.
        """
        fitting = self.begun(object_, keys, rounds, rival_of)
        while not fitting.done:
            fitting = self.advanced(fitting)
        return self.solution_of(fitting)

    def _simulated(self, fitting: Fitting) -> Fitting:
        """Simulate the next key frame of the tried unknowns."""
        (object_, poses), k = fitting.tried, len(fitting.reached)
        contact = fitting.reached[-1] if k else self._way.untouched(object_)
        before = poses[k - 1] if k else np.zeros(MOVING)
        near = fitting.contacts[k] if fitting.contacts else None
        try:
            contact = self._way.step(contact, object_, before, poses[k], near)
        except UserError:
            if not fitting.contacts:
                raise
            return self._next(replace(fitting, damping=max(10.0 * fitting.damping, 1e-2)))
        reached, seen = (*fitting.reached, contact), (*fitting.seen, self._seen(contact))
        fitting = replace(fitting, reached=reached, seen=seen)
        return fitting if len(reached) < len(fitting.shifts) else self._judged(fitting)

    def _judged(self, fitting: Fitting) -> Fitting:
        """Take the tried unknowns if they are better, or try a shorter step."""
        after = self._cost.of(_losses(fitting.shifts, fitting.seen), *fitting.tried)
        damping = fitting.damping
        if fitting.contacts:
            if after >= fitting.cost:
                fitting = replace(fitting, damping=10.0 * damping)
                too_short = fitting.damping > 1e3
                return replace(fitting, done=True) if too_short else self._next(fitting)
            damping = max(0.1 * damping, 1e-6)
        return replace(
            fitting,
            object_=fitting.tried[0],
            poses=fitting.tried[1],
            damping=damping,
            gain=fitting.cost - after,
            cost=after,
            contacts=fitting.reached,
            telling=True,
            told=(),
            last=None,
        )

    def _told(self, fitting: Fitting) -> Fitting:
        """Make the derivatives in the next key frame."""
        object_, poses, k = fitting.object_, fitting.poses, len(fitting.told)
        before = poses[k - 1] if k else np.zeros(MOVING)
        contact, changes = self._way.untouched(object_), None
        if fitting.last is not None:
            contact, changes = fitting.last
        contact, after = self._way.step_and_changes(
            contact, changes, object_, before, poses[k], alike=fitting.contacts[k], solved=True
        )
        slopes = self._slopes(after)
        told = (
            *fitting.told,
            Explained(shifts=fitting.shifts[k], predicted=fitting.seen[k], slopes=slopes),
        )
        if len(told) < len(fitting.shifts):
            return replace(fitting, told=told, last=(contact, after))
        return self._with_slopes(replace(fitting, last=None), told, after)

    def _with_slopes(
        self, fitting: Fitting, explained: tuple[Explained, ...], changes: Changes
    ) -> Fitting:
        """Go on with derivatives at the best unknowns; end if the last round gained little."""
        information, gradient = self._cost.normal(explained, fitting.object_, fitting.poses)
        slopes = Slopes(
            explained=explained,
            changes=changes,
            information=information,
            gradient=gradient,
        )
        fitting, done = replace(fitting, slopes=slopes), fitting.gain < self._settings.least_gain
        return replace(fitting, done=True) if done else self._next(fitting)

    def _next(self, fitting: Fitting) -> Fitting:
        """Begin the next round, or end."""
        settings, slopes = self._settings, fitting.slopes
        assert slopes is not None
        information, gradient = slopes.information, slopes.gradient
        done = fitting.turn >= fitting.rounds
        if not done and fitting.turn >= settings.promising_rounds:
            promised = fitting.cost - float(gradient @ np.linalg.solve(information, gradient))
            done = promised > fitting.known
        if done:
            return replace(fitting, done=True)
        damped = information + fitting.damping * np.diag(np.diag(information))
        step = np.asarray(np.linalg.solve(damped, gradient), np.float64)
        step *= min(1.0, 1.0 / self._length(step))
        return fitting.trying(*self._moved(fitting.object_, fitting.poses, step))

    def hold(self, last: Solution, keys: tuple[Key, ...], now: Followed) -> Held:
        """Add a key frame with the same object.

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
        new = Explained(shifts=keys[-1].shifts, predicted=now.seen, slopes=slopes)
        explained = [before.get(id(key.shifts), new) for key in keys]
        solution = self._solution(object_, poses, explained, now.contact, changes)
        return self.asked(last, solution)

    def asked(self, before: Solution, solution: Solution) -> Held:
        """Change of a solution that its key frames ask for; it adds to the uncertainty till then.

        Parameters
        ----------
        before: solution before its last key frame
        """
        step = self.units * solution.step[_LAST]
        telling = tells_more(solution, self.units, step, self._settings)
        covariance = solution.covariance + np.outer(step, step)
        solution = replace(solution, covariance=covariance)
        return Held(before=before, solution=solution, telling=telling)

    def leap(self, what: Held) -> Solution | None:
        """Change object and poses without going the whole way again; None if that does not help.

        The key frames before the last one change to first order. The contact in the last one is
        solved again, from that in the key frame before, changed to first order.

        Raises
        ------
        UserError
            When the contact does not converge.
        """
        last, held = what.before, what.solution
        step = held.step * min(1.0, self._settings.longest_leap / self._length(held.step))
        poses = np.stack([key.pose for key in held.keys])
        object_, after = self._moved(held.object_, poses, step)
        # What the limits of object and poses have left of it, in units: (K, 12).
        own = (object_ - held.object_) / self.units[MOVING:]
        by = np.column_stack([(after - poses) / self.units[:MOVING], np.tile(own, (len(poses), 1))])
        start = last.keys[-1].pose
        if len(poses) > 1 and held.keys[-2].shifts is last.keys[-1].shifts:
            start = after[-2]
        first = np.concatenate([start - last.keys[-1].pose, object_ - last.object_]) / self.units
        before = self._way.along(last.contact, last.changes, first, object_, start)
        alike = self._way.along(held.contact, held.changes, by[-1], object_, after[-1])
        contact = self._way.step(before, object_, start, after[-1], alike)
        seen = [
            each.predicted + np.tensordot(moved, each.slopes, 1)
            for each, moved in zip(held.explained[:-1], by[:-1], strict=True)
        ]
        explained = _seen_as(held.explained, [*seen, self._seen(contact)])
        solution = self._solution(object_, after, explained, contact, held.changes)
        return solution if solution.cost < held.cost else None

    def away(self, before: Array | None, object_: Array) -> float:
        """Largest change of an object, relative to the longest step of a fit."""
        if before is None:
            return 0.0
        return float((abs(object_ - before) / self._longest[MOVING:]).max())

    def _solution(
        self,
        object_: Array,
        poses: Array,
        explained: list[Explained],
        contact: PosedContact,
        changes: Changes,
    ) -> Solution:
        information, gradient = self._cost.normal(explained, object_, poses)
        misfit = sum(each.cost for each in explained)
        misfit /= sum(each.shifts.count for each in explained)
        inverse = np.linalg.inv(information)
        step = np.asarray(inverse @ gradient, np.float64)
        return Solution(
            object_=object_,
            keys=tuple(
                Key(shifts=each.shifts, pose=pose)
                for each, pose in zip(explained, poses, strict=True)
            ),
            explained=tuple(explained),
            contact=contact,
            changes=changes,
            covariance=max(1.0, misfit)
            * inverse[np.ix_(_LAST, _LAST)]
            * np.outer(self.units, self.units),
            step=step,
            gain=float(gradient @ step),
            cost=self._cost.of([each.loss for each in explained], object_, poses),
            misfit=misfit,
            typical=float(np.median([each.typical for each in explained])),
        )

    def last_of(self, solution: Solution) -> Followed:
        """Contact in the last key frame of a solution, from which the next frame is followed."""
        return Followed(
            contact=solution.contact,
            pose=solution.keys[-1].pose,
            seen=solution.explained[-1].predicted,
            slopes=solution.explained[-1].slopes[:MOVING],
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


def _seen_as(explained: Sequence[Explained], seen: Sequence[Array]) -> list[Explained]:
    """Replace the predicted shifts of key frames, and keep their derivatives."""
    return [replace(each, predicted=new) for each, new in zip(explained, seen, strict=True)]


def _losses(shifts: Sequence[Shifts], seen: Sequence[Array]) -> list[float]:
    """Loss of each key frame for predicted shifts."""
    return [frame.loss(frame.residual(each)) for frame, each in zip(shifts, seen, strict=True)]
