"""Mechanics of the fingertip and the object that it touches, for two bodies.

The chain is the thesis's node model, c·u̇ + K(u)·u = F_contact (thesis Eq. 2), of a slice. The dome
is silicone in three dimensions; `simulate_contact` moves any object over it.

u are the displacements of the nodes, c their dampers, K the springs between rigid part, tissue and
membrane, and F_contact the penalty and Dahl friction forces of the object. `simulate` steps the
chain in time, and `equilibrium` solves it at rest. `contact_forces` returns the true forces, with
which estimates are compared.
"""

from .chain.assembly import check_fit
from .chain.drive import Drive
from .chain.ensemble import Copies, Ensemble, copies_of, place_many, rest_ensemble
from .chain.fingertip import REFERENCE_NODES, Fingertip, SpringLaw
from .chain.metrics import GROSS_SLIP, SlipRecord, follow_slip, no_slip, pressure
from .chain.plant import History, simulate, step, steps
from .chain.state import Deformation, State, rest_state
from .chain.statics import equilibrium, largest_grip, refuse_flattening
from .chain.stiffness import chain_compliance, chain_forces, spring_force, spring_forces
from .dome import (
    Dome,
    DomeRun,
    DomeState,
    Motion,
    Pad,
    SoftBody,
    Solid,
    contact_steps,
    dome_forces,
    limit_margin,
    press_and_move,
    simulate_contact,
    solid_stiffness,
)
from .errors import (
    ConvergenceError,
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
from .limit_surface import margin_within, torsion
from .objects import ContactObject, Surface, stiffness_from_young

__all__ = [
    "GROSS_SLIP",
    "REFERENCE_NODES",
    "ContactObject",
    "ConvergenceError",
    "Copies",
    "Deformation",
    "Dome",
    "DomeRun",
    "DomeState",
    "Drive",
    "Ensemble",
    "Fingertip",
    "ForceField",
    "FrictionReading",
    "History",
    "LoadPlane",
    "LostContactError",
    "ModelError",
    "Motion",
    "NoEquilibriumError",
    "Pad",
    "PiercedError",
    "SlipRecord",
    "SoftBody",
    "Solid",
    "SpringLaw",
    "State",
    "Surface",
    "chain_compliance",
    "chain_forces",
    "check_fit",
    "contact_forces",
    "contact_steps",
    "copies_of",
    "dome_forces",
    "equilibrium",
    "follow_slip",
    "largest_grip",
    "limit_margin",
    "margin_within",
    "no_slip",
    "node_friction",
    "place_many",
    "press_and_move",
    "pressure",
    "refuse_flattening",
    "rest_ensemble",
    "rest_state",
    "simulate",
    "simulate_contact",
    "solid_stiffness",
    "spring_force",
    "spring_forces",
    "step",
    "steps",
    "stiffness_from_young",
    "torsion",
    "touching",
    "whole_friction",
]
