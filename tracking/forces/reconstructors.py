"""Reconstructors by name: from tracks to a force field with its covariance, one signature."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

from ...by_name import Choice, Registry
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


#: Reconstructors by name.
RECONSTRUCTORS = Registry(
    protocol=Reconstructor,
    package=__package__,
    entries={
        "auto": (".reconstructors:automatic", "sequential with a read-out, gp without"),
        "gp": (
            ".chain.gaussian_process:GaussianProcess",
            "Gaussian-process prior on nodal forces in a zone",
        ),
        "tikhonov": (
            ".chain.tikhonov:Tikhonov",
            "one matrix product, linearised at rest, λ by evidence",
        ),
        "stiffness": (
            ".chain.stiffness_reading:StiffnessReading",
            "smooth displacements times K(u)",
        ),
        "learned": (
            ".chain.learned:Learned",
            "read-out trained on random grips, each frame by itself",
        ),
        "sequential": (
            ".chain.learned:Sequential",
            "the same over codes averaged while the skin holds still",
        ),
    },
)
#: Reads forces unless another is chosen: `sequential` with a read-out, `gp` without.
DEFAULT_RECONSTRUCTOR = "auto"


def automatic(calibration: SensorCalibration, rest: Tracks) -> Reconstructor:
    """Reconstructor for a sensor whose user chose none."""
    name = "gp" if calibration.readout is None else "sequential"
    return load_reconstructor(name)(calibration, rest)


def load_reconstructor(
    choice: Choice, arguments: Mapping[str, Any] | None = None
) -> Callable[[SensorCalibration, Tracks], Reconstructor]:
    """Factory of reconstructors, called with a calibration and the tracks at rest.

    Parameters
    ----------
    choice: name of ours or of an entry point, `auto`, `module:Class`, or a class or other factory
    arguments: further arguments of the class, by name

    Raises
    ------
    UserError
        When there is none of that name, or it cannot be imported.
    """
    factory: Callable[[SensorCalibration, Tracks], Reconstructor]
    factory = RECONSTRUCTORS.load(choice, arguments)
    return factory
