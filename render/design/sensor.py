"""Sensor designs as data: skin, marker layers, dyes, camera, ground; SI inside, mm only in TOML."""

from functools import cached_property, lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from ... import model
from ...errors import UserError, meant
from ...strict_toml import Table, convert, parse_toml, read_toml
from ..optics.calibration import load_camera
from ..optics.camera import Camera, FisheyeCamera, PinholeCamera
from ..optics.view import View
from . import layout as layouts
from .design_checks import check_markers
from .dials import Defects, Share
from .silicone import Silicone
from .skin import DomeSkin, PadSkin, Skin

Array = NDArray[np.float64]
Positive = Annotated[float, Meta(gt=0.0, le=1e6)]
NotNegative = Annotated[float, Meta(ge=0.0, le=1e6)]
Level = Annotated[int, Meta(ge=0, le=255)]
Many = Annotated[int, Meta(ge=1, le=5000)]
Coverage = Annotated[float, Meta(ge=10.0, le=89.0)]
Light = Annotated[float, Meta(ge=0.0, le=100.0)]
#: Shares of the ground's light; above 1 for markers that are brighter than the ground.
Lights = tuple[Light, Light, Light]
Colour = tuple[Level, Level, Level]

#: Default relative standard deviation of the stiffness from specimen to specimen: with it a 90 %
#: interval holds castings that are a tenth too stiff or too soft.
STIFFNESS_DEVIATION = 0.08

#: Marker layers in the order of every array that has a layer axis.
LAYERS = ("magenta", "yellow")


class Geodesic(Table, frozen=True, tag_field="kind", tag="geodesic"):
    """Evenly over the dome, plus a row on the chain's own meridian."""

    count: Annotated[int, Meta(ge=40, le=5000)]
    coverage_deg: Coverage
    meridian_pitch_mm: Positive


class Spiral(Table, frozen=True, tag_field="kind", tag="spiral"):
    """Evenly over the dome, from the apex to an angle from it."""

    count: Many
    coverage_deg: Coverage


class Meridian(Table, frozen=True, tag_field="kind", tag="meridian"):
    """Rows on meridians, thinned towards the apex; one marker on the apex."""

    meridians: Many
    pitch_mm: Positive
    coverage_deg: Coverage
    gap_mm: Positive
    turn: Share = 0.5


class Grid(Table, frozen=True, tag_field="kind", tag="grid"):
    """A square grid around the middle."""

    rows: Many
    columns: Many
    pitch_mm: Positive


class Ring(Table, frozen=True, tag_field="kind", tag="ring"):
    """Rings around the middle; `counts` from the inside outwards."""

    counts: Annotated[tuple[Many, ...], Meta(min_length=1, max_length=100)]
    pitch_mm: Positive
    turn: Share = 0.5


class FromFile(Table, frozen=True, tag_field="kind", tag="file"):
    """Places from a CSV file: theta_deg, phi_deg on a dome; x_mm, y_mm on a pad."""

    path: str


#: Layout of the markers.
Layout = Geodesic | Spiral | Meridian | Grid | Ring | FromFile

#: Refusal of a camera's place, with the allowed range.
_ELSEWHERE = "camera.position_mm = {:g} must be {}: from elsewhere the camera cannot see the skin"


class Dome(Table, frozen=True, tag_field="shape", tag="dome"):
    """A dome of soft, clear silicone around a hollow with the camera in it.

    Attributes
    ----------
    radius_mm, hollow_mm: radii of the skin and of the hollow [mm]
    index: refractive index of the silicone
    stiffness_deviation: relative standard deviation of a specimen's stiffness from the design's,
        which no picture of the unloaded sensor shows
    rim_deg: angle from the apex at which the housing begins, which hides skin and markers [°]
    """

    radius_mm: Positive
    hollow_mm: Positive
    index: Annotated[float, Meta(ge=1.0, le=3.0)] = 1.41
    stiffness_deviation: Share = STIFFNESS_DEVIATION
    rim_deg: Annotated[float, Meta(ge=20.0, le=90.0)] = 90.0

    @property
    def room_mm(self) -> float:
        """Thickness of the silicone [mm]."""
        return self.radius_mm - self.hollow_mm

    @property
    def unit(self) -> float:
        """Places on the skin for each mm along it, see `skin` [rad]."""
        return 1.0 / self.radius_mm

    @property
    def port(self) -> float:
        """Radius of the inner surface that the camera looks through [m]."""
        return self.hollow_mm * 1e-3

    def build(self) -> Skin:
        """Build the skin at rest."""
        return DomeSkin(radius=self.radius_mm * 1e-3, rim=float(np.deg2rad(self.rim_deg)))

    def refuse(self, layout: Layout, camera_mm: float) -> None:
        """Refuse a layout of markers, or a camera's place, that does not suit a dome."""
        if not self.room_mm > 0.0:
            raise UserError("skin.hollow_mm must be less than skin.radius_mm")
        if not abs(camera_mm) < self.hollow_mm:
            raise UserError(_ELSEWHERE.format(camera_mm, f"within ±{self.hollow_mm:g}, the hollow"))


