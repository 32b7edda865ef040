"""Two fingertips that pinch a rigid body: its weight, its swing, and the hand that carries all.

The unknowns of a step are the forces on the nodes of both skins, the pose of the body in the hand
and the closing distance of the drive: a system of two compliance blocks with a common border. The
body's inertia is computed in the world's frame, see `body`.
"""

from .body import Filling, Moving, RigidBody, box_body, kinetic_energy, rotation_by
from .hand import HandPath, Shake
from .outcome import Limits, Outcome, PinchRecord, follow_pinch, mean_pressure
from .pinch import FACING, Pinch, bases
from .simulate import PinchRun, simulate_pinch
from .state import PinchState, load_pinch_state, pinch_rest, save_pinch_state
from .stepper import PinchStepper

__all__ = [
    "FACING",
    "Filling",
    "HandPath",
    "Limits",
    "Moving",
    "Outcome",
    "Pinch",
    "PinchRecord",
    "PinchRun",
    "PinchState",
    "PinchStepper",
    "RigidBody",
    "Shake",
    "bases",
    "box_body",
    "follow_pinch",
    "kinetic_energy",
    "load_pinch_state",
    "mean_pressure",
    "pinch_rest",
    "rotation_by",
    "save_pinch_state",
    "simulate_pinch",
]
