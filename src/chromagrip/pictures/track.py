"""Tracks of the markers of one's own pictures, in a folder."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypedDict

import numpy as np

from ..by_name import Choice
from ..output.parquet import TrackTable
from ..output.versions import versions
from ..render import Frame
from ..sources import FrameSource
from ..sources.source import ValueRange
from ..stored_pictures import MEGAPIXELS
from ..tracking import AUTO_PALETTE, Edge, Tracks
from .find_sensor import ANYWHERE, Assumed, Within, assumed, finder
from .following import Add, Came, Course, Outcome, Progress, follow, opened_folder
from .opening import Opened, Setup, open_tracking
from .overlay import OVERLAY, OverlayVideo, TrackDrawing, dropped

FORMAT = "chromagrip track 1"
#: Files of a folder of tracks; the summary is written last.
FILES = ("summary.json", "tracks.parquet", OVERLAY)

#: Reasons why a marker is not followed.
_CUT = "cut by the edge of the field"
_UNLIKE = "unlike the others to this tracker; detect follows any form"
_UNTOLD = "a dot that is faint, torn, or touches others"


class NotFollowed(TypedDict):
    """A marker that was seen at rest and is not followed, and why."""

    layer: str
    x_px: float
    y_px: float
    reason: str


class TrackSummary(Assumed, Setup, Course):
    """Content of `summary.json`."""

    format: str
    not_followed: list[NotFollowed]
    versions: dict[str, str]


def track_source(
    rest: str,
    source: Choice | FrameSource,
    *,
    palette: str = AUTO_PALETTE,
    within: Within = ANYWHERE,
    tracker: Choice,
    noise: float | None = None,
    fps: float | None = None,
    frames: int | None = None,
    out: Path | None = None,
    overwrite: bool = False,
    max_megapixels: float = MEGAPIXELS,
    value_range: ValueRange = None,
    tell: Callable[[str], None] = lambda _: None,
    progress: Progress = lambda _, __: None,
) -> Outcome[TrackSummary]:
    """Track the markers of a source; with `out`, leave tracks, overlay and summary in that folder.

    Where the source breaks off, the tracks up to there are kept and the outcome says so.
    Interrupted by Ctrl-C it keeps the tracks so far, marked as not complete, and raises
    KeyboardInterrupt; a camera without a number of frames is ended that way, and complete.

    Parameters
    ----------
    rest: see `rest_frames`
    source: source of the frames, see `open_source`
    palette: `auto`, or a name or file, see `load_palette`
    within: where the sensor is, by default found
    tracker: name, `module:Class`, or a class or other factory, see `load_tracker`
    noise: of the camera [grey levels]; by default it is estimated
    fps: frame rate [Hz], for pictures and instead of a video's own
    frames: stop after so many
    out, overwrite: folder, made if missing, and whether an earlier result in it is replaced
    max_megapixels, value_range: see `open_source`
    tell, progress: called with the current step before the first frame, and after every frame

    Raises
    ------
    UserError
        When there is nothing to track.
    """
    find = finder(palette, within)
    opened = open_tracking(
        rest,
        source,
        find=find,
        tracker=tracker,
        noise=noise,
        fps=fps,
        tell=tell,
        max_megapixels=max_megapixels,
        value_range=value_range,
    )
    known = assumed(palette, opened.palette, within, round(1.0 / opened.scale.factor))
    summarise = partial(_summary, opened, known)
    with opened_folder(out, overwrite, FILES):
        return follow(opened, partial(_open_files, opened, out), summarise, frames, out, progress)


def _summary(opened: Opened, known: Assumed, course: Course) -> TrackSummary:
    return {
        "format": FORMAT,
        "not_followed": _not_followed(opened),
        **known,
        **opened.setup,
        **course,
        "versions": versions(),
    }


def _not_followed(opened: Opened) -> list[NotFollowed]:
    start, found = opened.start, list[NotFollowed]()
    for k, at in enumerate(dropped(opened.palette, start, opened.resting)):
        cut = Edge.of_rest(start, opened.palette, at).cut
        detected = (at[:, None] == start.position[k]).all(axis=-1).any(axis=1)
        reasons = np.where(cut, _CUT, np.where(detected, _UNLIKE, _UNTOLD))
        for (x, y), reason in zip(
            opened.scale.original(at).round(2).tolist(), reasons, strict=True
        ):
            layer = opened.palette.names[k]
            found.append({"layer": layer, "x_px": x, "y_px": y, "reason": str(reason)})
    return found


def _original(tracks: Tracks, opened: Opened) -> Tracks:
    """Tracks in pixels of the source's pictures."""
    scale = opened.scale
    if scale.factor == 1.0:
        return tracks
    factor = np.tile([1.0 / scale.factor, 1.0 / scale.factor, 1.0], len(tracks.position))
    return replace(
        tracks,
        position=scale.original(tracks.position),
        covariance=tracks.covariance * np.outer(factor, factor),
    )


def _open_files(opened: Opened, out: Path | None, files: ExitStack) -> Add:
    """Open table and overlay; returns what adds a frame to them."""
    if out is None:
        return lambda index, frame, tracks, came: None
    draw = TrackDrawing(opened.palette, opened.start, opened.resting)
    rest = opened.scale.original(opened.resting.position)
    table = files.enter_context(TrackTable(out / "tracks.parquet", opened.palette.names, rest))
    video = files.enter_context(OverlayVideo(out / OVERLAY, opened.source.fps))

    def add(index: int, frame: Frame, tracks: Tracks, _: Came) -> None:
        table.add(index, _original(tracks, opened))
        video.append(draw(frame.image, tracks))

    return add
