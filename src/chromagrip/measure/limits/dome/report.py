"""All limits of one design in one contact, and the reconstructors that can read it."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ....errors import UserError
from ....model import Dome
from ....render import SensorDesign
from ....tracking.forces.dome import PLACE_ERROR, SIZE_ERROR
from .held import Grip, Held, hold
from .limit import ZONES, Deviations, Noise, Seen, moving_layers

#: Names of the two models of noise.
NOISES = ("bound", "bound plus misfit")
#: A reconstructor can read a design that leaves so much of the grip open, misfit included.
READ = 0.05


@dataclass(frozen=True, kw_only=True)
class DomeLimit:
    """Limits of a design.

    Attributes
    ----------
    held: the contact
    moving: layers of markers that do not lie on the core
    contact: deviations of a contact that is fitted, by noise
    tractions: of free tractions, by zone and noise
    read_by: reconstructors that can read the design
    """

    held: Held
    moving: int
    contact: dict[str, Deviations]
    tractions: dict[str, dict[str, Deviations]]
    read_by: tuple[str, ...]

    def rows(self) -> dict[str, dict[str, Deviations]]:
        """Deviations by what is fitted, then by noise."""
        return {"contact": self.contact} | {f"tractions, {z}": d for z, d in self.tractions.items()}

    def entry(self) -> dict[str, Any]:
        """Entry of a JSON file; what is not told is None."""
        names = ("x_n", "y_n", "normal_n", "moment_nm", "pressing_n", "sliding_n")
        return {
            "truth": dict(zip(names, map(float, self.held.sums), strict=True))
            | {"mu": self.held.friction, "margin": self.held.margin},
            "moving_layers": self.moving,
            "read_by": list(self.read_by),
            "deviations": {
                what: {noise: entry_of(found) for noise, found in each.items()}
                for what, each in self.rows().items()
            },
        }


def entry_of(found: Deviations) -> dict[str, float | None]:
    """Deviations with their units."""
    units = {"x": "x_n", "y": "y_n", "normal": "normal_n", "moment": "moment_nm"}
    return {
        units.get(name, name): None if np.isnan(value) else value
        for name, value in asdict(found).items()
    }


def noise_models(levels: float, frames: int = 1) -> dict[str, Noise]:
    """Both models of noise: the tracker's bound, and that with what `contact` reckons with."""
    return {
        NOISES[0]: Noise(levels=levels, frames=frames),
        NOISES[1]: Noise(levels=levels, frames=frames, place_px=PLACE_ERROR, log_size=SIZE_ERROR),
    }


def dome_limit(
    sensor: SensorDesign,
    grip: Grip,
    noises: dict[str, Noise],
    progress: Callable[[str], None] = lambda text: None,
) -> DomeLimit:
    """Limits of a design in a contact.

    Parameters
    ----------
    sensor: design, see `dome_of`
    grip: the contact
    noises: by name, see `noise_models`
    progress: called with what is done next

    Raises
    ------
    UserError
        For a design without a dome of silicone, and a contact that cannot be held.
    """
    dome = dome_of(sensor)
    progress("contact")
    held = held_by(dome, grip)
    seen = Seen(sensor, held)
    contact = {name: seen.contact(noise) for name, noise in noises.items()}
    tractions = {}
    for zone in ZONES:
        progress(f"free tractions, {zone}")
        found = seen.tractions(list(noises.values()), seen.zone(zone))
        tractions[zone] = dict(zip(noises, found, strict=True))
    moving, enough = moving_layers(sensor, dome), READ * grip.normal
    able = {
        "contact": moving > 0 and contact[NOISES[1]].normal < enough,
        "traction": moving > 1 and tractions[ZONES[1]][NOISES[1]].normal < enough,
    }
    return DomeLimit(
        held=held,
        moving=moving,
        contact=contact,
        tractions=tractions,
        read_by=tuple(name for name, can in able.items() if can),
    )


def dome_of(sensor: SensorDesign) -> Dome:
    """The silicone of a design.

    Raises
    ------
    UserError
        For a pad, a design that says nothing of its silicone, and markers that are no discs.
    """
    if sensor.shape.flat:
        raise UserError("a flat pad has no dome")
    if sensor.markers.form != "disc":
        raise UserError("the bound of markers is that of discs")
    dome = sensor.dome
    assert isinstance(dome, Dome)
    return dome


@lru_cache(maxsize=8)
def held_by(dome: Dome, grip: Grip) -> Held:
    """`hold`, which is the same for all designs of a dome's markers and camera."""
    return hold(dome, grip)
