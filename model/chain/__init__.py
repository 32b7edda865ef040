"""The thesis's node model: a plane slice of the fingertip as a chain of nodes on springs."""

from .assembly import chain, contact
from .plant import IMPLICIT, march
from .state import state_of
from .statics import QUASI_STATIC

__all__ = ["IMPLICIT", "QUASI_STATIC", "chain", "contact", "march", "state_of"]
