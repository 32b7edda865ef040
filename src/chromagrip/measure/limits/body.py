"""A case, and what a body answers for a design; `chain` and `dome.report` are the bodies."""

import math
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...render import SensorDesign
from ...scene.scene import Body

Array = NDArray[np.float64]

#: Smallest safety margin that leaves room for differences.
_RESERVE = 0.02


@dataclass(frozen=True, kw_only=True)
class Case:
    """Contact and camera whose limits are computed; units as in the command's options.

    The azimuth and the number of shears are options of a dome.
    """

    body: Body
    grip_n: float
    load_n: float
    azimuth_deg: float
    friction: float
    radius_mm: float
    stiffness_kpa: float
    shears: int
    noise_levels: float
    frames: int
    margin_error: float | None

    @property
    def title(self) -> str:
        """The case in one line."""
        form = "flat" if math.isinf(self.radius_mm) else f"of radius {self.radius_mm:g} mm"
        grip, way, pictures = {
            "chain": ("Grip", "", ""),
            "dome": (
                "Dome: grip",
                f" at {self.azimuth_deg:g}°",
                f"pictures of the press: 1, of the shear: {self.shears}; ",
            ),
        }[self.body]
        return (
            f"{grip} {self.grip_n:g} N, load {self.load_n:g} N{way}, µ {self.friction:g}, "
            f"object {form}, {self.stiffness_kpa:g} kPa; {pictures}noise {self.noise_levels:g} "
            f"levels, frames averaged: {self.frames}"
        )

    def entries(self) -> dict[str, Any]:
        """Entries of a JSON file; the radius of a flat object is None."""
        found = asdict(self) | ({"radius_mm": None} if math.isinf(self.radius_mm) else {})
        unused = {"chain": ("body", "azimuth_deg", "shears"), "dome": ()}[self.body]
        return {name: value for name, value in found.items() if name not in unused}


@dataclass(frozen=True, kw_only=True)
class BodyLimit(ABC):
    """Limits of one design in one contact, computed when they are asked for.

    Attributes
    ----------
    GRIP: default grip force [N]
    LOAD: default load: a force [N], and what is added as a share of µ times the grip
    COLUMNS: key, heading, and factor to its unit, of each column of printed limits
    DIALS: properties that are varied, keys of `dials.DIALS`
    ERRORS: errors of each point of a sweep, as the table names them
    CURVES: key, axis label, and factor to its unit, of each error in the chart
    NEAREST: whether a needed value is the nearest to the design; otherwise it is the easiest
    NEEDS: conditions of the needed values
    design: sensor
    levels: standard deviation of each sRGB level
    frames: averaged in each picture
    """

    GRIP: ClassVar[float]
    LOAD: ClassVar[tuple[float, float]]
    COLUMNS: ClassVar[tuple[tuple[str, str, float], ...]]
    DIALS: ClassVar[tuple[str, ...]]
    ERRORS: ClassVar[tuple[str, ...]]
    CURVES: ClassVar[tuple[tuple[str, str, float], ...]]
    NEAREST: ClassVar[bool]
    NEEDS: ClassVar[str]

    design: SensorDesign
    levels: float
    frames: int = 1

    @staticmethod
    @abstractmethod
    def default_designs() -> tuple[str, ...]:
        """Names of the designs by default."""

    @classmethod
    @abstractmethod
    def of(cls, case: Case, name: str) -> Self:
        """Load a design; refuse a case or a design that has no such limits."""

    @abstractmethod
    def entry(self) -> dict[str, Any]:
        """Truth and limits, as the entry of a JSON file."""

    @staticmethod
    @abstractmethod
    def words(entry: dict[str, Any]) -> tuple[str, dict[str, dict[str, float | None]]]:
        """Heading of a design's printed limits, and its rows, from its entry."""

    @abstractmethod
    def errors(self, design: SensorDesign, levels: float) -> dict[str, float]:
        """ERRORS of another design and noise in the same contact."""

    def pair_errors(self) -> tuple[Array, dict[str, Array]]:
        """Angle of each marker pair from the apex [°], and what it shows by direction [m]."""
        return np.zeros(0), {}


def reserve_of(grip: float, load: float, friction: float) -> float:
    """Safety margin of a load under a grip [N].

    Raises
    ------
    UserError
        When the grip does not hold the load with room for differences.
    """
    reserve = 1.0 - abs(load) / (friction * grip) if grip > 0.0 else -1.0
    if not (math.isfinite(grip) and reserve >= _RESERVE):
        raise UserError(
            f"a grip of {grip:g} N must hold a load of {load:g} N with a safety margin of "
            f"{_RESERVE:g} or more, but a friction of {friction:g} leaves {reserve:.3g}"
        )
    return reserve
