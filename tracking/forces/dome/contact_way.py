"""The way of a contact through key poses, and what each unknown changes along it.

The derivatives are those of the contact solver itself, which is run once more for each unknown, a
little changed. An unknown of the object changes the whole way: its runs have histories of their
own, kept as differences from the best one. A pose changes its own frame alone; what it changes
later, by friction, is left out of the derivatives and not of the way.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ....model import Dome
from ....model.dome import PosedContact, PosedContacts
from .contact_state import MOVING, OBJECT, PRESS, UNKNOWNS, pose_of, solid_of, units_of

Array = NDArray[np.float64]

#: What of a contact the next step depends on.
_HISTORY = ("displacement", "linear", "forces", "friction")
#: What is compared of two contacts.
_COMPARED = (*_HISTORY, "normals")
#: Longest part of a step, in shares of the thickness of the silicone, and the most parts.
_PART, _MOST = 0.08, 8


@dataclass(frozen=True, kw_only=True)
class Changes:
    """Change of a contact by each of C unknowns over its unit; arrays of shape (C, N, 3)."""

    displacement: Array
    linear: Array
    forces: Array
    friction: Array
    normals: Array

    def added(self, contact: PosedContact, k: int) -> PosedContact:
        """The contact with unknown k changed by its unit."""
        parts = {name: getattr(contact, name) + getattr(self, name)[k] for name in _COMPARED}
        return replace(contact, **parts)


class ContactWay:
    """Contacts of one dome on the way through poses.

    Parameters
    ----------
    dome: body
    """

    def __init__(self, dome: Dome) -> None:
        self.dome = dome
        self._contacts = PosedContacts(dome)
        self._units = units_of(dome)

    def untouched(self, object_: Array) -> PosedContact:
        """The dome at rest, and an object that just touches it."""
        return self._contacts.untouched(*self._pose(object_, np.zeros(MOVING)))

    def step(
        self, contact: PosedContact, object_: Array, before: Array, after: Array
    ) -> PosedContact:
        """Contact at the next pose, in parts where it is far.

        Parameters
        ----------
        object_: unknowns of the object, shape (8,)
        before, after: poses, shape (4,)

        Raises
        ------
        ConvergenceError
            When the contact has no solution near the one before.
        """
        solid = solid_of(object_)
        contact = self._contacts.look(contact, solid, *self._pose(object_, after))
        return self._parts(contact, object_, before, after)

    def step_and_changes(
        self,
        contact: PosedContact,
        history: Changes | None,
        object_: Array,
        before: Array,
        after: Array,
        unknowns: tuple[int, ...] = tuple(range(UNKNOWNS)),
    ) -> tuple[PosedContact, Changes]:
        """Contact at the next pose, and what each unknown changes of it.

        Parameters
        ----------
        contact: before the step
        history: what the unknowns of the object changed of it; None is nothing
        unknowns: that are changed

        Raises
        ------
        ConvergenceError
            As `step`.
        """
        solid = solid_of(object_)
        contact = self._contacts.look(contact, solid, *self._pose(object_, after))
        reached = self._parts(contact, object_, before, after)
        cases = []
        for k in unknowns:
            changed_object, changed_pose, start = object_, after, contact
            if k in OBJECT:
                changed_object = object_.copy()
                changed_object[k - MOVING] += self._units[k]
                if history is not None:
                    start = history.added(contact, k)
                rotation, place = self._pose(changed_object, before)
                start = replace(start, rotation=rotation, place=place)
            else:
                changed_pose = after.copy()
                changed_pose[k] += self._units[k]
            cases.append(self._parts(start, changed_object, before, changed_pose))
        parts = {
            name: np.stack([getattr(case, name) for case in cases]) - getattr(reached, name)
            for name in _COMPARED
        }
        return reached, Changes(**parts)

    def _pose(self, object_: Array, pose: Array) -> tuple[Array, Array]:
        return pose_of(self.dome, object_, pose)

    def _parts(
        self, contact: PosedContact, object_: Array, before: Array, after: Array
    ) -> PosedContact:
        solid = solid_of(object_)
        way = float(abs(after[: PRESS + 1] - before[: PRESS + 1]).max())
        parts = int(np.clip(np.ceil(way / (_PART * self.dome.thickness)), 1, _MOST))
        for part in range(1, parts + 1):
            there = before + part / parts * (after - before)
            contact = self._contacts.step(contact, solid, *self._pose(object_, there))
        return contact
