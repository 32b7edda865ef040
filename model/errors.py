"""Reasons for which a run of the model cannot go on; each message names the time and the forces."""

from ..errors import UserError


class ModelError(UserError):
    """A run of the model that cannot go on."""


class ConvergenceError(ModelError):
    """An implicit step that does not converge, not even in the shortest parts."""


class LostContactError(ModelError):
    """A load on an object that the fingertip does not touch."""


class PiercedError(ModelError):
    """A fingertip that went through its object, which is too soft for the grip."""


class NoEquilibriumError(ModelError):
    """A load that friction cannot hold, so that the object slides for ever."""
