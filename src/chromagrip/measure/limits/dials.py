"""Properties of a design that a sweep of limits varies, one at a time."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from msgspec import structs

from ...errors import UserError
from ...render import SensorDesign
from ...render.design import Geodesic, Spiral

#: Multiples of a design's own value that are tried, from the easiest to make to the hardest.
STEPS = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0)
#: The inner layer lies at least so much deeper than the outer one, over the thickness.
_APART = 0.05


@dataclass(frozen=True, kw_only=True)
class Dial:
    """One property of a design.

    Attributes
    ----------
    label, unit: of its value
    change: the design with a setting
    value: of a design; None for the noise, which is no property of it
    tried: settings
    multiples: whether they are multiples of the design's own value; the noise is divided by them
    """

    label: str
    unit: str
    change: Callable[[SensorDesign, float], SensorDesign]
    value: Callable[[SensorDesign], float] | None
    tried: tuple[float, ...] = STEPS
    multiples: bool = True

    @property
    def axis(self) -> str:
        """Label with the unit."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label


def _more_markers(sensor: SensorDesign, share: float) -> SensorDesign:
    plan = sensor.layout
    if not isinstance(plan, Spiral | Geodesic):
        raise UserError("only a spiral or a geodesic layout can have another count")
    layout = structs.replace(plan, count=round(plan.count * share))
    if isinstance(layout, Geodesic):
        pitch = layout.meridian_pitch_mm / np.sqrt(share)
        layout = structs.replace(layout, meridian_pitch_mm=pitch)
    return structs.replace(sensor, layout=layout)


def _more_pixels(sensor: SensorDesign, share: float) -> SensorDesign:
    """More pixels, with the same blur in pixels."""
    old = sensor.camera
    if old.focal_px is None:
        raise UserError("a camera from a calibration file has its own resolution")
    fx, fy = old.focal_px
    camera = structs.replace(
        old,
        width_px=round(old.width_px * share),
        height_px=round(old.height_px * share),
        focal_px=(fx * share, fy * share),
        centre_px=old.centre_px and tuple((c + 0.5) * share - 0.5 for c in old.centre_px),
    )
    return structs.replace(sensor, camera=camera)


def _larger_markers(sensor: SensorDesign, share: float) -> SensorDesign:
    magenta, yellow = (
        structs.replace(layer, size_mm=layer.size_mm * share) for layer in sensor.layers
    )
    return structs.replace(sensor, magenta=magenta, yellow=yellow)


def _deeper(number: int) -> Callable[[SensorDesign, float], SensorDesign]:
    """Change of the depth of a layer, over the silicone's thickness."""

    def change(sensor: SensorDesign, depth: float) -> SensorDesign:
        layers, thickness = list(sensor.layers), 1e3 * sensor.dome.thickness
        layers[number] = structs.replace(layers[number], depth_mm=depth * thickness)
        if layers[1].depth_mm - layers[0].depth_mm < _APART * thickness:
            raise UserError("the inner layer would not lie below the outer one")
        return structs.replace(sensor, magenta=layers[0], yellow=layers[1])

    return change


def _camera_at(sensor: SensorDesign, place: float) -> SensorDesign:
    """The camera elsewhere on the axis, with a lens by which the markers fill as much of it."""
    camera = sensor.camera
    if camera.focal_px is None:
        raise UserError("a camera from a calibration file has its own lens")
    hollow = 1e3 * sensor.view.port
    points = np.concatenate([sensor.shape.points(sensor.places, depth) for depth in sensor.depths])
    middle = sensor.view.project(np.array([[0.0, 0.0, sensor.shape.radius]]))
    moved = replace(sensor.view, position=1e-3 * place * hollow)
    reach = [
        float(np.linalg.norm(view.project(points) - middle, axis=-1).max())
        for view in (sensor.view, moved)
    ]
    fx, fy = (reach[0] / reach[1] * focal for focal in camera.focal_px)
    camera = structs.replace(camera, position_mm=place * hollow, focal_px=(fx, fy))
    return structs.replace(sensor, camera=camera)


#: Depths are over the silicone's thickness, places of the camera over the radius of the hollow.
DIALS = {
    "outer": Dial(
        label="depth of the outer layer",
        unit="thicknesses",
        change=_deeper(0),
        value=lambda s: float(s.depths[0]) / s.dome.thickness,
        tried=(0.05, 0.1, 0.17, 0.25, 0.35, 0.5),
        multiples=False,
    ),
    "inner": Dial(
        label="depth of the inner layer",
        unit="thicknesses",
        change=_deeper(1),
        value=lambda s: float(s.depths[1]) / s.dome.thickness,
        tried=(0.25, 0.35, 0.5, 0.65, 0.8, 0.95, 1.0),
        multiples=False,
    ),
    "size": Dial(
        label="marker size", unit="mm", change=_larger_markers, value=lambda s: s.magenta.size_mm
    ),
    "height": Dial(
        label="image height", unit="px", change=_more_pixels, value=lambda s: s.camera.height_px
    ),
    "camera": Dial(
        label="camera towards the apex",
        unit="hollows",
        change=_camera_at,
        value=lambda s: 1e-3 * s.camera.position_mm / s.view.port,
        tried=(-0.4, -0.2, 0.0, 0.2, 0.4, 0.6),
        multiples=False,
    ),
    "markers": Dial(
        label="marker pairs", unit="", change=_more_markers, value=lambda s: len(s.places)
    ),
    "noise": Dial(label="noise", unit="levels", change=lambda s, share: s, value=None),
}
