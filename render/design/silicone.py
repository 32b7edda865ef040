"""The silicone of a sensor, for the mechanics."""

from typing import Annotated

from msgspec import Meta

from ...errors import UserError
from ...model import Dome, Pad, SoftBody
from ...strict_toml import Table

Positive = Annotated[float, Meta(gt=0.0, le=1e6)]
NotNegative = Annotated[float, Meta(ge=0.0, le=1e6)]


class Silicone(Table, frozen=True, kw_only=True):
    """Silicone between the skin and the rigid core or base, for the body `dome`.

    Attributes
    ----------
    core_mm: radius of a dome's core [mm]; 0 for a pad
    thickness_mm: thickness of the silicone on the base of a pad [mm]; 0 for a dome
    young_kpa: Young's modulus [kPa]
    poisson: Poisson's ratio
    pitch_mm: distance between neighbouring nodes of the skin [mm]; 0: a twentieth of a dome's
        radius, a 64th of a pad's side
    """

    core_mm: NotNegative = 0.0
    thickness_mm: NotNegative = 0.0
    young_kpa: Positive = 400.0
    poisson: Annotated[float, Meta(ge=0.0, le=0.495)] = 0.48
    pitch_mm: Annotated[float, Meta(ge=0.0, le=1e3)] = 0.0

    def body(self, radius: float, flat: bool) -> SoftBody:
        """Build a dome of that radius, or a pad of that half side [m].

        Raises
        ------
        UserError
            When silicone and radius do not make a valid body.
        """
        if bool(self.thickness_mm) != flat or bool(self.core_mm) == flat:
            raise UserError(
                "[silicone] of a pad has thickness_mm, that of a dome core_mm, and not the other"
            )
        young, pitch = 1e3 * self.young_kpa, 1e-3 * self.pitch_mm or None
        if flat:
            return Pad(
                radius=radius,
                thickness=1e-3 * self.thickness_mm,
                young=young,
                poisson=self.poisson,
                pitch=pitch,
            )
        return Dome(
            radius=radius,
            core=1e-3 * self.core_mm,
            young=young,
            poisson=self.poisson,
            pitch=pitch,
        )
