"""Pictures with the markers drawn into them, one or a video."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from ..output.video import VideoFile
from ..tracking import Markers, Palette, RestFrame, Tracks

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Name of the video in a folder.
OVERLAY = "overlay.mp4"
#: Largest factor by which motion since rest is drawn longer than it is.
MAGNIFY = 5

_Colour = tuple[int, int, int]
_TEXT: _Colour = (20, 20, 20)
#: Of the skin's layer, drawn as a full line, and of the one below it, drawn as dashes.
_LAYERS: tuple[_Colour, _Colour] = ((0, 70, 200), (20, 20, 20))
_MOTION: _Colour = (0, 130, 60)
_LOST: _Colour = (215, 25, 30)
_AMBIGUOUS: _Colour = (240, 130, 0)
_DROPPED: _Colour = (110, 110, 110)
_FIELD: _Colour = (150, 60, 160)


class Canvas:
    """Enlarged copy of a picture, drawn on in the coordinates of the picture.

    Lines have a white halo, so that they stand out of any colour.

    Parameters
    ----------
    image: sRGB, shape (H, W, 3)
    lines: number of lines of text above the picture
    """

    _halo = (255, 255, 255)
    _font = cv2.FONT_HERSHEY_SIMPLEX
    _font_scale = 0.6
    #: Height of a line of text [px].
    _row = 30

    def __init__(self, image: Image, lines: int) -> None:
        height, width = image.shape[:2]
        # Longer side of a drawn picture [px]: smaller ones are enlarged, or lines would cover them.
        long_side = 1280
        self._scale = long_side / max(height, width)
        size = (max(1, round(self._scale * width)), max(1, round(self._scale * height)))
        way = cv2.INTER_LINEAR if self._scale > 1.0 else cv2.INTER_AREA
        self._top = self._row * lines + 10
        self.pixels: Image = np.full((self._top + size[1], size[0], 3), 255, np.uint8)
        self.pixels[self._top :] = cv2.resize(image, size, interpolation=way)

    def circles(self, places: Array, radii: Array, colour: _Colour) -> None:
        """Outlines of circles around places (n, 2) with radii (n,), both in picture pixels."""
        self.ellipses(places, radii[:, None, None] * np.eye(2), colour)

    def ellipses(
        self, places: Array, shapes: Array, colour: _Colour, *, dashed: bool = False
    ) -> None:
        """Outlines that shapes (n, 2, 2) make of the unit circle, around places (n, 2)."""
        points = 32  # points of an ellipse
        angle = np.linspace(0.0, 2.0 * np.pi, points, endpoint=False)
        circle = np.stack([np.cos(angle), np.sin(angle)])
        outlines = self._at(places[:, None] + np.swapaxes(shapes @ circle, 1, 2)).astype(np.int32)
        dashes = outlines.reshape(-1, points // 4, 4, 2)[:, :, :3].reshape(-1, 3, 2)
        parts, closed = (list(dashes), False) if dashed else (list(outlines), True)
        for stroke, width in ((self._halo, 3), (colour, 1)):
            cv2.polylines(self.pixels, parts, closed, stroke, width, cv2.LINE_AA, shift=4)

    def lines(self, starts: Array, ends: Array, colour: _Colour) -> None:
        """Lines between places (n, 2)."""
        both = np.stack([self._at(starts), self._at(ends)], axis=1).astype(np.int32)
        for stroke, width in ((self._halo, 4), (colour, 2)):
            cv2.polylines(self.pixels, list(both), False, stroke, width, cv2.LINE_AA, shift=4)

    def crosses(self, places: Array, half: float, colour: _Colour) -> None:
        """Diagonal crosses of that half side at places (n, 2)."""
        for way in (np.array([half, half]), np.array([half, -half])):
            self.lines(places - way, places + way, colour)

    def border(self, field: NDArray[np.bool_], colour: _Colour) -> None:
        """Outline of a mask (H, W) of the picture."""
        found = cv2.findContours(field.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        parts = [self._at(part[:, 0].astype(float)).astype(np.int32) for part in found[0]]
        cv2.polylines(self.pixels, parts, True, colour, 1, cv2.LINE_AA, shift=4)

    def scale_bar(self, line: int) -> None:
        """Bar of a round number of picture pixels, at the right end of a line of text."""
        width = 0.15 * self.pixels.shape[1] / self._scale
        power = 10.0 ** np.floor(np.log10(width))
        pixels = power * max(step for step in (1, 2, 5) if step * power <= width)
        words = f"{pixels:g} px"
        right, y = self.pixels.shape[1] - 12, self._row * line + 20
        left = right - round(pixels * self._scale)
        cv2.line(self.pixels, (left, y), (right, y), _TEXT, 2)
        for x in (left, right):
            cv2.line(self.pixels, (x, y - 5), (x, y + 5), _TEXT, 2)
        size = cv2.getTextSize(words, self._font, self._font_scale, 1)[0][0]
        place = (left - size - 10, y + 6)
        cv2.putText(self.pixels, words, place, self._font, self._font_scale, _TEXT, 1, cv2.LINE_AA)

    def text(self, words: Sequence[tuple[str, _Colour]], line: int) -> None:
        """Words one after another on a line above the picture."""
        x, y = 10, self._row * line + 26
        for word, colour in words:
            cv2.putText(
                self.pixels, word, (x, y), self._font, self._font_scale, colour, 1, cv2.LINE_AA
            )
            x += cv2.getTextSize(word, self._font, self._font_scale, 1)[0][0] + 24

    def _at(self, places: Array) -> NDArray[np.intp]:
        """Places on the canvas [1/16 px]; pixel centres are at integers on both."""
        at = self._scale * (places + 0.5) - 0.5 + np.array([0.0, self._top])
        return np.rint(16 * at).astype(np.intp)


def draw_markers(image: Image, palette: Palette, layers: Sequence[Markers]) -> Image:
    """Picture with the outlines of the markers of each layer, and of the sensor."""
    canvas = Canvas(image, lines=1)
    if palette.seen is not None:
        canvas.border(palette.seen.field, _FIELD)
    words = []
    for k in reversed(range(len(layers))):
        canvas.ellipses(layers[k].position, layers[k].shape, _LAYERS[k], dashed=k > 0)
        line = "dashed" if k else "full line"
        words.append((f"{palette.names[k]} {len(layers[k].area)} ({line})", _LAYERS[k]))
    seen = [] if palette.seen is None else [("sensor", _FIELD)]
    canvas.text([*words[::-1], *seen], 0)
    canvas.scale_bar(0)
    return canvas.pixels


def dropped(palette: Palette, start: RestFrame, resting: Tracks) -> list[Array]:
    """Places of the markers of each layer that were seen at rest and are not followed, (n, 2).

    Some were seen as dots only, and told apart in no layer.
    """
    known = np.concatenate([*start.position, *resting.position])
    dots = np.empty((0, 2)) if palette.seen is None else palette.seen.position
    dots = _away_from(dots, known, float(start.radius.max()))
    places = []
    for at, followed, radius in zip(start.position, resting.position, start.radius, strict=True):
        own = _away_from(at[np.isfinite(at[:, 0])], followed, float(radius))
        places.append(np.concatenate([own, dots]))
    return places


def _away_from(places: Array, others: Array, radius: float) -> Array:
    """Those of some places (n, 2) that are further than a radius from all others, NaN ignored."""
    there = others[np.isfinite(others[:, 0])]
    if not len(there) or not len(places):
        return places
    return places[np.asarray(scipy.spatial.KDTree(there).query(places)[0]) > radius]


class Magnification:
    """Factor by which motion since rest is drawn longer than it is, over the frames of a video.

    No line reaches the next marker. The factor never grows again, so that it does not flicker; at 1
    a line ends where the marker is.

    Parameters
    ----------
    resting: the tracks at rest
    """

    #: Longest line, as a share of the median distance between neighbouring markers.
    _longest = 0.8

    def __init__(self, resting: Tracks) -> None:
        self._rest, self._factor = resting.position, MAGNIFY
        self._room = [self._longest * _spacing(at) for at in resting.position]

    def after(self, tracks: Tracks) -> int:
        """Factor once a frame is seen; doubtful markers do not count."""
        sure = tracks.visible & ~tracks.ambiguous
        for at, start, counts, room in zip(
            tracks.position, self._rest, sure, self._room, strict=True
        ):
            way = np.linalg.norm(at - start, axis=1)[counts]
            longest = float(way[np.isfinite(way)].max(initial=1e-9))
            self._factor = max(1, int(min(self._factor, room / longest)))
        return self._factor


def _spacing(places: Array) -> float:
    """Median distance of places (n, 2) from their nearest neighbours; infinite for less than 2."""
    there = places[np.isfinite(places[:, 0])]
    if len(there) < 2:
        return np.inf
    away = np.asarray(scipy.spatial.KDTree(there).query(there, k=2)[0])
    return float(np.median(away[:, 1]))


class TrackDrawing:
    """Draws frames with the markers that are followed, from what they were at rest.

    Outlines are ellipses as at rest, as large as they are now; motion is drawn longer than it is,
    see Magnification. Lost ones have a cross at their place at rest, ambiguous ones a ring; those
    that were seen at rest and are not followed have a grey cross.

    Parameters
    ----------
    palette: of the markers
    start: the unloaded sensor as it was detected
    resting: the tracks at rest
    """

    def __init__(self, palette: Palette, start: RestFrame, resting: Tracks) -> None:
        self._palette, self._start, self._rest = palette, start, resting
        self._known: NDArray[np.bool_] = np.isfinite(resting.position[..., 0])
        self._dropped = dropped(palette, start, resting)
        self._motion = Magnification(resting)
        self._shapes = [
            _nearest_shapes(at, shapes, own, radius)
            for at, shapes, own, radius in zip(
                start.position, start.shapes, resting.position, start.radius, strict=True
            )
        ]

    def __call__(self, image: Image, tracks: Tracks) -> Image:
        """Picture (H, W, 3) with what is followed."""
        canvas = Canvas(image, lines=2)
        if self._palette.seen is not None:
            canvas.border(self._palette.seen.field, _FIELD)
        words = [(f"{tracks.time:.3f} s", _TEXT)]
        left, magnify = 0, self._motion.after(tracks)
        for k in reversed(range(len(self._shapes))):  # the skin's layer on top
            visible, start = tracks.visible[k], self._rest.position[k]
            at, size = tracks.position[k], np.exp(np.nan_to_num(tracks.log_size[k]))
            shapes = self._shapes[k] * size[:, None, None]
            canvas.ellipses(at[visible], shapes[visible], _LAYERS[k], dashed=k > 0)
            moved = visible & self._known[k]
            canvas.lines(start[moved], start[moved] + magnify * (at - start)[moved], _MOTION)
            radius = float(self._start.radius[k])
            dropped_here = _away_from(self._dropped[k], at[visible], radius)
            left += len(dropped_here)
            canvas.crosses(dropped_here, 0.5 * radius, _DROPPED)
            canvas.crosses(start[self._known[k] & ~visible], 0.6 * radius, _LOST)
            doubtful = tracks.ambiguous[k] & visible
            canvas.circles(at[doubtful], np.full(doubtful.sum(), 1.5 * radius), _AMBIGUOUS)
        for k, name in enumerate(self._palette.names):
            count = f"{(tracks.visible[k] & self._known[k]).sum()} of {self._known[k].sum()}"
            line = "dashed" if k else "full line"
            words.append((f"{name} {count} ({line})", _LAYERS[k]))
        canvas.text(words, 0)
        canvas.scale_bar(0)
        lost, doubtful_count = (self._known & ~tracks.visible).sum(), tracks.ambiguous.sum()
        canvas.text(
            [
                (f"motion since rest x{magnify}", _MOTION),
                (f"x lost {lost}", _LOST),
                (f"o ambiguous {doubtful_count}", _AMBIGUOUS),
                (f"x not followed {left}", _DROPPED),
                *([] if self._palette.seen is None else [("sensor", _FIELD)]),
            ],
            1,
        )
        return canvas.pixels


def _nearest_shapes(at: Array, shapes: Array, own: Array, radius: float) -> Array:
    """Shapes (M, 2, 2) of markers at their own places (M, 2), of those that were detected there."""
    result = np.tile(radius * np.eye(2), (len(own), 1, 1))
    known, there = np.isfinite(at[:, 0]), np.isfinite(own[:, 0])
    if known.any() and there.any():
        away, number = scipy.spatial.KDTree(at[known]).query(own[there])
        near = np.asarray(away) < radius
        result[np.flatnonzero(there)[near]] = shapes[known][np.asarray(number)[near]]
    return result


class OverlayVideo(VideoFile):
    """Video of the markers; sources above 60 Hz play in slow motion.

    Parameters
    ----------
    path: of the video
    fps: of the source [Hz]
    """

    def __init__(self, path: Path, fps: float) -> None:
        fastest = 60.0  # highest rate of a video [Hz]: sources above it play in slow motion
        rate = Fraction(min(fps, fastest)).limit_denominator(1001)
        quality = 20  # rate factor of x264
        super().__init__(path, rate, quality)
