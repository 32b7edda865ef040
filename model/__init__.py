"""What is true: the node model of fingertip and object, c·u̇ + K(u)·u = F_contact (thesis Eq. 2)."""

from .fingertip import REFERENCE_NODES, Fingertip
from .force_field import ForceField, contact_forces
from .metrics import GROSS_SLIP, SlipRecord, follow_slip, no_slip, pressure
from .objects import ContactObject, stiffness_from_young
from .plant import ConvergenceError, step
from .state import Deformation, State, rest_state
from .stiffness import chain_compliance, chain_forces

__all__ = [
    "GROSS_SLIP",
    "REFERENCE_NODES",
    "ContactObject",
    "ConvergenceError",
    "Deformation",
    "Fingertip",
    "ForceField",
    "SlipRecord",
    "State",
    "chain_compliance",
    "chain_forces",
    "contact_forces",
    "follow_slip",
    "no_slip",
    "pressure",
    "rest_state",
    "step",
    "stiffness_from_young",
]
