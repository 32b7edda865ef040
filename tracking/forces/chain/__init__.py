"""Force reconstruction on the chain: from marker shifts to nodal forces, f = K(u)·u.

Two ways through an unknown contact: a prior on smooth forces (`gaussian_process`, and the direct
`stiffness_reading` as its baseline), and a regression trained on the model's histories (`learned`).
"""

from .contact_reading import ForcePrior
from .gaussian_process import MIN_MARKERS, GaussianProcess
from .learned import Learned
from .readout import BEND, Layers, ReadOut, forward, limited, load_readout, save_readout
from .sensitivity import MarkerResponse

__all__ = [
    "BEND",
    "MIN_MARKERS",
    "ForcePrior",
    "GaussianProcess",
    "Layers",
    "Learned",
    "MarkerResponse",
    "ReadOut",
    "forward",
    "limited",
    "load_readout",
    "save_readout",
]
