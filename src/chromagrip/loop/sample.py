"""Truth and estimates of one frame of a grasp."""

import math
from dataclasses import dataclass
from typing import cast

from ..control import GripObservation
from ..errors import UserError
from ..model import ForceField, SlipRecord, State
from ..model.dome import DomeSlip
from ..render import Frame
from ..sensing.contact import Contact
from ..sensing.reader import Reading
from ..tracking import Tracks
from .pinch.world import Pinched


@dataclass(frozen=True, kw_only=True)
class Truth:
    """Truth of a frame.

    Attributes
    ----------
    now: contact of the only finger, or both fingers and the object that they hold
    applied: force of the gripper's drive [N]; NaN if the object is moved instead
    load: lateral load on the object [N]; NaN if the object is moved instead
    """

    now: Contact | Pinched
    applied: float = math.nan
    load: float = math.nan

    @property
    def fingers(self) -> tuple[Contact, ...]:
        """Contact of each finger."""
        return self.now.fingers


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Truth and estimates of one frame; unknown values are None.

    Attributes
    ----------
    index: number of the frame
    time: instant of the frame [s]
    readings: reading of each finger; a controller is given one observation after the latency, with
        the margin to hold
    grip: force commanded from now on [N]
    truth: truth of the frame
    smaller: number of the finger whose observation the controller is given
    """

    index: int
    time: float
    readings: tuple[Reading, ...]
    grip: float
    truth: Truth | None = None
    smaller: int = 0

    @property
    def contact(self) -> Contact:
        """True contact of the only finger.

        Raises
        ------
        UserError
            For two fingers, and if the truth is unknown.
        """
        if self.truth is None or len(self.truth.fingers) > 1:
            raise UserError("the true contact of one finger is not known for this frame")
        return self.truth.fingers[0]

    @property
    def pinch(self) -> Pinched:
        """Both fingers and the object that they hold.

        Raises
        ------
        UserError
            For one finger, and if the truth is unknown.
        """
        if self.truth is None or len(self.truth.fingers) == 1:
            raise UserError("the truth of two fingers is not known for this frame")
        return cast("Pinched", self.truth.now)

    @property
    def applied(self) -> float:
        """Force of the gripper's drive now [N]; NaN if it is unknown."""
        return math.nan if self.truth is None else self.truth.applied

    @property
    def load(self) -> float:
        """Lateral load on the object [N]; NaN if it is unknown."""
        return math.nan if self.truth is None else self.truth.load

    @property
    def reasons(self) -> list[str]:
        """Reasons for which fingers have no estimate."""
        observed = [reading.observation for reading in self.readings]
        return [each.no_estimate for each in observed if each is not None and each.no_estimate]

    @property
    def reading(self) -> Reading:
        """Reading of the only finger.

        Raises
        ------
        UserError
            For two fingers; also in the properties below that use it.
        """
        if len(self.readings) > 1:
            raise UserError("this frame has readings of two fingers; use readings[0] and [1]")
        return self.readings[0]

    @property
    def observation(self) -> GripObservation | None:
        """Observation of the only finger, with Γ as its margin; None for a dropped frame."""
        return self.reading.observation

    @property
    def frame(self) -> Frame | None:
        """Picture; None on the truth path and for a dropped frame."""
        return self.reading.frame

    @property
    def tracks(self) -> Tracks | None:
        """Markers in the picture."""
        return self.reading.tracks

    @property
    def rest(self) -> Tracks | None:
        """Markers at rest; None on the truth path."""
        return self.reading.rest

    @property
    def state(self) -> State:
        """State of the chain.

        Raises
        ------
        UserError
            For a dome.
        """
        state = self.contact.state
        if not isinstance(state, State):  # only a chain has one
            raise UserError('the scene has body = "dome"; this needs body = "chain"')
        return state

    @property
    def field(self) -> ForceField:
        """True forces."""
        return self.contact.field

    @property
    def slip(self) -> SlipRecord | DomeSlip:
        """True slip of the object so far."""
        return self.contact.slip

    @property
    def friction(self) -> float:
        """True µ of the contact as a whole, see `whole_friction`."""
        return self.contact.friction
