"""Reasons for which a run of the model cannot go on; each message names the time and the forces."""

import math

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


class DivergedError(ModelError):
    """An explicit run that grew without bound.

    Attributes
    ----------
    step: index of the step after which the state was lost
    limit: largest stable step predicted by linear theory [s]
    """

    # A message alone must do: `located` and pickle make the error anew from it.
    def __init__(self, message: str, step: int = 0, limit: float = math.nan) -> None:
        super().__init__(message)
        self.step = step
        self.limit = limit
