"""One frame of a run, truth beside estimate."""

from dataclasses import dataclass

from ...control import GripObservation
from ...errors import UserError
from ...model import ForceField, SlipRecord, State
from ...model.dome import DomeSlip
from ...render import Frame
from ...tracking import Tracks
from ..world import Contact


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
    pressure, pressure_pitch: true pressure, without and with one node pitch added [N/m]
    observation: of this frame, with Γ as its margin; the controller is given it after the latency,
        with the margin that it is to hold; None of a dropped frame
    frame, tracks, rest: image, markers in it and at rest; None on the truth path, the first two
        also of a dropped frame
    """

    index: int
    truth: Contact
    load: float
    grip: float
    applied: float
    pressure: float
    pressure_pitch: float
    observation: GripObservation | None
    frame: Frame | None
    tracks: Tracks | None
    rest: Tracks | None

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
