"""Palettes: colours of the markers that a tracker searches for."""

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from ..errors import UserError, meant
from ..render import LAYERS, SensorDesign, load_sensor, sensor_names
from ..strict_toml import Table, convert, parse_toml, read_toml
from .sighting import Sighting

Array = NDArray[np.float64]
#: Share of the ground's linear light; above 1 for markers that are brighter than the ground.
Transmittance = Annotated[float, Meta(gt=0.0, le=100.0)]
Name = Annotated[str, Meta(min_length=1, max_length=40)]
#: Default palette: magenta over yellow, as in ChromaTouch.
DEFAULT_PALETTE = "chromatouch"
#: Name of a palette that is learned from the picture.
AUTO_PALETTE = "auto"


class Dye(Table, frozen=True):
    """Colour of a layer: share of the ground's linear light that markers transmit, by channel."""

    name: Name
    transmittance: tuple[Transmittance, Transmittance, Transmittance]


class PaletteTable(Table, frozen=True):
    """TOML file of a palette; layers in their order from the skin inwards."""

    dyes: Annotated[tuple[Dye, ...], Meta(min_length=1, max_length=2)]
    description: str = ""

    def __post_init__(self) -> None:
        log = np.log([dye.transmittance for dye in self.dyes])
        for dye, row in zip(self.dyes, log, strict=True):
            if abs(row).max() < 0.1:
                raise UserError(
                    f"dyes.{dye.name}.transmittance leaves the ground as it is; one channel must "
                    "be below 0.9 or above 1.1"
                )
        bright = log[np.arange(len(log)), abs(log).argmax(axis=1)] > 0.0
        if bright.any() and not bright.all():
            raise UserError("dyes must all be darker than the ground, or all brighter")
        if len({dye.name for dye in self.dyes}) < len(self.dyes):
            raise UserError("dyes must have different names")
        if len(log) == 2 and np.linalg.svd(log, compute_uv=False)[1] < 0.1:
            raise UserError("dyes must differ in colour to be told apart")


@dataclass(frozen=True, kw_only=True)
class Palette:
    """Prior knowledge of the markers in an image.

    Attributes
    ----------
    names: names of the L layers, from the skin inwards
    transmittance: share of the ground's linear light that a marker transmits, shape (L, 3)
    sensor: design of the sensor, or None if unknown; forces can be estimated only with it
    seen: region of the pictures that shows the sensor, if it was located; None: markers are
        searched in the whole picture, or within the rim of a known sensor
    """

    names: tuple[str, ...]
    transmittance: Array
    sensor: SensorDesign | None = None
    seen: Sighting | None = None

    @classmethod
    def of_sensor(cls, sensor: SensorDesign) -> "Palette":
        """Palette of a sensor design."""
        names = LAYERS if len(sensor.layers) == len(LAYERS) else ("dots",)
        return cls(names=names, transmittance=sensor.transmittance, sensor=sensor)

    @property
    def spots(self) -> NDArray[np.bool_] | None:
        """Mask of the pixels of markers of any size, where they were located."""
        return None if self.seen is None else self.seen.spots

    @property
    def bright(self) -> bool:
        """Whether markers are brighter than the ground."""
        log = np.log(self.transmittance[0])
        return bool(log[abs(log).argmax()] > 0.0)


def palette_names() -> list[str]:
    """Names of the shipped palettes."""
    folder = files(__package__) / "palettes"
    return sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name[-5:] == ".toml")


def load_palette(name: str = DEFAULT_PALETTE) -> Palette:
    """Load a palette by its name, the name of a sensor design, or the `.toml` file of either.

    Raises
    ------
    UserError
        When there is no such palette, or the file has a key or value that is not allowed.
    """
    title = f"palette {name}"
    if name in palette_names():
        text = (files(__package__) / "palettes" / f"{name}.toml").read_text(encoding="utf-8")
        return _palette(convert(parse_toml(text, title), PaletteTable, title))
    if name not in sensor_names() + sensor_names(1):
        if not name.endswith(".toml"):
            known = [*palette_names(), *sensor_names(), *sensor_names(1)]
            raise UserError(
                f"no palette {name!r}{meant(name, known)}; there is {', '.join(known)}, or give a "
                ".toml file"
            )
        values = read_toml(Path(name), title)
        if "skin" not in values:
            return _palette(convert(values, PaletteTable, title))
    return Palette.of_sensor(load_sensor(name, fewest=1))


def _palette(table: PaletteTable) -> Palette:
    """Make a palette from the contents of its file."""
    return Palette(
        names=tuple(dye.name for dye in table.dyes),
        transmittance=np.array([dye.transmittance for dye in table.dyes]),
    )
