"""The silicone of a dome as the mechanics take it."""

from typing import Annotated

from msgspec import Meta

from ...model import Dome
from ...strict_toml import Table

Positive = Annotated[float, Meta(gt=0.0, le=1e6)]


class Silicone(Table, frozen=True, kw_only=True):
    """Silicone between the skin and a rigid core, as the body `dome` has it.

    `core_mm` is the core's radius, `young_kpa` Young's modulus, `poisson` Poisson's ratio.
    `pitch_mm` is the distance between neighbouring nodes of the skin; 0 is a twentieth of the
    radius.
    """

    core_mm: Positive
    young_kpa: Positive = 400.0
    poisson: Annotated[float, Meta(ge=0.0, le=0.495)] = 0.48
    pitch_mm: Annotated[float, Meta(ge=0.0, le=1e3)] = 0.0

    def dome(self, radius: float) -> Dome:
        """The body of a dome of that radius [m].

        Raises
        ------
        UserError
            When the silicone and the radius make no dome.
        """
        return Dome(
            radius=radius,
            core=1e-3 * self.core_mm,
            young=1e3 * self.young_kpa,
            poisson=self.poisson,
            pitch=1e-3 * self.pitch_mm or None,
        )
