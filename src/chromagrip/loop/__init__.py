"""The grip loop: model, camera, observer and controller, frame after frame."""

from ..sensing.sensor import open_camera
from .columns import COLUMNS
from .fidelity import Fidelity
from .grasp import grasp
from .latency import arrivals
from .record import Result
from .rig import Rig, RigState
from .run import run
from .sample import Sample
from .trace import Trace, summarise

__all__ = [
    "COLUMNS",
    "Fidelity",
    "Result",
    "Rig",
    "RigState",
    "Sample",
    "Trace",
    "arrivals",
    "grasp",
    "open_camera",
    "run",
    "summarise",
]
