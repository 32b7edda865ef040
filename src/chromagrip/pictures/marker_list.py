"""Markers of a single picture as a list; those of two layers that lie on each other are pairs."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypedDict

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import UserError, located
from ..sources.picture_files import is_picture, read_picture
from ..sources.source import SUFFIXES, ValueRange
from ..stored_pictures import MEGAPIXELS, Image, kind_of, unread_kind
from ..tracking import (
    AUTO_PALETTE,
    Markers,
    Palette,
    check_told_apart,
    detect_markers,
    join_layers,
)
from .find_sensor import ANYWHERE, Assumed, Within, assumed, finder
from .scale import Scale, reduction


class MarkerRow(TypedDict):
    """A marker; `pair` is shared by markers of both layers that lie on each other."""

    x_px: float
    y_px: float
    area_px2: float
    hue_deg: float | None
    layer: str
    pair: int | None


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture, and the markers of each layer.

    Attributes
    ----------
    image: sRGB, shape (H, W, 3)
    palette: of the markers
    assumed: what the picture was taken to show
    layers: L of them
    rows: one a marker, for JSON
    """

    image: Image
    palette: Palette
    assumed: Assumed
    layers: list[Markers]
    rows: list[MarkerRow]


def list_markers(
    path: Path,
    palette: str = AUTO_PALETTE,
    within: Within = ANYWHERE,
    max_megapixels: float = MEGAPIXELS,
    value_range: ValueRange = None,
) -> Picture:
    """Markers of the picture in a file, for a palette by name, within a part of it if given.

    A larger picture than `max_megapixels` is not decoded; `value_range` has the values of black
    and white of one with more than 8 bits.

    Raises
    ------
    UserError
        When there is no such picture or palette, or no markers in it.
    """
    _check_picture(path)
    image = read_picture(path, max_megapixels, value_range)
    find = finder(palette, within)
    with located(f"picture {path}"):
        scale = reduction(image)
        reduced = scale(image)
        colours = find(reduced, image.shape[:2])
        found = detect_markers(reduced, colours)
        check_told_apart(found, colours)
        layers = [_original(markers, scale) for markers in found]
    if not any(len(markers.area) for markers in layers):
        raise UserError(f"picture {path}: no markers found in {' or '.join(colours.names)}")
    told = assumed(palette, colours, within, round(1.0 / scale.factor))
    rows = _rows(layers, colours)
    if scale.factor < 1.0 and colours.seen is not None:
        field = cv2.resize(
            colours.seen.field.view(np.uint8), image.shape[1::-1], interpolation=cv2.INTER_NEAREST
        )
        colours = replace(colours, seen=replace(colours.seen, field=field.astype(bool)))
    return Picture(image=image, palette=colours, assumed=told, layers=layers, rows=rows)


def _original(markers: Markers, scale: Scale) -> Markers:
    """Markers in pixels of the picture, of those in the reduced one."""
    return replace(
        markers,
        position=scale.original(markers.position),
        area=markers.area / scale.factor**2,
        shape=markers.shape / scale.factor,
    )


def _check_picture(path: Path) -> None:
    """Refuse what is a source of many frames instead of one picture, or of a kind not read."""
    if path.is_file() and (kind := unread_kind(path)):
        raise UserError(f"{path} is {kind}, which is not read; save it as png or tiff")
    if path.is_dir() or (path.is_file() and not is_picture(path) and not _begins_like_one(path)):
        raise UserError(
            f"{path} is no picture; detect takes one picture ({', '.join(SUFFIXES)}), "
            "`chromagrip track` reads videos and folders of pictures"
        )


def _begins_like_one(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return kind_of(file.read(16)) is not None
    except OSError:
        return False


def _rows(layers: list[Markers], palette: Palette) -> list[MarkerRow]:
    # Of light that is not that of the dyes, spots may seem to cover less than nothing.
    typical = max(0.0, *(float(np.median(m.area)) for m in layers if len(m.area)))
    radius = np.sqrt(typical / np.pi)
    joined = join_layers([markers.position for markers in layers], reach=float(radius))
    both: NDArray[np.bool_] = np.isfinite(joined[0, :, 0] + joined[-1, :, 0])
    alone = len(layers) == 1
    rows: list[MarkerRow] = []
    for name, markers, places in zip(palette.names, layers, joined, strict=True):
        number = {tuple(at): m for m, at in enumerate(places)}
        for at, area, hue in zip(markers.position, markers.area, markers.hue, strict=True):
            pair = number[tuple(at)]
            rows.append(
                {
                    "x_px": float(at[0]),
                    "y_px": float(at[1]),
                    "area_px2": float(area),
                    "hue_deg": float(hue) if np.isfinite(hue) else None,
                    "layer": name,
                    "pair": pair if both[pair] and not alone else None,
                }
            )
    return rows
