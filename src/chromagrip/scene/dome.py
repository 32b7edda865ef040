"""The silicone of a scene's body `dome`: changes to the silicone of the sensor's design."""

from dataclasses import replace
from typing import Annotated, Any

from msgspec import Meta

from ..errors import located
from ..model import SoftBody
from ..strict_toml import NotNegative, Table


class DomeSettings(Table, frozen=True):
    """Silicone of the body `dome`; 0 keeps the value of the sensor's design.

    Attributes
    ----------
    pitch_mm: distance between neighbouring nodes of the skin [mm]
    young_kpa: Young's modulus of the silicone [kPa]
    poisson: Poisson's ratio of the silicone
    thickness_mm: thickness of the silicone on the rigid core or base [mm]
    relaxation_ms: time constant of its viscosity [ms]
    stiffening: whether it stiffens as it is pressed towards the core
    """

    pitch_mm: NotNegative = 0.0
    young_kpa: NotNegative = 0.0
    poisson: Annotated[float, Meta(ge=0.0, le=0.495)] = 0.0
    thickness_mm: NotNegative = 0.0
    relaxation_ms: Annotated[float, Meta(ge=0.0, le=1e4)] = 0.0
    stiffening: bool = True

    def changed(self, dome: SoftBody) -> SoftBody:
        """Apply these changes to a design's body.

        Raises
        ------
        UserError
            For changes that do not make a valid body.
        """
        changes: dict[str, Any] = {
            "pitch": 1e-3 * self.pitch_mm,
            "young": 1e3 * self.young_kpa,
            "poisson": self.poisson,
            "relaxation": 1e-3 * self.relaxation_ms,
        }
        thickness = 1e-3 * self.thickness_mm
        given = {name: value for name, value in changes.items() if value}
        changed = replace(dome, **given, stiffening=self.stiffening)
        if not thickness:
            return changed
        with located(f"dome.thickness_mm = {self.thickness_mm:g}"):
            return changed.with_thickness(thickness)
