"""A source of frames opened for tracking: rest frames, noise, and a tracker that was reset."""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TypedDict

import numpy as np

from ..by_name import Choice, blaming, name_of
from ..errors import UserError, located
from ..output.processes import one_thread
from ..render import Frame, SensorDesign
from ..sensing.reader import Reader, check_tracks
from ..sources import FrameSource, Source, open_source
from ..sources.source import ValueRange
from ..stored_pictures import MEGAPIXELS, Image
from ..tracking import Palette, RestFrame, Tracker, Tracks, load_tracker, read_rest
from .find_sensor import Find
from .noise_level import noise_level
from .rest_frames import LeftOut, refuse_swapped, rest_frames, rest_picture
from .scale import Scale, reduction, scale_to

_GIVEN = "given"


class Setup(TypedDict):
    """Part of a summary that is known before the first frame is tracked."""

    source: str
    rest: str
    rest_left_out: list[LeftOut]
    rest_doubt: str | None
    tracker: str
    noise_levels: float
    noise_from: str
    width_px: int
    height_px: int
    scaled_by: float
    fps: float
    fps_from: str


@dataclass(frozen=True)
class Opened:
    """A reader that was given the sensor at rest, and the frames that it is to read.

    Attributes
    ----------
    reader: of the frames; it reads markers alone until `with_forces` gives it more
    palette: of the markers
    start: the unloaded sensor
    source: of the frames
    frames: each checked to be as large as the rest frame
    setup: the same for a summary
    scale: what made them of the source's pictures
    """

    reader: Reader
    palette: Palette
    start: RestFrame
    source: Source
    frames: Iterator[Frame]
    setup: Setup
    scale: Scale

    @property
    def resting(self) -> Tracks:
        """Markers of the unloaded sensor."""
        return self.reader.rest


def open_tracking(
    rest: str,
    source: Choice | FrameSource,
    *,
    find: Find,
    tracker: Choice,
    noise: float | None,
    fps: float | None,
    tell: Callable[[str], None],
    sensor: SensorDesign | None = None,
    max_megapixels: float = MEGAPIXELS,
    value_range: ValueRange = None,
) -> Opened:
    """Tracker that knows the unloaded sensor, and the frames to follow; see `track_source`.

    Pictures, and their noise, are scaled to a `sensor`'s camera, or reduced.

    Raises
    ------
    UserError
        When there is nothing to track.
    """
    make, name, limits = load_tracker(tracker), name_of(tracker), (max_megapixels, value_range)
    refuse_swapped(rest, name_of(source))
    opened = open_source(source, fps, rest_picture(rest, name_of(source)), *limits)
    tell("rest frame")
    with one_thread():
        scale_of = reduction if sensor is None else partial(scale_to, sensor)
        at_rest = rest_frames(rest, opened, find, tell, scale_of, *limits)
        still, place, shape = at_rest.still, at_rest.place, _size(at_rest.still[0])
        with located(place):
            scale = scale_of(_mean(still))
        noise, noise_words = _noise(still, scale, opened, noise, tell)
        tell("markers at rest")
        still = [replace(frame, image=scale(frame.image)) for frame in still]
        with located(place):
            palette = find(_mean(still), shape)
            start = read_rest(still, palette)
        with blaming(f"tracker {name!r} failed", SystemExit):
            made = make(palette, noise)
            resting = _reset(made, still, noise, noise_words, place)
        _check_rest(resting, palette, name)
        frames = _begun(at_rest.frames, opened, shape)
    setup = Setup(
        source=opened.name,
        rest=at_rest.words,
        rest_left_out=[*at_rest.left_out],
        rest_doubt=start.doubt or None,
        tracker=name,
        noise_levels=noise,
        noise_from=noise_words,
        width_px=shape[1],
        height_px=shape[0],
        scaled_by=scale.factor,
        fps=opened.fps,
        fps_from=opened.fps_from,
    )
    shown = (replace(frame, image=scale(frame.image)) for frame in frames)
    reader = Reader.of_tracker(made, repr(name), resting)
    return Opened(reader, palette, start, opened, shown, setup, scale)


def _mean(frames: list[Frame]) -> Image:
    """Mean picture of frames of one size."""
    return np.rint(np.mean([frame.image for frame in frames], axis=0)).astype(np.uint8)


def _noise(
    still: list[Frame],
    scale: Scale,
    source: Source,
    given: float | None,
    tell: Callable[[str], None],
) -> tuple[float, str]:
    """Noise of scaled pictures [grey levels], and its source in words."""
    noise, words = given, _GIVEN
    if noise is None:
        tell("noise")
        noise, words = noise_level(still, source.lossy)
    return noise * scale.factor, words  # a larger pixel knows as much as those it is made of


def _reset(
    tracker: Tracker, still: list[Frame], noise: float, noise_words: str, place: str
) -> Tracks:
    """Tracks at rest; a refusal says that the noise may be too low where it was estimated."""
    try:
        with located(place):
            return tracker.reset(still)
    except UserError as error:
        if noise_words == _GIVEN:
            raise
        raise UserError(
            f"{error}; the noise was taken as {noise:.2f} levels, give --noise if it is more, or "
            "--crop or --mask if something else was taken for the sensor"
        ) from None


def _check_rest(resting: Tracks, palette: Palette, name: str) -> None:
    """Refuse tracks at rest that are not of the palette's layers."""
    check_tracks(resting, repr(name))
    if len(resting.position) != len(palette.names):
        raise UserError(
            f"tracker {name!r} gave {len(resting.position)} layers; wanted: {len(palette.names)}"
        )


def _begun(frames: Iterator[Frame], source: Source, shape: tuple[int, int]) -> Iterator[Frame]:
    """Frames of which the first is there, each checked to have that height and width [px]."""
    first = next(frames, None)
    if first is None:
        raise UserError(f"{source.name} has no frames")
    _check_size(first, 0, source, shape)
    return itertools.chain([first], _checked(frames, source, shape))


def _checked(frames: Iterator[Frame], source: Source, shape: tuple[int, int]) -> Iterator[Frame]:
    for index, frame in enumerate(frames, 1):
        _check_size(frame, index, source, shape)
        yield frame


def _size(frame: Frame) -> tuple[int, int]:
    """Height and width [px]."""
    height, width = frame.image.shape[:2]
    return height, width


def _check_size(frame: Frame, index: int, source: Source, shape: tuple[int, int]) -> None:
    (height, width), (rest_height, rest_width) = _size(frame), shape
    if (height, width) != (rest_height, rest_width):
        raise UserError(
            f"{source.frame_name(index)} is {width}×{height} pixels, the rest frame "
            f"{rest_width}×{rest_height}"
        )