class Pad(Table, frozen=True, tag_field="shape", tag="pad"):
    """A flat square pad of clear silicone, viewed through its base."""

    side_mm: Positive
    thickness_mm: Positive
    index: Annotated[float, Meta(ge=1.0, le=3.0)] = 1.41
    stiffness_deviation = 0.0  # not used: no estimator has forces of a pad

    @property
    def room_mm(self) -> float:
        """Thickness of the silicone [mm]."""
        return self.thickness_mm

    @property
    def unit(self) -> float:
        """Places on the skin for each mm along it, see `skin` [m]."""
        return 1e-3

    @property
    def port(self) -> float:
        """Place of the base that the camera looks through [m]."""
        return -self.thickness_mm * 1e-3

    def build(self) -> Skin:
        """Build the skin at rest."""
        return PadSkin(radius=self.side_mm * 0.5e-3)

    def refuse(self, layout: Layout, camera_mm: float) -> None:
        """Refuse a layout of markers, or a camera's place, that does not suit a pad."""
        if isinstance(layout, Geodesic | Spiral | Meridian):
            raise UserError("layout.kind geodesic, spiral and meridian need a dome")
        if not camera_mm < -self.thickness_mm:
            below = f"below -{self.thickness_mm:g}, the base of the pad"
            raise UserError(_ELSEWHERE.format(camera_mm, below))


class Markers(Table, frozen=True):
    """Form of the markers, and how they follow the skin.

    Attributes
    ----------
    form: `disc` or `square`
    stretch: share of the skin's in-plane stretch that an outline follows: 0 is a stiff dot that
        only tilts, 1 is ink
    swell_mm: thickness of the incompressible silicone that is pressed [mm]: outlines grow in area
        as it gets thinner; 0: they do not
    """

    form: Literal["disc", "square"] = "disc"
    stretch: Share = 0.0
    swell_mm: NotNegative = 0.0


class Layer(Table, frozen=True):
    """One layer of markers.

    Attributes
    ----------
    size_mm: diameter or side of a marker [mm]
    depth_mm: depth under the skin [mm]
    follow: share of the skin's displacement that the layer follows
    transmittance: transmittance of the dye in linear light, RGB; above 1, in a design of one layer,
        for markers that are brighter than the ground
    """

    size_mm: Positive
    depth_mm: NotNegative
    follow: Share
    transmittance: Lights


class CameraSettings(Table, frozen=True, kw_only=True):
    """Camera on the axis, in OpenCV's parameters; its lens is given here or by a calibration file.

    Attributes
    ----------
    model: model of the lens, fisheye unless it is given; with a calibration file only needed where
        that leaves it open
    width_px, height_px: size of the picture [px]
    focal_px, centre_px, distortion: focal lengths [px], principal point [px] and coefficients
    calibration: file of the lens, in place of these three
    position_mm: height on the axis [mm]: from the sphere centre of a dome towards the apex, from
        the skin of a pad (so negative)
    blur_px: standard deviation of the lens' blur [px]
    """

    model: Literal["fisheye", "pinhole"] | None = None
    width_px: Annotated[int, Meta(ge=32, le=8192)]
    height_px: Annotated[int, Meta(ge=32, le=8192)]
    focal_px: tuple[Positive, Positive] | None = None
    centre_px: tuple[float, float] | None = None
    distortion: tuple[float, ...] = ()
    calibration: str = ""
    position_mm: float = 0.0
    blur_px: Annotated[float, Meta(ge=0.3, le=10.0)]

    def __post_init__(self) -> None:
        if bool(self.calibration) == (self.focal_px is not None):
            raise UserError("give either focal_px or a calibration file")
        if self.calibration and (self.centre_px or self.distortion):
            raise UserError("centre_px and distortion come from the calibration file")

    def build(self) -> Camera:
        """Build the camera."""
        if self.focal_px is None:
            return load_camera(self.calibration, (self.width_px, self.height_px), self.model)
        kind: type[FisheyeCamera | PinholeCamera]
        kind, length = (PinholeCamera, 5) if self.model == "pinhole" else (FisheyeCamera, 4)
        if len(self.distortion) not in (0, length):
            raise UserError(
                f"camera.distortion of a {self.model or 'fisheye'} must be {length} numbers, "
                f"got {len(self.distortion)}"
            )
        return kind(
            width=self.width_px,
            height=self.height_px,
            focal=self.focal_px,
            centre=self.centre_px or ((self.width_px - 1) / 2, (self.height_px - 1) / 2),
            distortion=self.distortion or (0.0,) * length,  # type: ignore[arg-type]
        )


