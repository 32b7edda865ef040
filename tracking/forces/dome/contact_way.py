"""The way of a contact through key poses, and what each unknown changes along it.

The derivatives are those of the contact solver itself, which is run once more for each unknown, a
little changed. An unknown of the object changes the whole way: its runs have histories of their
own, kept as differences from the best one. A pose changes its own frame alone; what it changes
later, by friction, is left out of the derivatives and not of the way.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ....model import Dome, Solid
from ....model.dome import PosedContact, PosedContacts, together
from .contact_state import MOVING, OBJECT, PRESS, UNKNOWNS, poses_of, solid_of, units_of

Array = NDArray[np.float64]

#: What of a contact the next step depends on.
_HISTORY = ("displacement", "linear", "forces", "friction")
#: Longest part of a step, in shares of the thickness of the silicone, and the most parts.
_PART, _MOST = 0.08, 8


@dataclass(frozen=True, kw_only=True)
class Changes:
    """A contact, and the same changed by each of C unknowns over its unit.

    Attributes
    ----------
    contact: unchanged
    changed: C contacts
    """

    contact: PosedContact
    changed: PosedContact

    @property
    def linear(self) -> Array:
        """Changes of the forces on the linear skin [N], shape (C, n, 3)."""
        return self.changed.linear - self.contact.linear


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
        self._object = np.full(len(OBJECT), np.nan)
        self._solids: list[Solid] = []

    def untouched(self, object_: Array) -> PosedContact:
        """The dome at rest, and an object that just touches it."""
        rotation, place = poses_of(self.dome, object_[None], np.zeros((1, MOVING)))
        return self._contacts.untouched(rotation[0], place[0])

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
        solid = self._solids_of(object_)[0]
        contact = self._look(contact, solid, object_, after)
        start, objects = together([contact]), object_[None]
        return self._parts(start, [solid], objects, before[None], after[None]).at(0)

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
        unknowns: that are changed; all of them where there is a history

        Raises
        ------
        ConvergenceError
            As `step`.
        """
        solids = self._solids_of(object_)
        contact = self._look(contact, solids[0], object_, after)
        count = 1 + len(unknowns)
        objects = np.repeat(object_[None], count, axis=0)
        befores, afters = (np.repeat(pose[None], count, axis=0) for pose in (before, after))
        start = together([contact] * count)
        for row, k in enumerate(unknowns, start=1):
            if k in OBJECT:
                objects[row, k - MOVING] += self._units[k]
            else:
                afters[row, k] += self._units[k]
        if history is not None:
            unchanged, changed = map(self._contacts.onto, (history.contact, history.changed))
            for name in _HISTORY:
                change = getattr(changed, name) - getattr(unchanged, name)
                getattr(start, name)[1 + MOVING :] += change[MOVING:]
        rotation, place = poses_of(self.dome, objects, befores)
        start = replace(start, rotation=rotation, place=place)
        own = [solids[0], *(solids[1 + k - MOVING] if k in OBJECT else solids[0] for k in unknowns)]
        every = self._parts(start, own, objects, befores, afters)
        reached = every.at(0)
        return reached, Changes(contact=reached, changed=every.at(slice(1, None)))

    def _look(
        self, contact: PosedContact, solid: Solid, object_: Array, after: Array
    ) -> PosedContact:
        rotation, place = poses_of(self.dome, object_[None], after[None])
        return self._contacts.look(contact, solid, rotation[0], place[0])

    def _solids_of(self, object_: Array) -> list[Solid]:
        """The object, and the same with each of its unknowns changed."""
        if not np.array_equal(object_, self._object):
            changed = object_ + np.diag(self._units[MOVING:])
            self._solids = [solid_of(each) for each in (object_, *changed)]
            self._object = object_.copy()
        return self._solids

    def _parts(
        self,
        contacts: PosedContact,
        solids: list[Solid],
        objects: Array,
        before: Array,
        after: Array,
    ) -> PosedContact:
        way = float(abs(after[0, : PRESS + 1] - before[0, : PRESS + 1]).max())
        parts = int(np.clip(np.ceil(way / (_PART * self.dome.thickness)), 1, _MOST))
        for part in range(1, parts + 1):
            there = before + part / parts * (after - before)
            contacts = self._contacts.step_all(
                contacts, solids, *poses_of(self.dome, objects, there)
            )
        return contacts
