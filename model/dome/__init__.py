"""The fingertip as silicone in three dimensions: a dome, or a flat pad.

The skin is linear silicone on a rigid core, and stiffens as it is pressed towards the core. Its
compliance is solved once: for a dome by finite elements for each harmonic about the axis, for a pad
in closed form for each wave along it. `simulate_contact` moves an object over the skin: a shape
with a signed distance, with Dahl friction, sliding and torsion.
"""

from ..kernels.dome.turn_kernels import rotation_of_quaternion, rotation_vector
from .compliance import compliance_table, make_table
from .dome import Dome, Pad, SoftBody, lattice
from .inside import MarkerField, SkinField, inside_table
from .motion import AXES, Motion, Way, press_and_move
from .placing import rise_beside, rotation_of, touching_place
from .posed import PosedContact, PosedContacts, together
from .simulate import DomeRun, contact_steps, dome_forces, limit_margin, simulate_contact
from .slip import DomeSlip, follow_dome_slip, no_dome_slip
from .solid import Solid, per_area, solid_stiffness
from .state import DomeState, StepCount, resting
from .stepper import Stepper, displacements

__all__ = [
    "AXES",
    "Dome",
    "DomeRun",
    "DomeSlip",
    "DomeState",
    "MarkerField",
    "Motion",
    "Pad",
    "PosedContact",
    "PosedContacts",
    "SkinField",
    "SoftBody",
    "Solid",
    "StepCount",
    "Stepper",
    "Way",
    "compliance_table",
    "contact_steps",
    "displacements",
    "dome_forces",
    "follow_dome_slip",
    "inside_table",
    "lattice",
    "limit_margin",
    "make_table",
    "no_dome_slip",
    "per_area",
    "press_and_move",
    "resting",
    "rise_beside",
    "rotation_of",
    "rotation_of_quaternion",
    "rotation_vector",
    "simulate_contact",
    "solid_stiffness",
    "together",
    "touching_place",
]
