"""Contact of a fingertip and an object at one instant, and its steps under forces."""

import math
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ..errors import located
from ..model import (
    ContactObject,
    DomeState,
    Fingertip,
    ForceField,
    SlipRecord,
    SoftBody,
    Solid,
    State,
    contact_forces,
    dome_forces,
    follow_slip,
    steps,
    touching,
    whole_friction,
)
from ..model.dome import DomeSlip, Stepper, follow_dome_slip

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Contact:
    """Fingertip and object at one instant.

    Attributes
    ----------
    obj: object with its friction and stiffness at that instant
    state: state of the body
    field: contact forces
    slip: slip of the object so far
    friction: µ of the contact as a whole, see `whole_friction`
    place: displacement of the object since the start, along x and y [m]
    indentation: displacement of the object towards the fingertip since they touched [m]
    turn: turn of the object about z since the start [rad]
    pitch: distance between neighbouring nodes [m]
    """

    obj: ContactObject | Solid
    state: State | DomeState
    field: ForceField
    slip: SlipRecord | DomeSlip
    friction: float
    place: tuple[float, float]
    indentation: float
    turn: float = 0.0
    pitch: float

    @property
    def fingers(self) -> "tuple[Contact]":
        """Contact of each finger: this one."""
        return (self,)


def of_chain(contact: Contact) -> tuple[ContactObject, State, SlipRecord]:
    """Object, state and slip of a contact on a chain."""
    parts = contact.obj, contact.state, contact.slip
    return cast("tuple[ContactObject, State, SlipRecord]", parts)


def of_dome(contact: Contact) -> tuple[Solid, DomeState, DomeSlip]:
    """Object, state and slip of a contact on silicone."""
    parts = contact.obj, contact.state, contact.slip
    return cast("tuple[Solid, DomeState, DomeSlip]", parts)


def chain_contact(
    fingertip: Fingertip, obj: ContactObject, state: State, slip: SlipRecord
) -> Contact:
    """Contact of a state of the node model."""
    field = contact_forces(fingertip, obj, state)
    return Contact(
        obj=obj,
        state=state,
        field=field,
        slip=slip,
        friction=whole_friction(fingertip, obj, state, field),
        place=(state.deformation.object_position, 0.0),
        indentation=state.deformation.rigid_part,
        pitch=fingertip.pitch,
    )


def follow_chain(
    fingertip: Fingertip,
    obj: ContactObject,
    contact: Contact,
    step: float,
    forces: Array,
    kept: tuple[int, ...],
) -> list[Contact]:
    """Step the node model under forces; returns the contact after some of the steps.

    Parameters
    ----------
    fingertip: chain
    obj: object in these steps
    contact: contact before the steps
    step: length of a step [s]
    forces: grip and load of each step [N], shape (S, 2)
    kept: numbers of the steps after which the contact is returned

    Raises
    ------
    UserError
        When the model fails.
    """
    _, state, slip = of_chain(contact)
    with located("the node model gave up"):
        run = steps(fingertip, obj, state, step, forces)
    touched = touching(fingertip, obj, run)
    slips = follow_slip(slip, run, touched, step, kept)
    return [
        chain_contact(fingertip, obj, run.state(k), one) for k, one in zip(kept, slips, strict=True)
    ]


def dome_contact(
    dome: SoftBody,
    solid: Solid,
    start: DomeState,
    state: DomeState,
    slip: DomeSlip,
    field: ForceField,
) -> Contact:
    """Contact of a state of silicone, with an object that started at `start`."""
    moved = state.place - start.place
    turned = state.rotation @ start.rotation.T
    return Contact(
        obj=solid,
        state=state,
        field=field,
        slip=slip,
        friction=solid.friction,
        place=(float(moved[0]), float(moved[1])),
        indentation=-float(moved[2]),
        turn=math.atan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1]),
        pitch=dome.spacing,
    )


def follow_dome(
    stepper: Stepper, contact: Contact, start: DomeState, end: float, wrench: Array | None = None
) -> Contact:
    """Advance the stepper by a step; returns the contact after it.

    Parameters
    ----------
    stepper: stepper in the state of `contact`
    contact: contact before the step
    start: state in which the object started
    end: time at the end of the step [s]
    wrench: force and torque on the free axes [N, N·m], shape (6,) (default: the motion's)

    Raises
    ------
    ModelError
        When the model fails.
    """
    stepper.advance(end, wrench)
    return contact_after(stepper, contact, start)


def contact_after(stepper: Stepper, contact: Contact, start: DomeState) -> Contact:
    """Contact of a stepper that has advanced from `contact`; one motion for its slip."""
    _, before, slip = of_dome(contact)
    after, dome = stepper.state(), stepper.dome
    field = dome_forces(dome, after, whole=False)
    slip = follow_dome_slip(slip, dome, before, after, field)
    return dome_contact(dome, stepper.solid, start, after, slip, field)
