"""Values of a dome of silicone that presses can determine, and which of them a design has."""

from typing import Annotated

from msgspec import Meta

from ...render import SensorDesign
from ...strict_toml import Table

Positive = Annotated[float, Meta(gt=0.0, le=1e6)]
NotNegative = Annotated[float, Meta(ge=0.0, le=1e6)]

#: A layer nearer to the core than this share of the silicone does not move.
ON_CORE = 0.05
#: Error of the model of silicone, as a share of forces; presses do not make it smaller.
SILICONE_ERROR = 0.02


class SiliconeValues(Table, frozen=True, kw_only=True):
    """Values of a dome of silicone that presses can determine; see `Silicone` of a design.

    `yellow_depth_mm` is that of a layer that moves. Without it the yellow layer keeps its distance
    from the core.
    """

    core_mm: Positive
    young_kpa: Positive
    poisson: Annotated[float, Meta(ge=0.0, le=0.495)]
    magenta_depth_mm: NotNegative
    yellow_depth_mm: NotNegative | None = None


def silicone_names(sensor: SensorDesign) -> tuple[str, ...]:
    """Names of the `SiliconeValues` that a dome of silicone has, Young's modulus last."""
    inner = ("yellow_depth_mm",) if yellow_moves(sensor) else ()
    return ("core_mm", "poisson", "magenta_depth_mm", *inner, "young_kpa")


def yellow_moves(sensor: SensorDesign) -> bool:
    """Whether the yellow layer of a dome of silicone lies in it, not on its core."""
    assert sensor.silicone is not None
    thickness = 1e3 * sensor.shape.radius - sensor.silicone.core_mm
    return sensor.yellow.depth_mm < (1.0 - ON_CORE) * thickness
