"""Limits of a design with a dome of silicone, and the reconstructors that can read it."""

import math
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, Self

from ....errors import UserError, located
from ....render import SensorDesign, load_sensor, sensor_names
from ....tracking.forces.dome import PLACE_ERROR, SIZE_ERROR
from ..body import BodyLimit, Case
from .held import SUMS, Grip, Held, hold
from .limit import ZONES, Deviations, Noise, Seen, moving_layers

#: Names of the two models of noise.
NOISES = ("bound", "bound plus misfit")
#: A reconstructor can read a design that leaves so much of the grip open, misfit included.
READ = 0.05
#: Largest number of pictures of a shear.
_MOST = 20
#: Names of values in a JSON file, where they have a unit.
_UNITS = {"moment": "moment_nm"} | {name: f"{name}_n" for name in SUMS if name != "moment"}


@dataclass(frozen=True, kw_only=True)
class DomeLimit(BodyLimit):
    """Limits of a design with a dome of silicone.

    Attributes
    ----------
    grip: what is held
    """

    GRIP = 3.0
    LOAD = (0.0, 0.7)
    COLUMNS = (
        ("x_n", "F_x mN", 1e3),
        ("y_n", "F_y mN", 1e3),
        ("normal_n", "F_n mN", 1e3),
        ("moment_nm", "M_z µN·m", 1e6),
        ("mu", "µ", 1.0),
        ("margin", "Γ", 1.0),
    )
    DIALS = ("outer", "inner", "size", "height", "camera", "markers", "noise")
    ERRORS = ("margin_bound", "margin_error", "normal_error_n")
    CURVES = (
        ("margin_error", "deviation of Γ\nof a contact", 1.0),
        ("normal_error_n", "deviation of F_n [mN],\ntractions, zone known", 1e3),
    )
    NEAREST = True
    NEEDS = " by a contact, misfit included, all else as designed (nearest to the design)"

    grip: Grip

    def __post_init__(self) -> None:
        self.design.round_dome("limit --body dome")
        if self.design.markers.form != "disc":
            raise UserError("the bound of markers is that of discs")

    @staticmethod
    def default_designs() -> tuple[str, ...]:
        """All shipped designs with a dome of silicone."""
        every = {name: load_sensor(name) for name in sensor_names()}
        return tuple(n for n, s in every.items() if not s.shape.flat and s.silicone is not None)

    @classmethod
    def of(cls, case: Case, name: str) -> Self:
        """Load a design; refuse options that are not possible."""
        for option, value in (
            ("--friction", case.friction),
            ("--radius-mm", case.radius_mm),
            ("--stiffness-kpa", case.stiffness_kpa),
        ):
            if not value > 0.0:
                raise UserError(f"{option} must be above 0, got {value:g}")
        if not math.isfinite(case.azimuth_deg):
            raise UserError(f"--azimuth-deg must be finite, got {case.azimuth_deg:g}")
        if not 1 <= case.shears <= _MOST:
            raise UserError(f"--shears must be 1 to {_MOST}, got {case.shears}")
        grip = Grip(
            normal=case.grip_n,
            load=case.load_n,
            azimuth=math.radians(case.azimuth_deg),
            friction=case.friction,
            radius=1e-3 * case.radius_mm,
            young=1e3 * case.stiffness_kpa,
            shears=case.shears,
        )
        design = load_sensor(name)
        with located(f"sensor {name}"):
            return cls(design=design, levels=case.noise_levels, frames=case.frames, grip=grip)

    @cached_property
    def seen(self) -> Seen:
        """The contact in the pictures of the design."""
        return Seen(self.design, self.held)

    @property
    def held(self) -> Held:
        """The contact, which is the same for all markers and cameras of a dome."""
        return hold(self.design.round_dome("limit --body dome"), self.grip)

    def noises(self, levels: float) -> dict[str, Noise]:
        """Both models of noise: the tracker's bound, and that with the misfit of `contact`."""
        bound = Noise(levels=levels, frames=self.frames)
        misfit = replace(bound, place_px=PLACE_ERROR, log_size=SIZE_ERROR)
        return dict(zip(NOISES, (bound, misfit), strict=True))

    def entry(self) -> dict[str, Any]:
        """Truth, moving layers, the reconstructor that can read the design, and limits."""
        noises, seen, held = self.noises(self.levels), self.seen, self.held
        found = {"contact": {name: seen.contact(noise) for name, noise in noises.items()}}
        for zone in ZONES:
            free = seen.tractions(list(noises.values()), seen.zone(zone))
            found[f"tractions, {zone}"] = dict(zip(noises, free, strict=True))
        moving, enough = moving_layers(self.design, held.dome), READ * self.grip.normal
        able = moving > 0 and found["contact"][NOISES[1]].normal < enough
        truth = {_UNITS[name]: float(value) for name, value in zip(SUMS, held.sums, strict=True)}
        return {
            "truth": truth | {"mu": held.friction, "margin": held.margin},
            "moving_layers": moving,
            "read_by": ["contact"] if able else [],
            "deviations": {
                what: {noise: _entry_of(deviations) for noise, deviations in each.items()}
                for what, each in found.items()
            },
        }

    @staticmethod
    def words(entry: dict[str, Any]) -> tuple[str, dict[str, dict[str, float | None]]]:
        """Layers, true Γ and reconstructors, and a row for each reading and model of noise."""
        moving = {1: "one layer moves", 2: "both layers move"}
        layers = moving.get(entry["moving_layers"], "no layer moves")
        read = ", ".join(entry["read_by"]) or "no reconstructor"
        rows = {
            f"{what}, {noise}": found
            for what, each in entry["deviations"].items()
            for noise, found in each.items()
        }
        return f"{layers}, true Γ {entry['truth']['margin']:.3f}; read by {read}", rows

    def errors(self, design: SensorDesign, levels: float) -> dict[str, float]:
        """Γ of a contact with both models of noise, and F_n of free tractions, zone known."""
        seen = self.seen if design is self.design else Seen(design, self.held)
        bound, misfit = self.noises(levels).values()
        free = seen.tractions([misfit], seen.held.touching)[0]
        margins = (seen.contact(noise).margin for noise in (bound, misfit))
        return dict(zip(self.ERRORS, (*margins, free.normal), strict=True))


def _entry_of(found: Deviations) -> dict[str, float | None]:
    """Deviations with their units; None where one is unknown."""
    return {
        _UNITS.get(name, name): None if math.isnan(value) else value
        for name, value in asdict(found).items()
    }
