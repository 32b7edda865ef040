"""Reconstructors by name, which estimate a force field with its covariance from tracks."""

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
    """Estimates forces from the tracks of one specimen; constructed by `Class(calibration, rest)`.

    A field has a `friction_reading` if µ was estimated together with the forces, and a
    `totals_covariance` if its sums have known errors.
    """

    def reset(self) -> None:
        """Forget previous frames: the next one counts as the first."""
        ...

    def update(self, tracks: Tracks) -> ForceField:
        """Estimate the force field of the next frame.

        Raises
        ------
        NoEstimateError
            When the frame does not determine the forces: too few markers are visible, or no forces
            explain them.
        """
        ...


#: Reconstructors that differ in method, by name; `auto` chooses among them.
METHODS = {
    "sequential": (
        ".chain.learned:Learned",
        "read-out trained on random grips, over codes averaged while the skin holds still",
    ),
    "way": (
        ".chain.way_reading:WayReading",
        "chains that follow a contact from its first touch on, averaged with sequential",
    ),
    "contact": (
        ".dome.contact:ContactReading",
        "a contact fitted by synthesis, on a dome of silicone",
    ),
}
#: Name of the default reconstructor.
DEFAULT_RECONSTRUCTOR = "auto"
#: Body that the pictures show: the revolved chain, or a silicone dome.
Body = Literal["chain", "dome"]
#: Method that `auto` selects, by body.
AUTOMATIC: dict[Body, str] = {"chain": "way", "dome": "contact"}
#: Built-in methods for a silicone dome; the others are for a chain.
DOME_METHODS = ("contact",)
#: All reconstructors by name, including `auto`.
RECONSTRUCTORS = Registry(
    protocol=Reconstructor,
    package=__package__,
    given=2,
    entries={
        DEFAULT_RECONSTRUCTOR: (
            ".reconstructors:automatic",
            "way, or contact for a dome with soft markers or a layer on its rigid core",
        ),
        **METHODS,
    },
)
#: Names of the reconstructors that need a trained read-out.
_TRAINED = ("sequential", "way")


def automatic(calibration: SensorCalibration, rest: Tracks) -> Reconstructor:
    """Make the reconstructor that `auto` selects for a sensor.

    Raises
    ------
    UserError
        When the sensor needs a trained read-out and has none.
    """
    name = name_used(DEFAULT_RECONSTRUCTOR, calibration)
    check_reconstructor(name, calibration)
    return load_reconstructor(name)(calibration, rest)


def body_read(calibration: SensorCalibration) -> Body:
    """Body that `auto` assumes for a sensor.

    It is a dome if the markers stretch with the silicone or lie on its rigid core, as in a real
    dome. The designs of the thesis count as chains and use their trained read-out.
    """
    sensor = calibration.nominal
    built = bool(sensor.markers.swell_mm) or not sensor.inner.follow
    built &= sensor.silicone is not None and not sensor.shape.flat  # no method reads a pad
    return "dome" if built else "chain"


def load_reconstructor(
    choice: Choice, arguments: Mapping[str, Any] | None = None
) -> Callable[[SensorCalibration, Tracks], Reconstructor]:
    """Load a factory of reconstructors, which takes a calibration and the tracks at rest.

    Parameters
    ----------
    choice: built-in name, name of an entry point, `module:Class`, or a class or other factory
    arguments: further arguments of the class, by name

    Raises
    ------
    UserError
        When no reconstructor has that name, or it cannot be imported.
    """
    factory: Callable[[SensorCalibration, Tracks], Reconstructor]
    factory = RECONSTRUCTORS.load(choice, arguments)
    return factory


def name_used(choice: Choice, calibration: SensorCalibration) -> str:
    """Name of a reconstructor; for `auto`, of the one that it selects."""
    automatic = choice == DEFAULT_RECONSTRUCTOR
    return AUTOMATIC[body_read(calibration)] if automatic else name_of(choice)


def needs_readout(choice: Choice, calibration: SensorCalibration) -> bool:
    """Whether a reconstructor is a built-in one that needs a trained read-out."""
    return name_used(choice, calibration) in _TRAINED


def check_reconstructor(choice: Choice, calibration: SensorCalibration) -> None:
    """Refuse, before anything is computed, a reconstructor that does not suit this sensor.

    Raises
    ------
    UserError
        When no reconstructor has that name, it cannot be imported, it needs a trained read-out and
        the sensor has none, or it needs a silicone dome and the sensor is not one.
    """
    load_reconstructor(choice)
    if needs_readout(choice, calibration):
        required_readout(calibration)
    elif (name := name_used(choice, calibration)) in DOME_METHODS:
        if calibration.sensor.shape.flat:
            raise UserError(f"reconstructor {name} reads a dome of silicone, not a flat pad")
        with located(f"sensor {calibration.name}".rstrip()):
            calibration.sensor.dome  # noqa: B018 (refuses what has none)