class Seams(Table, frozen=True):
    """Seams between the gores of the skin, on half planes through the axis."""

    count: Annotated[int, Meta(ge=1, le=24)]
    width_mm: Positive
    colour: Colour


class Ground(Table, frozen=True):
    """sRGB of the diffusing skin at apex and rim, and of the housing outside the dome."""

    apex: Colour
    rim: Colour
    housing: Colour


class SensorDesign(Table, frozen=True, kw_only=True, dict=True):
    """Design of a whole sensor; an estimator only gets its calibration.

    Attributes
    ----------
    description: one line for lists of designs
    skin, layout, markers, camera, ground, seams: tables of the design
    magenta: outer layer of markers
    yellow: inner layer; None in a design of one layer, which serves tracking alone
    silicone: silicone of the body `dome`; None if it is unknown
    defects: defects of its specimens; those of a scene replace them one by one
    """

    description: str
    skin: Dome | Pad
    layout: Layout
    markers: Markers = Markers()
    magenta: Layer
    yellow: Layer | None = None
    camera: CameraSettings
    ground: Ground
    seams: Seams | None = None
    silicone: Silicone | None = None
    defects: Defects = Defects()

    def __post_init__(self) -> None:
        if not self.magenta.follow > 0.0:
            raise UserError(
                "magenta.follow = 0 must be above 0: the outer layer moves with the skin"
            )
        skin = self.skin
        if self.silicone is not None:
            self.silicone.body(self.shape.radius, self.shape.flat)  # refuses an invalid body
        skin.refuse(self.layout, self.camera.position_mm)
        for name, layer in zip(LAYERS, self.layers, strict=False):
            for k, share in enumerate(layer.transmittance):
                if self.yellow is not None and share > 1.0:
                    raise UserError(
                        f"{name}.transmittance[{k}] = {share:g} must be at most 1 in two layers"
                    )
            if layer.depth_mm >= skin.room_mm:
                raise UserError(
                    f"{name}.depth_mm = {layer.depth_mm} must be less than the silicone's "
                    f"{skin.room_mm:g}"
                )
        square = self.markers.form == "square"
        check_markers(self.shape, self.view, self.places, self.depths, self.half_sizes, square)

    @property
    def dome(self) -> model.SoftBody:
        """Body of silicone, a dome or a pad.

        Raises
        ------
        UserError
            For a design without silicone.
        """
        if self.silicone is None:
            raise UserError("the silicone of the design is unknown: it has no table [silicone]")
        return self.silicone.body(self.shape.radius, self.shape.flat)

    def round_dome(self, reader: str) -> model.Dome:
        """Body of silicone, if it is a dome.

        Parameters
        ----------
        reader: subject of the refusal, such as "the reconstructor contact"

        Raises
        ------
        UserError
            For a pad, and for a design without silicone.
        """
        body = self.dome
        if not isinstance(body, model.Dome):  # whoever reads domes asks here
            raise UserError(f"{reader} needs a dome of silicone, not a flat pad")
        return body

    @property
    def inner(self) -> Layer:
        """The inner layer.

        Raises
        ------
        UserError
            For a design of one layer.
        """
        if self.yellow is None:
            raise UserError("the sensor has one layer of markers; wanted: magenta and yellow")
        return self.yellow

    @property
    def layers(self) -> tuple[Layer, ...]:
        """The L layers, from the skin inwards."""
        return (self.magenta,) if self.yellow is None else (self.magenta, self.yellow)

    @property
    def depths(self) -> Array:
        """Depth of each layer under the skin [m], shape (L,)."""
        return np.array([layer.depth_mm * 1e-3 for layer in self.layers])

    @property
    def half_sizes(self) -> Array:
        """Radius, or half the side, of each layer's markers [m], shape (L,)."""
        return np.array([layer.size_mm * 0.5e-3 for layer in self.layers])

    @property
    def follow(self) -> Array:
        """Share of the skin's displacement that each layer follows, shape (L,)."""
        return np.array([layer.follow for layer in self.layers])

    @property
    def transmittance(self) -> Array:
        """Linear-light transmittance of each dye, shape (L, 3)."""
        return np.array([layer.transmittance for layer in self.layers])

    @property
    def stiffness_deviation(self) -> float:
        """Relative deviation of the stiffness between specimens; 0 for a pad, without forces."""
        return self.skin.stiffness_deviation

    @cached_property
    def shape(self) -> Skin:
        """The skin at rest."""
        return self.skin.build()

    @cached_property
    def places(self) -> Array:
        """Marker places at rest, see `skin`, shape (M, 2), read-only."""
        places = np.array(self._places())
        places.setflags(write=False)
        return places

    def _places(self) -> Array:
        plan, flat = self.layout, self.shape.flat
        unit = self.skin.unit
        match plan:
            case Geodesic():
                coverage = np.deg2rad(plan.coverage_deg)
                return layouts.geodesic(plan.count, coverage, plan.meridian_pitch_mm * unit)
            case Spiral():
                return layouts.spiral(plan.count, np.deg2rad(plan.coverage_deg))
            case Meridian():
                return layouts.meridians(
                    plan.meridians,
                    plan.pitch_mm * unit,
                    np.deg2rad(plan.coverage_deg),
                    plan.gap_mm * unit,
                    plan.turn,
                )
            case Grid():
                return layouts.grid(plan.rows, plan.columns, plan.pitch_mm * unit)
            case Ring():
                return layouts.rings(plan.counts, plan.pitch_mm * unit, plan.turn)
            case FromFile():
                return layouts.from_file(plan.path, flat)

    @cached_property
    def view(self) -> View:
        """Camera in the sensor frame."""
        return View(
            camera=self.camera.build(),
            position=self.camera.position_mm * 1e-3,
            port=self.skin.port,
            flat=self.shape.flat,
            index=self.skin.index,
        )

    def places_at(self, pixels: Array, layer: int) -> Array:
        """Places (…, 2) of a resting layer that are visible at pixels (…, 2)."""
        return self.shape.meet(*self.view.trace(pixels), self.depths[layer])


