"""The silicone of a sensor as the mechanics take it."""

from typing import Annotated

from msgspec import Meta

from ...errors import UserError
from ...model import Dome, Pad, SoftBody
from ...strict_toml import Table

Positive = Annotated[float, Meta(gt=0.0, le=1e6)]
NotNegative = Annotated[float, Meta(ge=0.0, le=1e6)]


class Silicone(Table, frozen=True, kw_only=True):
    """Silicone between the skin and what is rigid, as the body `dome` has it.

    `core_mm` is the radius of a dome's core, `thickness_mm` the silicone's on the base of a pad;
    one is given, the other 0. `young_kpa` is Young's modulus, `poisson` Poisson's ratio. `pitch_mm`
    is the distance between neighbouring nodes of the skin; 0 is a twentieth of a dome's radius, a
    64th of a pad's side.
    """

    core_mm: NotNegative = 0.0
    thickness_mm: NotNegative = 0.0
    young_kpa: Positive = 400.0
    poisson: Annotated[float, Meta(ge=0.0, le=0.495)] = 0.48
    pitch_mm: Annotated[float, Meta(ge=0.0, le=1e3)] = 0.0

    def body(self, radius: float, flat: bool) -> SoftBody:
        """The body of a dome of that radius, or of a pad of that half side [m].

        Raises
        ------
        UserError
            When the silicone and the radius make no body.
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
