"""Bodies of a sensor: the node model's chain, and silicone as a dome or a pad.

Each touches one object, and moves it to a pose or under forces. `ability` lists what a body can
do; the rest is refused in one sentence.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from ..errors import UserError, located
from ..model import (
    ContactObject,
    DomeState,
    Drive,
    Fingertip,
    Motion,
    SoftBody,
    Solid,
    State,
    check_fit,
    dome_forces,
    follow_slip,
    largest_grip,
    no_slip,
    rest_state,
    simulate,
    touching,
)
from ..model.chain import chain
from ..model.chain import contact as contact_numbers
from ..model.dome import (
    Stepper,
    Way,
    lattice,
    no_dome_slip,
    resting,
    rotation_of_quaternion,
    rotation_vector,
)
from ..model.kernels import contact_frames
from ..model.shapes import distances
from .contact import (
    Contact,
    chain_contact,
    contact_after,
    dome_contact,
    follow_chain,
    follow_dome,
    of_chain,
    of_dome,
)
from .given import numbers

Array = NDArray[np.float64]
BodyName = Literal["chain", "dome", "pad"]


#: Largest coordinate of an object [m], so that millimetres given as metres are refused.
FARTHEST = 1.0


@dataclass(frozen=True, kw_only=True)
class Pose:
    """Pose of an object in the sensor's frame.

    Attributes
    ----------
    place: place of the object's origin [m], shape (3,); the origin of a chain's object is the point
        of its surface that touches the apex first
    turn: rotation as a quaternion (w, x, y, z)
    """

    place: tuple[float, float, float]
    turn: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name, count in (("place", 3), ("turn", 4)):
            values = numbers(getattr(self, name), (count,), f"{name} of a pose")
            object.__setattr__(self, name, tuple(values.tolist()))
        if (far := max(map(abs, self.place))) > FARTHEST:
            raise UserError(
                f"place of a pose is {far:g} m away, allowed is {FARTHEST:g} m: are these "
                "millimetres?"
            )
        if abs(math.hypot(*self.turn) - 1.0) > 1e-3:
            raise UserError(f"turn of a pose must be a quaternion of length 1, got {self.turn}")


@dataclass(frozen=True, kw_only=True)
class Ability:
    """Abilities of a body.

    Attributes
    ----------
    objects: type of the objects that the body can touch
    moves: axes along and about which an object can be moved, among x, y, z, rx, ry, rz
    loads: axes along and about which forces and torques can be applied
    torsion: whether torques about the grip axis, and the margin with torsion, are known
    """

    objects: type[ContactObject] | type[Solid]
    moves: tuple[str, ...]
    loads: tuple[str, ...]
    torsion: bool


class ChainBody:
    """The node model of the thesis: a chain in the plane of x and z."""

    #: Longest step of the node model [s].
    _longest_step = 1e-3

    name: BodyName = "chain"
    ability = Ability(objects=ContactObject, moves=("x", "z"), loads=("x", "z"), torsion=False)

    def __init__(self, fingertip: Fingertip, flat: bool = False) -> None:
        self.fingertip, self._flat = fingertip, flat

    @property
    def carrier(self) -> int:
        """Number of nodes."""
        return self.fingertip.nodes

    def untouched(self) -> State:
        """State without an object."""
        return rest_state(self.fingertip)

    def touch(self, obj: ContactObject | Solid) -> Contact:
        """Start a contact with an object that just touches the apex, before it is pressed.

        Raises
        ------
        UserError
            For an object that the body cannot touch.
        """
        if self._flat:
            raise UserError('the node model does not describe a flat pad; take body = "pad"')
        if not isinstance(obj, self.ability.objects):
            raise UserError(
                f"a chain touches a ContactObject, a profile in its plane, not a "
                f'{type(obj).__name__}; take body = "dome" for shapes and meshes'
            )
        obj = cast("ContactObject", obj)
        check_fit(self.fingertip, obj)
        return chain_contact(
            self.fingertip, obj, rest_state(self.fingertip), no_slip(self.fingertip.nodes)
        )

    def move(self, contact: Contact, pose: Pose, dt: float, placed: bool = False) -> Contact:
        """Move the object straight to a pose in a time [s]; returns the contact after it.

        With `placed` it is put there instead, without friction on its way.

        Raises
        ------
        UserError
            For a pose that is not possible on the chain, and when the model fails.
        """
        if placed:
            raise UserError('a chain\'s object is not put down elsewhere; take body = "dome"')
        x, y, z = pose.place
        if y != 0.0 or any(pose.turn[1:]):
            raise UserError(
                f"a chain's object moves along x and z alone, got y = {y:g} m and turn = "
                f'{pose.turn}; take body = "dome"'
            )
        obj, state, slip = of_chain(contact)
        count, start = max(1, math.ceil(dt / self._longest_step - 1e-9)), state.deformation
        drive = Drive(
            times=state.time + np.array([0.0, dt]),
            normal=np.array([start.rigid_part, self.fingertip.radius - z]),
            lateral=np.array([start.object_position, x]),
            normal_control="position",
            lateral_control="position",
        )
        with located("the node model gave up"):
            run = simulate(self.fingertip, obj, drive, dt=dt / count, duration=dt, state=state)
        touched = touching(self.fingertip, obj, run)
        (slip,) = follow_slip(slip, run, touched, dt / count, (count,))
        return self._checked(chain_contact(self.fingertip, obj, run.state(-1), slip))

    def load(self, contact: Contact, wrench: Array, dt: float) -> Contact:
        """Apply force and torque (6,) to the object for a time [N, N·m, s]; returns the contact.

        Raises
        ------
        UserError
            For a wrench that is not possible on the chain, and when the model fails.
        """
        if wrench[[1, 3, 4, 5]].any():
            raise UserError(
                f"a chain's object is loaded along x and z alone, got {wrench.tolist()}; take "
                'body = "dome"'
            )
        count = max(1, math.ceil(dt / self._longest_step - 1e-9))
        forces = np.tile([-wrench[2], wrench[0]], (count, 1))
        obj, _, _ = of_chain(contact)
        after = follow_chain(self.fingertip, obj, contact, dt / count, forces, (count,))[0]
        return self._checked(after)

    def _checked(self, contact: Contact) -> Contact:
        """Return the contact; refuse a press that is harder than the node model can describe."""
        limit = _largest_grip(self.fingertip, of_chain(contact)[0])
        if contact.field.total_normal > 1.01 * limit:
            raise UserError(
                f"the object is pressed with {contact.field.total_normal:.3g} N; the node model "
                f"describes up to {limit:.3g} N, which press the whole fingertip flat"
            )
        return contact

    def nodes(self, contact: Contact) -> tuple[Array, Array]:
        """Places of the nodes [m] and forces of the object on them [N], each of shape (N, 3)."""
        obj, state, _ = of_chain(contact)
        deformation, field = state.deformation, contact.field
        ground = chain(self.fingertip).rest + deformation.nodes
        _, normal = contact_frames(
            contact_numbers(self.fingertip, obj), ground, deformation.object_position
        )
        tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=-1)
        forces = field.normal[:, None] * normal + field.friction[:, None] * tangent
        return _in_space(field.position), _in_space(forces)


@lru_cache(maxsize=8)
def _largest_grip(fingertip: Fingertip, obj: ContactObject) -> float:
    return largest_grip(fingertip, obj)


def _in_space(plane: Array) -> Array:
    """Vectors (x, z) of a plane as (x, 0, z)."""
    return np.insert(plane, 1, 0.0, axis=1)


class SiliconeBody:
    """Silicone in three dimensions, as a dome or a flat pad."""

    ability = Ability(
        objects=Solid,
        moves=("x", "y", "z", "rx", "ry", "rz"),
        loads=("x", "y", "z", "rz"),
        torsion=True,
    )

    def __init__(self, silicone: SoftBody) -> None:
        self.carrier = silicone
        self._start: DomeState
        self._stepper: Stepper

    @property
    def name(self) -> BodyName:
        """Name in a scene or a design: `dome` or `pad`."""
        return self.carrier.kind

    def untouched(self) -> DomeState:
        """State without an object."""
        zeros = np.zeros_like(lattice(self.carrier).points)
        return DomeState(
            time=0.0, place=np.zeros(3), rotation=np.eye(3), velocity=np.zeros(6),
            displacement=zeros, linear=zeros, memory=zeros, forces=zeros,
            friction=zeros, normals=zeros, near=np.zeros(0, np.int64),
        )  # fmt: skip

    def touch(self, obj: ContactObject | Solid) -> Contact:
        """Start a contact with an object that just touches the apex, as `ChainBody.touch`."""
        if not isinstance(obj, self.ability.objects):
            raise UserError(
                f"a {self.name} of silicone touches a Solid, not a {type(obj).__name__}; take "
                'body = "chain" for profiles'
            )
        obj, motion = cast("Solid", obj), _still(np.zeros(6), 1.0)
        with located(f"the {self.name} gave up"):
            start = resting(self.carrier, obj, motion)
            self._stepper = Stepper(self.carrier, obj, motion, start)
        self._start = start
        field = dome_forces(self.carrier, start, whole=False)
        return dome_contact(self.carrier, obj, start, start, no_dome_slip(self.carrier), field)

    def move(self, contact: Contact, pose: Pose, dt: float, placed: bool = False) -> Contact:
        """Move the object to a pose, as `ChainBody.move`.

        An object that moves far in one update is lifted and put down again, without friction on
        its way.
        """
        state, place = of_dome(contact)[1], np.array(pose.place)
        rotation = rotation_of_quaternion(*pose.turn)
        shift, turn = place - state.place, rotation_vector(rotation @ state.rotation.T)
        angle = float(np.linalg.norm(turn))
        # Longest motion [m] and turn [rad] of the object in a step, and most steps of an update: an
        # object that moves farther is placed without friction on its way.
        way_m, turn_rad, most_steps = 0.2e-3, math.radians(3.0), 40
        count = max(1, math.ceil(np.linalg.norm(shift) / way_m), math.ceil(angle / turn_rad))
        if angle < 1e-9:  # the rounding of a pose that does not turn
            turn = np.zeros(3)
        if placed or count > most_steps:
            self._check_outside(place, rotation)
            contact, count = self._lifted(contact, place, rotation), 1
            state, shift, turn = of_dome(contact)[1], np.zeros(3), np.zeros(3)
        stepper, end = self._stepper, state.time + dt
        stepper.restore(state)
        stepper.motion = Way(state.time, end, state.place, state.rotation, shift, turn)
        for k in range(1, count + 1):
            with located(f"the {self.name} gave up"):
                stepper.advance(end if k == count else state.time + dt * k / count)
        return contact_after(stepper, contact, self._start)

    def load(self, contact: Contact, wrench: Array, dt: float) -> Contact:
        """Apply force and torque to the object, as `ChainBody.load`."""
        if wrench[[3, 4]].any():
            raise UserError(
                f"torques about x and y are not possible, got {wrench.tolist()}; the object cannot "
                "turn about them"
            )
        _, state, _ = of_dome(contact)
        # Dampers between the object and ground, as in a grasp: along z and across [N·s/m].
        down, across = 25.2, 120.0
        stepper, turning = self._stepper, across * (0.5 * self.carrier.radius) ** 2
        stepper.restore(state)
        drag = (across, across, down, 0.0, 0.0, turning)
        stepper.motion = _still(np.zeros(6), 1.0, free=self.ability.loads, drag=drag)
        time_s = 2e-3  # longest step under forces [s]
        count = max(1, math.ceil(dt / time_s - 1e-9))
        for k in range(1, count + 1):
            before = stepper.place.copy()
            with located(f"the {self.name} gave up"):
                contact = follow_dome(
                    stepper, contact, self._start, state.time + dt * k / count, wrench
                )
            way = float(np.linalg.norm(stepper.place - before))
            if way > self.carrier.stride:
                raise UserError(
                    f"the {self.name} gave up: the object moves {1e3 * way:.3g} mm in a step of "
                    f"{1e3 * dt / count:.3g} ms under {wrench.tolist()}; it needs less force"
                )
        return contact

    def nodes(self, contact: Contact) -> tuple[Array, Array]:
        """Places and forces of the nodes, as `ChainBody.nodes`."""
        field = contact.field
        assert field.directions is not None
        return field.position, field.normal[:, None] * field.directions + field.friction

    def _check_outside(self, place: Array, rotation: Array) -> None:
        """Refuse a place where the object would reach into the core below the silicone."""
        skin, shape = lattice(self.carrier), self._stepper.solid.shape
        deepest = 0.8 * self.carrier.thickness  # deepest press that the model describes
        looks = 12  # number of depths in the body at which an object is checked for being inside
        for depth in np.linspace(deepest, self.carrier.radius, looks):
            inside = skin.points - depth * skin.outwards
            gap, _ = distances(shape, (inside - place) @ rotation)
            if gap.min() < 0.0:
                raise UserError(
                    f"the {self.name} gave up: at {place.tolist()} m the object {shape.name} is "
                    f"too deep, more than {1e3 * deepest:.2g} mm in it"
                )

    def _lifted(self, contact: Contact, place: Array, rotation: Array) -> Contact:
        """Contact of an object at a place, before it has pressed."""
        _, state, slip = of_dome(contact)
        away = replace(self._start, time=state.time, place=place, rotation=rotation)
        slip = replace(no_dome_slip(self.carrier), rigid_slip=slip.rigid_slip)
        return replace(contact, state=away, slip=slip)


#: A body that an object is moved on.
Body = ChainBody | SiliconeBody


def _still(pose: Array, duration: float, **options: Any) -> Motion:
    """Motion that stays at a pose, except along its free axes."""
    return Motion(times=np.array([0.0, duration]), poses=np.stack([pose, pose]), **options)
