"""The fingertip as a dome of silicone in three dimensions.

The skin is linear silicone on a rigid core, whose compliance is solved once by finite elements for
each harmonic about the axis, and stiffens as it is pressed towards the core. `simulate_contact`
moves an object over it: any signed distance, with Dahl friction, sliding and torsion.
"""

from .compliance import compliance_table, make_table
from .dome import Dome, dome_of, lattice
from .motion import AXES, Motion, press_and_move
from .simulate import (
    DomeRun,
    contact_steps,
    dome_forces,
    limit_margin,
    load_dome_state,
    save_dome_state,
    simulate_contact,
)
from .solid import Solid, solid_stiffness
from .stepper import DomeState, StepCount

__all__ = [
    "AXES",
    "Dome",
    "DomeRun",
    "DomeState",
    "Motion",
    "Solid",
    "StepCount",
    "compliance_table",
    "contact_steps",
    "dome_forces",
    "dome_of",
    "lattice",
    "limit_margin",
    "load_dome_state",
    "make_table",
    "press_and_move",
    "save_dome_state",
    "simulate_contact",
    "solid_stiffness",
]
