"""What a picture is taken to show: where the sensor is, and what its markers look like."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..folders import write_whole
from ..sources.picture_files import read_picture
from ..sources.source import ValueRange
from ..stored_pictures import MEGAPIXELS, Image
from ..tracking import AUTO_PALETTE, Palette, learn_palette, load_palette, sight

Mask = NDArray[np.bool_]

#: Largest share of a mask that may be grey: its edge, and what JPEG adds.
GREYEST = 0.1
#: Finds the palette, and where the sensor is, of a picture; height and width are those that it
#: had before it was reduced [px].
Find = Callable[[Image, tuple[int, int]], Palette]


class Assumed(TypedDict):
    """Part of a summary that says what a picture was taken to show.

    `field_px` is the box around the sensor: left, top, width and height.
    """

    palette: str
    dyes: dict[str, list[float]]
    bright: bool
    field_given: bool
    field_share: float | None
    field_px: list[int] | None
    marker_radius_px: float | None
    marker_distance_px: float | None


@dataclass(frozen=True, kw_only=True)
class Within:
    """Part of a picture that was given as the sensor's.

    Attributes
    ----------
    crop: left, top, width and height [px]
    mask: picture that is white where the sensor is, and black elsewhere
    max_megapixels: largest mask that is decoded
    value_range: values of black and white of a mask of more than 8 bits
    """

    crop: tuple[int, int, int, int] | None = None
    mask: Path | None = None
    max_megapixels: float = MEGAPIXELS
    value_range: ValueRange = None

    def of(self, height: int, width: int) -> Mask | None:
        """Pixels of a picture of that size, shape (H, W); None where nothing was given.

        Raises
        ------
        UserError
            When the crop lies outside the picture, or the mask has another size or is empty.
        """
        if self.crop is None and self.mask is None:
            return None
        found = np.ones((height, width), dtype=bool)
        if self.crop is not None:
            left, top, wide, high = self.crop
            if (
                wide < 1
                or high < 1
                or min(left, top) < 0
                or left + wide > width
                or top + high > height
            ):
                raise UserError(
                    f"--crop {left},{top},{wide},{high} does not lie in the picture of "
                    f"{width}×{height} pixels; wanted: left,top,width,height"
                )
            found[:] = False
            found[top : top + high, left : left + wide] = True
        if self.mask is not None:
            given = read_picture(self.mask, self.max_megapixels, self.value_range)
            if given.shape[:2] != (height, width):
                raise UserError(
                    f"mask {self.mask} is {given.shape[1]}×{given.shape[0]} pixels, the picture "
                    f"{width}×{height}"
                )
            bright = given.max(axis=2)
            grey = ((bright > 32) & (bright < 223)).mean()
            if grey > GREYEST:
                raise UserError(
                    f"mask {self.mask} is a picture, no mask: {100 * grey:.0f} % of it is neither "
                    "black nor white; paint white what is the sensor and black what is not"
                )
            found &= bright > 127
        if not found.any():
            raise UserError("--crop and --mask leave nothing of the picture")
        return found


#: Nothing is given: the sensor is looked for.
ANYWHERE = Within()


def finder(palette: str, within: Within) -> Find:
    """What finds the palette of that name, and where the sensor is, of a picture.

    Parameters
    ----------
    palette: `auto`, or a name or file, see `load_palette`
    within: where the sensor is, if it was given

    Raises
    ------
    UserError
        When there is no such palette. What is returned raises it where nothing in a picture
        repeats like markers, unless palette and place of the sensor are given.
    """
    known = None if palette == AUTO_PALETTE else load_palette(palette)

    def find(image: Image, opened: tuple[int, int]) -> Palette:
        part = within.of(*opened)
        if part is not None:
            height, width = image.shape[:2]
            times = opened[0] // height
            part = part[: height * times : times, : width * times : times]
        if known is not None and part is None and _as_designed(known, image):
            return _with_dots(known, image)
        seen = sight(image, part)
        return (
            learn_palette(image, seen) if known is None else replace(known, sensor=None, seen=seen)
        )

    return find


def _as_designed(palette: Palette, image: Image) -> bool:
    """Whether a picture has the size that a known sensor's camera gives."""
    view = None if palette.sensor is None else palette.sensor.view
    return view is not None and image.shape[:2] == (view.height, view.width)


def _with_dots(palette: Palette, image: Image) -> Palette:
    """Palette of a known sensor; of one layer with the dots that are seen, if there are any.

    A camera of that kind need not show exactly the dots of the design.
    """
    if palette.sensor is None or palette.sensor.yellow is not None:
        return palette
    try:
        return replace(palette, seen=sight(image))
    except UserError:
        return palette


def assumed(name: str, palette: Palette, within: Within, times: int) -> Assumed:
    """What was assumed, for a summary; the picture was reduced by a whole factor."""
    seen = palette.seen
    box = None
    if seen is not None:
        y, x = np.nonzero(seen.field)
        box = [times * int(v) for v in (x.min(), y.min(), np.ptp(x) + 1, np.ptp(y) + 1)]
    rows = zip(palette.names, palette.transmittance.round(4).tolist(), strict=True)
    return {
        "palette": name,
        "dyes": dict(rows),
        "bright": palette.bright,
        "field_given": within.crop is not None or within.mask is not None,
        "field_share": None if seen is None else round(float(seen.field.mean()), 4),
        "field_px": box,
        "marker_radius_px": None if seen is None else round(times * seen.radius, 2),
        "marker_distance_px": None if seen is None else round(times * seen.pitch, 2),
    }


def save_palette(path: Path, palette: Palette, picture: str) -> None:
    """Write a palette that was found, for `load_palette`.

    Raises
    ------
    UserError
        When the file cannot be written.
    """
    rows = [f"description = {json.dumps(f'learned from {picture}', ensure_ascii=False)}"]
    for name, dye in zip(palette.names, palette.transmittance, strict=True):
        shares = ", ".join(f"{share:.4g}" for share in np.clip(dye, 1e-4, 100.0))
        rows += ["", "[[dyes]]", f'name = "{name}"', f"transmittance = [{shares}]"]
    try:
        write_whole(path, ("\n".join(rows) + "\n").encode())
    except OSError as error:
        raise UserError(f"palette {path} cannot be written: {error.strerror}") from None
