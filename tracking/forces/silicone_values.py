"""Parameters of a silicone dome that can be fitted to presses, and which of them a design has."""

from typing import Annotated

from msgspec import Meta

from ...render import SensorDesign
from ...strict_toml import Table

Positive = Annotated[float, Meta(gt=0.0, le=1e6)]
NotNegative = Annotated[float, Meta(ge=0.0, le=1e6)]

#: Distance from the core, over the thickness, below which a layer counts as fixed.
ON_CORE = 0.05
#: Relative error of forces due to the silicone model; presses do not reduce it.
SILICONE_ERROR = 0.02


class SiliconeValues(Table, frozen=True, kw_only=True):
    """Parameters of a silicone dome that can be fitted to presses; see `Silicone` of a design.

    `yellow_depth_mm` is the depth of a moving yellow layer. Without it the layer keeps its distance
    from the core.
    """

    core_mm: Positive
    young_kpa: Positive
    poisson: Annotated[float, Meta(ge=0.0, le=0.495)]
    magenta_depth_mm: NotNegative
    yellow_depth_mm: NotNegative | None = None


def silicone_names(sensor: SensorDesign) -> tuple[str, ...]:
    """Names of the `SiliconeValues` that a silicone dome has, Young's modulus last."""
    inner = ("yellow_depth_mm",) if yellow_moves(sensor) else ()
    return ("core_mm", "poisson", "magenta_depth_mm", *inner, "young_kpa")


def yellow_moves(sensor: SensorDesign) -> bool:
    """Whether the yellow layer of a silicone dome moves, as it does not lie on the core."""
    assert sensor.silicone is not None
    thickness = 1e3 * sensor.shape.radius - sensor.silicone.core_mm
    return sensor.inner.depth_mm < (1.0 - ON_CORE) * thickness
