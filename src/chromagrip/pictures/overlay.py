"""Pictures with the markers drawn into them, one or a video."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..output.video import VideoFile
from ..render import encode_srgb
from ..tracking import Palette, Tracks

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Longer side of a drawn picture [px]: smaller ones are enlarged, or lines would cover them.
_LONG_SIDE = 1280
#: Highest rate of a video [Hz]: sources above it play in slow motion.
_FASTEST = 60.0
#: Rate factor of x264.
_QUALITY = 23
#: Share of the picture's contrast that remains under the drawing.
_CONTRAST = 0.5
#: Largest luminance of a layer's colour, so that it stands out of the paled picture.
_LUMINANCE = 0.22

_Colour = tuple[int, int, int]
_TEXT: _Colour = (20, 20, 20)
_GREY_LAYER: _Colour = (20, 90, 170)
_LOST: _Colour = (215, 25, 30)
_AMBIGUOUS: _Colour = (240, 130, 0)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_FONT_SCALE = 0.6
#: Height of a line of text [px].
_LINE = 30


def layer_colours(palette: Palette) -> list[_Colour]:
    """Colour to draw each layer in: the dye's own, darkened; blue for a grey one."""
    colours = []
    for light in palette.transmittance:
        colour = light / light.max()
        if np.ptp(colour) < 0.1:
            colours.append(_GREY_LAYER)
            continue
        # More saturated than the dye: otherwise darkened yellow is brown, and magenta grey.
        colour = (colour - 0.8 * colour.min()) / (1.0 - 0.8 * colour.min())
        luminance = float(colour @ (0.2126, 0.7152, 0.0722))
        red, green, blue = encode_srgb(colour * min(1.0, _LUMINANCE / luminance))
        colours.append((round(float(red)), round(float(green)), round(float(blue))))
    return colours


class Canvas:
    """Paled and enlarged copy of a picture, drawn on in the coordinates of the picture.

    Parameters
    ----------
    image: sRGB, shape (H, W, 3)
    lines: number of lines of text above the picture
    """

    def __init__(self, image: Image, lines: int) -> None:
        height, width = image.shape[:2]
        self._scale = _LONG_SIDE / max(height, width)
        size = (round(self._scale * width), round(self._scale * height))
        way = cv2.INTER_LINEAR if self._scale > 1.0 else cv2.INTER_AREA
        self._top = _LINE * lines + 10
        self.pixels: Image = np.full((self._top + size[1], size[0], 3), 255, np.uint8)
        paled = cv2.convertScaleAbs(image, alpha=_CONTRAST, beta=255.0 * (1.0 - _CONTRAST))
        self.pixels[self._top :] = cv2.resize(paled, size, interpolation=way)

    def circles(self, places: Array, radii: Array, colour: _Colour) -> None:
        """Outlines of circles around places (n, 2) with radii (n,), both in picture pixels."""
        for (x, y), r in zip(self._at(places), np.rint(16 * self._scale * radii), strict=True):
            cv2.circle(self.pixels, (int(x), int(y)), int(r), colour, 1, cv2.LINE_AA, shift=4)

    def lines(self, starts: Array, ends: Array, colour: _Colour) -> None:
        """Lines between places (n, 2)."""
        for a, b in zip(self._at(starts), self._at(ends), strict=True):
            first, second = (int(a[0]), int(a[1])), (int(b[0]), int(b[1]))
            cv2.line(self.pixels, first, second, colour, 2, cv2.LINE_AA, shift=4)

    def crosses(self, places: Array, half: float, colour: _Colour) -> None:
        """Diagonal crosses of that half side at places (n, 2)."""
        for way in (np.array([half, half]), np.array([half, -half])):
            self.lines(places - way, places + way, colour)

    def text(self, words: Sequence[tuple[str, _Colour]], line: int) -> None:
        """Words one after another on a line above the picture."""
        x, y = 10, _LINE * line + 26
        for word, colour in words:
            cv2.putText(self.pixels, word, (x, y), _FONT, _FONT_SCALE, colour, 1, cv2.LINE_AA)
            x += cv2.getTextSize(word, _FONT, _FONT_SCALE, 1)[0][0] + 24

    def _at(self, places: Array) -> NDArray[np.intp]:
        """Places on the canvas [1/16 px]; pixel centres are at integers on both."""
        at = self._scale * (places + 0.5) - 0.5 + np.array([0.0, self._top])
        return np.rint(16 * at).astype(np.intp)


def draw_markers(
    image: Image, palette: Palette, positions: Sequence[Array], areas: Sequence[Array]
) -> Image:
    """Picture with the markers of each layer, positions (n, 2) [px] and areas (n,) [px²]."""
    canvas = Canvas(image, lines=1)
    colours = layer_colours(palette)
    for at, area, colour in zip(positions, areas, colours, strict=True):
        canvas.circles(at, np.sqrt(area / np.pi), colour)
        tick = np.array([0.15, 0.0]) * np.sqrt(area / np.pi)[:, None]
        canvas.lines(at - tick, at + tick, colour)
    counts = [f"{name} {len(at)}" for name, at in zip(palette.names, positions, strict=True)]
    canvas.text(list(zip(counts, colours, strict=True)), 0)
    return canvas.pixels


def draw_tracks(
    image: Image, palette: Palette, tracks: Tracks, rest: Tracks, radius: Array
) -> Image:
    """Picture with outlines where markers are, and lines from where they were at rest.

    Lost ones have a cross at their place at rest, ambiguous ones a ring.

    Parameters
    ----------
    image: sRGB, shape (H, W, 3)
    palette: of the markers
    tracks, rest: in this frame, and at rest
    radius: of a marker of each layer at rest [px], shape (L,)
    """
    canvas = Canvas(image, lines=2)
    colours = layer_colours(palette)
    words = [(f"{tracks.time:.3f} s", _TEXT)]
    known: NDArray[np.bool_] = np.isfinite(rest.position[..., 0])
    for k in reversed(range(len(colours))):  # the skin's layer on top
        visible, start = tracks.visible[k], rest.position[k]
        moved = visible & known[k]
        at, size = tracks.position[k, visible], np.nan_to_num(tracks.log_size[k, visible])
        canvas.circles(at, radius[k] * np.exp(size), colours[k])
        canvas.lines(start[moved], tracks.position[k, moved], colours[k])
        canvas.crosses(start[known[k] & ~visible], 0.6 * radius[k], _LOST)
        canvas.circles(
            tracks.position[k, tracks.ambiguous[k] & visible],
            np.full(int((tracks.ambiguous[k] & visible).sum()), 1.5 * radius.max()),
            _AMBIGUOUS,
        )
    for name, visible, present, colour in zip(
        palette.names, tracks.visible, known, colours, strict=True
    ):
        words.append((f"{name} {visible.sum()} of {present.sum()}", colour))
    canvas.text(words, 0)
    lost, doubtful = int((known & ~tracks.visible).sum()), int(tracks.ambiguous.sum())
    canvas.text(
        [
            ("outline: where it is; line: from where it was at rest", _TEXT),
            (f"x lost {lost}", _LOST),
            (f"o ambiguous {doubtful}", _AMBIGUOUS),
        ],
        1,
    )
    return canvas.pixels


class OverlayVideo(VideoFile):
    """Video of the markers; sources above 60 Hz play in slow motion.

    Parameters
    ----------
    path: of the video
    fps: of the source [Hz]
    """

    def __init__(self, path: Path, fps: float) -> None:
        rate = Fraction(min(fps, _FASTEST)).limit_denominator(1001)
        super().__init__(path, rate, _QUALITY)
