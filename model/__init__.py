"""The node model of fingertip and object: c·u̇ + K(u)·u = F_contact (thesis Eq. 2).

u are the displacements of the nodes, c their dampers, K the springs between rigid part, tissue and
membrane, and F_contact the penalty and Dahl friction forces of the object. `simulate` steps it in
time, `equilibrium` solves it at rest, and `contact_forces` is the truth that estimates are compared
with.
"""

from .chain.assembly import check_fit
from .chain.drive import Drive
from .chain.ensemble import Ensemble, rest_ensemble, step_many
from .chain.fingertip import REFERENCE_NODES, Fingertip, SpringLaw
from .chain.integrators import INTEGRATORS, Integrator, Method, explicit_limit, simulate
from .chain.metrics import GROSS_SLIP, SlipRecord, follow_slip, no_slip, pressure
from .chain.plant import History, step, steps
from .chain.state import Deformation, State, load_state, rest_state, save_state
from .chain.statics import equilibrium, largest_grip
from .chain.stiffness import chain_compliance, chain_forces, spring_force, spring_forces
from .errors import (
    ConvergenceError,
    DivergedError,
    LostContactError,
    ModelError,
    NoEquilibriumError,
    PiercedError,
)
from .force_field import (
    ForceField,
    FrictionReading,
    LoadPlane,
    contact_forces,
    node_friction,
    touching,
    whole_friction,
)
from .objects import ContactObject, Surface, stiffness_from_young

__all__ = [
    "GROSS_SLIP",
    "INTEGRATORS",
    "REFERENCE_NODES",
    "ContactObject",
    "ConvergenceError",
    "Deformation",
    "DivergedError",
    "Drive",
    "Ensemble",
    "Fingertip",
    "ForceField",
    "FrictionReading",
    "History",
    "Integrator",
    "LoadPlane",
    "LostContactError",
    "Method",
    "ModelError",
    "NoEquilibriumError",
    "PiercedError",
    "SlipRecord",
    "SpringLaw",
    "State",
    "Surface",
    "chain_compliance",
    "chain_forces",
    "check_fit",
    "contact_forces",
    "equilibrium",
    "explicit_limit",
    "follow_slip",
    "largest_grip",
    "load_state",
    "no_slip",
    "node_friction",
    "pressure",
    "rest_ensemble",
    "rest_state",
    "save_state",
    "simulate",
    "spring_force",
    "spring_forces",
    "step",
    "step_many",
    "steps",
    "stiffness_from_young",
    "touching",
    "whole_friction",
]
