"""Path of a contact through key poses, and its derivatives with respect to each unknown.

The derivatives are those of the solved contact, to first order. An unknown of the object changes
the whole path: its effect on the history is propagated. A pose changes its own frame only; its
later effect by friction is in the path but not in the derivatives.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ....errors import UserError
from ....model import Dome, Solid
from ....model.dome import PosedContact, PosedContacts, lattice, together
from .contact_state import MOVING, OBJECT, PRESS, UNKNOWNS, poses_of, solid_of, units_of
from .settings import ContactModelSettings

Array = NDArray[np.float64]

#: Arrays of a contact that the next step depends on.
_HISTORY = ("displacement", "linear", "forces", "friction")


@dataclass(frozen=True, kw_only=True)
class Changes:
    """A contact, and C copies of it, each changed by one unit of an unknown.

    Attributes
    ----------
    contact: unchanged contact
    changed: the C changed contacts
    """

    contact: PosedContact
    changed: PosedContact

    @property
    def linear(self) -> Array:
        """Changes of the forces on the linear skin [N], shape (C, n, 3)."""
        return self.changed.linear - self.contact.linear


class ContactWay:
    """Simulates contacts of one dome on a path through poses.

    Parameters
    ----------
    dome: body
    model: tuned parameters
    """

    def __init__(self, dome: Dome, model: ContactModelSettings = ContactModelSettings()) -> None:
        self.dome, self._model = dome, model
        self._contacts = PosedContacts(dome)
        self._outwards = lattice(dome).outwards
        self._units = units_of(dome)
        self._object = np.full(len(OBJECT), np.nan)
        self._solids: list[Solid] = []

    def untouched(self, object_: Array) -> PosedContact:
        """Make the contact of a dome at rest with an object that just touches it."""
        rotation, place = poses_of(self.dome, object_[None], np.zeros((1, MOVING)))
        return self._contacts.untouched(rotation[0], place[0])

    def step(
        self,
        contact: PosedContact,
        object_: Array,
        before: Array,
        after: Array,
        alike: PosedContact | None = None,
    ) -> PosedContact:
        """Solve for the contact at the next pose, in several parts if it is far.

        Parameters
        ----------
        object_: unknowns of the object, shape (8,)
        before, after: poses, shape (4,)
        alike: similar contact, as initial guess

        Raises
        ------
        UserError
            When the contact has no solution near the one before, and where it is too deep.
        """
        solid = self._solids_of(object_)[0]
        contact = self._look(contact, solid, object_, after)
        for there in self._parts(before, after):
            pose = poses_of(self.dome, object_[None], there[None])
            near = alike if there is after else None
            contact = self._contacts.step(contact, solid, pose[0][0], pose[1][0], near)
        return self._described(contact)

    def step_and_changes(
        self,
        contact: PosedContact,
        history: Changes | None,
        object_: Array,
        before: Array,
        after: Array,
        unknowns: tuple[int, ...] = tuple(range(UNKNOWNS)),
        alike: PosedContact | None = None,
        solved: bool = False,
    ) -> tuple[PosedContact, Changes]:
        """Solve for the contact at the next pose, and its change by each unknown.

        Parameters
        ----------
        contact: contact before the step
        history: its changes by the unknowns of the object; None: no changes
        unknowns: indices of the unknowns to change; all of them with a history
        alike: as in `step`
        solved: whether `alike` is already the contact at the next pose

        Raises
        ------
        ConvergenceError
            As `step`.
        """
        small = self._model.derivative_step
        solids = self._solids_of(object_)
        contact = self._look(contact, solids[0], object_, after)
        count = 1 + len(unknowns)
        objects = np.repeat(object_[None], count, axis=0)
        moves = np.zeros((count, MOVING))
        for row, k in enumerate(unknowns, start=1):
            if k in OBJECT:
                objects[row, k - MOVING] += small * self._units[k]
            else:
                moves[row, k] = small * self._units[k]
        own = [solids[0], *(solids[1 + k - MOVING] if k in OBJECT else solids[0] for k in unknowns)]
        start = together([contact] * count)
        if history is not None:
            unchanged, changed = map(self._contacts.onto, (history.contact, history.changed))
            for name in _HISTORY:
                change = getattr(changed, name) - getattr(unchanged, name)
                getattr(start, name)[1 + MOVING :] += small * change[MOVING:]
        places = np.repeat(before[None], count, axis=0)
        every = contact
        for there in self._parts(before, after):
            rotation, place = poses_of(self.dome, objects, places)
            start = replace(start, rotation=rotation, place=place)
            end = there is after
            places = there + moves * float(end)
            rotation, place = poses_of(self.dome, objects, places)
            near = alike if end else None
            known = self._contacts.known(near) if near is not None and solved else None
            if known is None:
                known = self._contacts.step(contact, solids[0], rotation[0], place[0], near)
            contact = known
            every = self._contacts.changed(start, contact, own, rotation, place, 1.0 / small)
            start = self._beside(contact, every)
        return self._described(contact), Changes(contact=contact, changed=every)

    def _described(self, contact: PosedContact) -> PosedContact:
        """The contact; refuse one that is deeper in the silicone than it is described."""
        outwards = self._outwards[contact.nodes]
        depths = -np.einsum("ij,ij->i", contact.displacement, outwards)
        if depths.max(initial=0.0) > self._model.deepest * self.dome.thickness:
            raise UserError("the object is pressed deeper than the silicone is described")
        return contact

    def _beside(self, contact: PosedContact, every: PosedContact) -> PosedContact:
        """Stack a contact, and copies of it with small shares of changes."""
        whole = together([contact] * (1 + len(every.place)))
        for name in _HISTORY:
            values = getattr(whole, name)
            values[1:] += self._model.derivative_step * (getattr(every, name) - values[1:])
        return whole

    def _look(
        self, contact: PosedContact, solid: Solid, object_: Array, after: Array
    ) -> PosedContact:
        """Activate the nodes that the object may touch at the next pose."""
        rotation, place = poses_of(self.dome, object_[None], after[None])
        return self._contacts.look(contact, solid, rotation[0], place[0])

    def _solids_of(self, object_: Array) -> list[Solid]:
        """Objects: the given one, and copies with one unknown changed slightly."""
        if not np.array_equal(object_, self._object):
            changed = object_ + np.diag(self._model.derivative_step * self._units[MOVING:])
            self._solids = [solid_of(each, self._model) for each in (object_, *changed)]
            self._object = object_.copy()
        return self._solids

    def _parts(self, before: Array, after: Array) -> Iterator[Array]:
        """Yield poses on the way from one to another, including the latter."""
        model = self._model
        move = after[: PRESS + 1] - before[: PRESS + 1]
        # Length along the skin, not its larger component: the result depends slightly on the number
        # of parts, and must not depend on the direction of x.
        way = max(math.hypot(*move[:PRESS]), abs(float(move[PRESS])))
        count = np.ceil(way / (model.longest_part * self.dome.thickness))
        parts = int(np.clip(count, 1, model.most_parts))
        for part in range(1, parts):
            yield before + part / parts * (after - before)
        yield after


def sums_of(contact: PosedContact) -> Array:
    """ΣFn and ΣFf [N], shape (…, 2)."""
    axis = (contact.forces - contact.friction).sum(axis=-2)
    whole = contact.friction.sum(axis=-2)
    length = np.maximum(np.linalg.norm(axis, axis=-1), 1e-12)
    along = (whole * axis).sum(axis=-1) / length**2
    across = np.linalg.norm(whole - axis * along[..., None], axis=-1)
    return np.stack([contact.normal.sum(axis=-1), across], axis=-1)
