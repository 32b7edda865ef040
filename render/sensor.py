"""Sensor designs as data: dome, marker layers, dyes, camera, ground; SI inside, mm only in TOML."""

import tomllib
from importlib.resources import files
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from .camera import FisheyeCamera
from .layout import marker_directions

Positive = Annotated[float, Meta(gt=0.0, le=1e6)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Level = Annotated[int, Meta(ge=0, le=255)]
Triple = tuple[Share, Share, Share]
Colour = tuple[Level, Level, Level]

#: Marker layers in the order of every array that has a layer axis.
LAYERS = ("magenta", "yellow")


class Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A TOML table that refuses unknown keys."""


class Dome(Table, frozen=True):
    """Outer radius of the dome."""

    radius_mm: Positive


class Markers(Table, frozen=True):
    """Discs over the dome: a spiral lattice plus a row on the chain's own meridian."""

    count: Annotated[int, Meta(ge=40, le=5000)]
    diameter_mm: Positive
    coverage_deg: Annotated[float, Meta(ge=10.0, le=89.0)]
    meridian_pitch_mm: Positive


class Layer(Table, frozen=True):
    """One layer of markers: depth under the skin, share of its motion, dye in linear light."""

    depth_mm: Annotated[float, Meta(ge=0.0)]
    follow: Share
    transmittance: Triple


class CameraSettings(Table, frozen=True):
    """Equidistant fisheye at the sphere centre."""

    width_px: Annotated[int, Meta(ge=32, le=8192)]
    height_px: Annotated[int, Meta(ge=32, le=8192)]
    focal_px_per_rad: Positive
    blur_px: Annotated[float, Meta(ge=0.3, le=10.0)]


class Ground(Table, frozen=True):
    """sRGB of the diffusing skin at apex and rim, and of the housing outside the dome."""

    apex: Colour
    rim: Colour
    housing: Colour


class SensorDesign(Table, frozen=True):
    """A whole sensor. What an estimator may know of it is its calibration."""

    description: str
    dome: Dome
    markers: Markers
    magenta: Layer
    yellow: Layer
    camera: CameraSettings
    ground: Ground

    def __post_init__(self) -> None:
        if not self.magenta.follow > 0.0:
            raise ValueError(
                "magenta.follow = 0 must be above 0: the outer layer moves with the skin"
            )
        for name, layer in zip(LAYERS, self.layers, strict=True):
            if layer.depth_mm >= self.dome.radius_mm:
                raise ValueError(
                    f"{name}.depth_mm = {layer.depth_mm} must be less than dome.radius_mm"
                )

    @property
    def layers(self) -> tuple[Layer, Layer]:
        """Both layers, from the skin inwards."""
        return (self.magenta, self.yellow)

    @property
    def layer_radii(self) -> NDArray[np.float64]:
        """Radius of the sphere that each layer's markers lie on at rest [m], shape (2,)."""
        return np.array([(self.dome.radius_mm - layer.depth_mm) * 1e-3 for layer in self.layers])

    @property
    def follow(self) -> NDArray[np.float64]:
        """Share of the skin's displacement made by each layer, shape (2,)."""
        return np.array([layer.follow for layer in self.layers])

    @property
    def transmittance(self) -> NDArray[np.float64]:
        """Linear-light transmittance of each dye, shape (2, 3)."""
        return np.array([layer.transmittance for layer in self.layers])

    @property
    def marker_radius(self) -> float:
        """Radius of a marker [m]."""
        return self.markers.diameter_mm * 0.5e-3

    def directions(self) -> NDArray[np.float64]:
        """Marker directions (θ from the apex, φ from the load) [rad], shape (M, 2)."""
        markers = self.markers
        return marker_directions(
            markers.count,
            np.deg2rad(markers.coverage_deg),
            markers.meridian_pitch_mm / self.dome.radius_mm,
        )

    def lens(self) -> FisheyeCamera:
        """Camera in the sensor frame."""
        camera = self.camera
        return FisheyeCamera(
            width=camera.width_px,
            height=camera.height_px,
            focal=camera.focal_px_per_rad,
            centre=((camera.width_px - 1) / 2, (camera.height_px - 1) / 2),
        )


def sensor_names() -> list[str]:
    """Names of the shipped designs."""
    folder = files(__package__) / "designs"
    return sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name[-5:] == ".toml")


def load_sensor(name: str) -> SensorDesign:
    """Shipped design of that name.

    Raises
    ------
    ValueError
        When there is no such design.
    """
    if name not in sensor_names():
        raise ValueError(f"no sensor design {name!r}; there is: {', '.join(sensor_names())}")
    text = (files(__package__) / "designs" / f"{name}.toml").read_text(encoding="utf-8")
    return msgspec.convert(tomllib.loads(text), SensorDesign)
