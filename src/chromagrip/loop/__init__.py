"""The grip loop: model, camera, observer and controller, frame after frame."""

from .fidelity import Fidelity
from .grasp import Sample, grasp, open_camera
from .latency import arrivals
from .run_folder import Result, run
from .trace import COLUMNS, Trace, summarise

__all__ = [
    "COLUMNS",
    "Fidelity",
    "Result",
    "Sample",
    "Trace",
    "arrivals",
    "grasp",
    "open_camera",
    "run",
    "summarise",
]
