"""Reconstructors by name: from tracks to a force field with its covariance, one signature."""

from collections.abc import Callable
from importlib import import_module
from typing import Protocol

from ...by_name import import_class
from ...model import ForceField
from ..tracks import Tracks
from .calibration import SensorCalibration


class Reconstructor(Protocol):
    """Reads forces off the tracks of one specimen; made by `Class(calibration, rest)`.

    A field that says what µ is has a `friction_reading`; a field whose sums are known has a
    `totals_covariance`.
    """

    def reset(self) -> None:
        """Forget the frames before: the next one is read as the first."""
        ...

    def update(self, tracks: Tracks) -> ForceField:
        """Force field of the next frame.

        Raises
        ------
        NoEstimateError
            When the frame says nothing of the forces: too few markers, or nothing explains them.
        """
        ...


class ReconstructorError(ValueError):
    """A reconstructor that is not there, or is none."""


#: Module:Class of each reconstructor of ours, and one line about it.
RECONSTRUCTORS = {
    "gp": (
        "chain.gaussian_process:GaussianProcess",
        "Gaussian-process prior on nodal forces in a zone",
    ),
    "tikhonov": (
        "chain.tikhonov:Tikhonov",
        "one matrix product, linearised at rest, λ by evidence",
    ),
    "stiffness": ("chain.stiffness_reading:StiffnessReading", "smooth displacements times K(u)"),
    "learned": ("chain.learned:Learned", "read-out trained on random grips, each frame by itself"),
    "sequential": (
        "chain.learned:Sequential",
        "the same over codes averaged while the skin holds still",
    ),
}
#: What reads forces unless told otherwise: `sequential` with a read-out, `gp` without.
DEFAULT_RECONSTRUCTOR = "auto"


def _auto(calibration: SensorCalibration, rest: Tracks) -> Reconstructor:
    name = "gp" if calibration.readout is None else "sequential"
    return load_reconstructor(name)(calibration, rest)


def load_reconstructor(name: str) -> Callable[[SensorCalibration, Tracks], Reconstructor]:
    """What makes a reconstructor from a calibration and the tracks at rest.

    Parameters
    ----------
    name: of one of ours, `auto`, or `module:Class`

    Raises
    ------
    ReconstructorError
        When there is none of that name, or it cannot be imported.
    """
    found: Callable[[SensorCalibration, Tracks], Reconstructor]
    if name == DEFAULT_RECONSTRUCTOR:
        return _auto
    if name in RECONSTRUCTORS:
        module, _, kind = RECONSTRUCTORS[name][0].partition(":")
        found = getattr(import_module(f".{module}", __package__), kind)
        return found
    if ":" not in name:
        known = ", ".join([DEFAULT_RECONSTRUCTOR, *RECONSTRUCTORS])
        raise ReconstructorError(
            f"no reconstructor {name!r}; there is {known}, or give module:Class"
        )
    found = import_class(name, name, Reconstructor, ReconstructorError)
    return found