#: Folder of the shipped designs.
DESIGNS = files(__package__.rpartition(".")[0]) / "designs"


#: Folder of those with one layer of markers.
ONE_LAYER = DESIGNS / "one-layer"


def sensor_names(layers: int = 2) -> list[str]:
    """Names of the shipped designs with so many layers of markers, 1 or 2."""
    folder = DESIGNS if layers == 2 else ONE_LAYER
    return sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name[-5:] == ".toml")


#: Tables and keys of a sensor file that name other files, relative to it.
FILES_NAMED = (("layout", "path"), ("camera", "calibration"))


@lru_cache(maxsize=32)
def _shipped(name: str) -> SensorDesign:
    folder = DESIGNS if name in sensor_names() else ONE_LAYER
    text = (folder / f"{name}.toml").read_text(encoding="utf-8")
    return convert(parse_toml(text, f"sensor {name}"), SensorDesign, f"sensor {name}")


def load_sensor(name: str, fewest: int = 2) -> SensorDesign:
    """Load a shipped design by name, or a design from a file that ends in `.toml`.

    Paths of files in a design are relative to it.

    Parameters
    ----------
    name: of the design or its file
    fewest: smallest number of layers of markers; tracking alone needs no more than one

    Raises
    ------
    UserError
        For an unknown name; for a design of fewer layers; for a value that is not allowed, with
        the key, the value and what is allowed.
    """
    if name in sensor_names() or name in sensor_names(1):
        return _with_layers(_shipped(name), name, fewest)
    if not name.endswith(".toml"):
        raise UserError(
            f"no sensor design {name!r}{meant(name, sensor_names())}; there is "
            f"{', '.join(sensor_names())}, or give a .toml file"
        )
    values = read_toml(Path(name), f"sensor file {name}")
    for table, key in FILES_NAMED:
        _beside(Path(name).parent, values.get(table), key)
    return _with_layers(convert(values, SensorDesign, f"sensor {name}"), name, fewest)


def _with_layers(sensor: SensorDesign, name: str, fewest: int) -> SensorDesign:
    """Refuse a design of fewer layers of markers."""
    if len(sensor.layers) < fewest:
        raise UserError(
            f"sensor {name} has one layer of markers, which serves `chromagrip track --palette "
            f"{name}` and detect; everything else needs magenta and yellow"
        )
    return sensor


def _beside(folder: Path, table: object, key: str) -> None:
    if isinstance(table, dict) and isinstance(table.get(key), str) and table[key]:
        table[key] = str(folder / table[key])
