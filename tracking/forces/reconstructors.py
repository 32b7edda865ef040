"""Reconstructors by name: from tracks to a force field with its covariance, one signature."""

from collections.abc import Callable, Mapping
from typing import Any, Literal, Protocol

from ...by_name import Choice, Registry, name_of
from ...errors import UserError, located
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
    "contact": (
        ".dome.contact:ContactReading",
        "a contact fitted by synthesis, on a dome of silicone",
    ),
    "traction": (
        ".dome.traction.reading:TractionReading",
        "free tractions, on a dome of silicone with two soft layers",
    ),
}
#: Reads forces unless another is chosen.
DEFAULT_RECONSTRUCTOR = "auto"
#: What pictures are of: the chain revolved, or a dome of silicone.
Body = Literal["chain", "dome"]
#: Method that `auto` stands for, by body.
AUTOMATIC: dict[Body, str] = {"chain": "sequential", "dome": "contact"}
#: Methods of ours that read a dome of silicone; the others read a chain.
DOME_METHODS = ("contact", "traction")
#: Every name that can be chosen.
RECONSTRUCTORS = Registry(
    protocol=Reconstructor,
    package=__package__,
    entries={
        DEFAULT_RECONSTRUCTOR: (
            ".reconstructors:automatic",
            "sequential, or contact for a dome with soft markers or a layer on its rigid core",
        ),
        **METHODS,
    },
)
#: Names of those that need a trained read-out.
_TRAINED = ("learned", "sequential")


def automatic(calibration: SensorCalibration, rest: Tracks) -> Reconstructor:
    """Reconstructor for a sensor whose user chose none.

    Raises
    ------
    UserError
        When the sensor needs a trained read-out and has none.
    """
    name = name_used(DEFAULT_RECONSTRUCTOR, calibration)
    check_reconstructor(name, calibration)
    return load_reconstructor(name)(calibration, rest)


def body_read(calibration: SensorCalibration) -> Body:
    """Body that `auto` takes a sensor's pictures to be of.

    Markers that stretch as the silicone does, or lie on its rigid core, are those of a dome that
    can be built: it is read as one. The designs of the thesis are read by their trained read-out.
    """
    sensor = calibration.nominal
    built = bool(sensor.markers.swell_mm) or not sensor.yellow.follow
    built &= sensor.silicone is not None and not sensor.shape.flat  # no method reads a pad
    return "dome" if built else "chain"


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


def name_used(choice: Choice, calibration: SensorCalibration) -> str:
    """Name of a reconstructor; of the one that `auto` stands for."""
    automatic = choice == DEFAULT_RECONSTRUCTOR
    return AUTOMATIC[body_read(calibration)] if automatic else name_of(choice)


def needs_readout(choice: Choice, calibration: SensorCalibration) -> bool:
    """Whether a reconstructor is one of ours that reads forces by a trained read-out."""
    return name_used(choice, calibration) in _TRAINED


def check_reconstructor(choice: Choice, calibration: SensorCalibration) -> None:
    """Refuse, before anything is computed, a reconstructor that cannot read this sensor.

    Raises
    ------
    UserError
        When there is none of that name, it cannot be imported, it needs a trained read-out and the
        sensor has none, or it reads a dome of silicone and the sensor is none.
    """
    load_reconstructor(choice)
    if needs_readout(choice, calibration):
        required_readout(calibration)
    elif (name := name_used(choice, calibration)) in DOME_METHODS:
        if calibration.sensor.shape.flat:
            raise UserError(f"reconstructor {name} reads a dome of silicone, not a flat pad")
        with located(f"sensor {calibration.name}".rstrip()):
            calibration.sensor.dome  # noqa: B018 (refuses what has none)
