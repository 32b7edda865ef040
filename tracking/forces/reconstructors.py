"""Reconstructors by name: from tracks to a force field with its covariance, one signature."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

from ...by_name import Choice, Registry, name_of
from ...errors import UserError
from ...model import ForceField
from ..tracks import Tracks
from .calibration import SensorCalibration, required_readout


class NoEstimateError(UserError):
    """The frame does not determine the forces."""


class Reconstructor(Protocol):
    """Reads forces off the tracks of one specimen; made by `Class(calibration, rest)`.

    A field whose µ was read together with the forces has a `friction_reading`; a field whose sums
    are known has a `totals_covariance`.
    """

    def reset(self) -> None:
        """Forget the frames before: the next one is read as the first."""
        ...

    def update(self, tracks: Tracks) -> ForceField:
        """Force field of the next frame.

        Raises
        ------
        NoEstimateError
            When the frame does not determine the forces: too few markers are visible, or no forces
            explain them.
        """
        ...


#: Reconstructors that differ in method, by name; `auto` chooses among them.
METHODS = {
    "gp": (
        ".chain.gaussian_process:GaussianProcess",
        "Gaussian-process prior on nodal forces in a zone",
    ),
    "stiffness": (".chain.stiffness_reading:StiffnessReading", "smooth displacements times K(u)"),
    "learned": (
        ".chain.learned:Learned",
        "read-out trained on random grips, each frame by itself",
    ),
    "sequential": (
        ".chain.learned:sequential",
        "the same over codes averaged while the skin holds still",
    ),
}
#: Reads forces unless another is chosen.
DEFAULT_RECONSTRUCTOR = "auto"
#: Method that `auto` stands for.
AUTOMATIC = "sequential"
#: Every name that can be chosen.
RECONSTRUCTORS = Registry(
    protocol=Reconstructor,
    package=__package__,
    entries={
        DEFAULT_RECONSTRUCTOR: (
            ".reconstructors:automatic",
            "sequential; a read-out that is missing is trained at the first use",
        ),
        **METHODS,
    },
)
#: Names of those that need a trained read-out.
_TRAINED = (DEFAULT_RECONSTRUCTOR, "learned", "sequential")


def automatic(calibration: SensorCalibration, rest: Tracks) -> Reconstructor:
    """Reconstructor for a sensor whose user chose none: the only one good enough for a default.

    Raises
    ------
    UserError
        When the sensor has no trained read-out.
    """
    required_readout(calibration)
    return load_reconstructor(AUTOMATIC)(calibration, rest)


def load_reconstructor(
    choice: Choice, arguments: Mapping[str, Any] | None = None
) -> Callable[[SensorCalibration, Tracks], Reconstructor]:
    """Factory of reconstructors, called with a calibration and the tracks at rest.

    Parameters
    ----------
    choice: name of ours or of an entry point, `module:Class`, or a class or other factory
    arguments: further arguments of the class, by name

    Raises
    ------
    UserError
        When there is none of that name, or it cannot be imported.
    """
    factory: Callable[[SensorCalibration, Tracks], Reconstructor]
    factory = RECONSTRUCTORS.load(choice, arguments)
    return factory


def name_used(choice: Choice) -> str:
    """Name of a reconstructor; of the one that `auto` stands for."""
    return AUTOMATIC if choice == DEFAULT_RECONSTRUCTOR else name_of(choice)


def needs_readout(choice: Choice) -> bool:
    """Whether a reconstructor is one of ours that reads forces by a trained read-out."""
    return choice in _TRAINED


def check_reconstructor(choice: Choice, calibration: SensorCalibration) -> None:
    """Refuse, before anything is computed, a reconstructor that cannot read this sensor.

    Raises
    ------
    UserError
        When there is none of that name, it cannot be imported, or it needs a trained read-out and
        the sensor has none.
    """
    load_reconstructor(choice)
    if needs_readout(choice):
        required_readout(calibration)
