"""Two fingertips that pinch a rigid body: its weight, its swing, and the hand that carries all.

The unknowns of a step are the forces on the nodes of both skins, the pose of the body in the hand
and the closing distance of the drive: a system of two compliance blocks with a common border. The
body's inertia is computed in the world's frame, see `body`.
"""

from .body import Filling, Moving, RigidBody, box_body, rotation_by
from .hand import HandPath, Shake
from .outcome import Limits, Outcome, PinchRecord, follow_pinch, mean_pressure
from .pinch import FACING, Pinch, bases
from .simulate import PinchRun, simulate_pinch
from .state import PinchState, pinch_rest
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
    "mean_pressure",
    "pinch_rest",
    "rotation_by",
    "simulate_pinch",
]
