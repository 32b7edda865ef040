"""One frame of a run, truth beside estimate."""

from dataclasses import dataclass
from typing import Any

from ...control import GripObservation
from ...errors import UserError
from ...model import ForceField, SlipRecord, State
from ...model.dome import DomeSlip
from ...render import Frame
from ...tracking import Tracks
from .readers import Reading


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One frame of a run, truth beside estimate.

    Attributes
    ----------
    index: of the frame
    truth: of the contact
    load: lateral load on the object [N]
    grip: force commanded from now on [N]
    applied: force of the gripper's drive now [N]
    pitch: of the body's nodes [m]
    readings: of each finger; the controller is given an observation after the latency, with the
        margin that it is to hold
    smaller: finger whose observation that is
    """

    index: int
    truth: Any
    load: float
    grip: float
    applied: float
    pitch: float
    readings: tuple[Reading, ...]
    smaller: int = 0

    @property
    def reasons(self) -> list[str]:
        """Why fingers have no estimate."""
        seen = [reading.observation for reading in self.readings]
        return [each.no_estimate for each in seen if each is not None and each.no_estimate]

    @property
    def reading(self) -> Reading:
        """Of the only finger."""
        (only,) = self.readings
        return only

    @property
    def observation(self) -> GripObservation | None:
        """Of the only finger's frame, with Γ as its margin; None of a dropped frame."""
        return self.reading.observation

    @property
    def frame(self) -> Frame | None:
        """Image; None on the truth path and of a dropped frame."""
        return self.reading.frame

    @property
    def tracks(self) -> Tracks | None:
        """Markers in the image."""
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
        if not isinstance(self.truth.state, State):
            raise UserError('the scene has body = "dome"; this needs body = "chain"')
        return self.truth.state

    @property
    def time(self) -> float:
        """Instant of the frame [s]."""
        return self.truth.state.time

    @property
    def field(self) -> ForceField:
        """True forces."""
        return self.truth.field

    @property
    def slip(self) -> SlipRecord | DomeSlip:
        """True slip of the object so far."""
        return self.truth.slip

    @property
    def friction(self) -> float:
        """True µ of the contact as a whole, see `whole_friction`."""
        return self.truth.friction
