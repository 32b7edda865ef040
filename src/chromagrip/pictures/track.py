"""Tracking the markers of a source of frames, into a folder that stays readable if interrupted.

`open_tracking` finds rest frame, noise and markers; `follow` then gives the tracks of each frame to
whoever writes them down or reads more out of them, and writes the summary however it ends.
"""

import itertools
import json
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from ..errors import UserError
from ..output.folder import prepare
from ..output.parquet import TrackTable
from ..output.pictures import Source, open_source
from ..output.versions import versions
from ..render import Frame
from ..tracking import Palette, RestFrame, Tracker, Tracks, load_palette, load_tracker, read_rest
from .noise_level import noise_level
from .overlay import OverlayVideo, draw_tracks
from .rest_frames import rest_frames

FORMAT = "chromagrip track 1"
#: What a folder of tracks holds; the summary is written last.
FILES = ("summary.json", "tracks.parquet", "overlay.mp4")

_GIVEN = "given"

#: Told after each frame: frames done, and in all if that is known.
Progress = Callable[[int, int | None], None]
#: Given each frame's number, picture and tracks.
Add = Callable[[int, Frame, Tracks], None]


@dataclass(frozen=True, kw_only=True)
class Tracking:
    """A tracker that was reset, and the frames that it is to follow.

    Attributes
    ----------
    tracker, name: made, and as it was asked for
    palette: of the markers
    start, resting: the unloaded sensor, and the tracker's tracks of it
    source: where the frames are from
    coming: the frames, each checked to be as large as the rest frame
    told: of the summary, what is known beforehand
    """

    tracker: Tracker
    name: str
    palette: Palette
    start: RestFrame
    resting: Tracks
    source: Source
    coming: Iterator[Frame]
    told: dict[str, Any]


@dataclass(kw_only=True)
class _Tally:
    """What is counted while frames pass; it does not grow with their number.

    Arrays have the shape (L, M) of the tracks.
    """

    known: NDArray[np.bool_]
    seen: NDArray[np.int64]
    frames: int = 0
    seconds: float = 0.0
    ambiguous: int = 0
    last: Tracks | None = None

    def add(self, tracks: Tracks, seconds: float) -> None:
        self.frames += 1
        self.seconds += seconds
        self.seen += tracks.visible
        self.ambiguous += int(tracks.ambiguous.sum())
        self.last = tracks


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What tracking left.

    Attributes
    ----------
    summary: what `summary.json` holds
    broken: why the source broke off; None if it did not
    """

    summary: dict[str, Any]
    broken: str | None


def track_source(
    rest: str,
    source: str,
    *,
    palette: str,
    tracker: str,
    noise: float | None = None,
    fps: float | None = None,
    frames: int | None = None,
    out: Path | None = None,
    force: bool = False,
    tell: Callable[[str], None] = lambda _: None,
    progress: Progress = lambda _, __: None,
) -> Outcome:
    """Track the markers of a source; with `out`, leave tracks, overlay and summary in that folder.

    Where the source breaks off, the tracks up to there are kept and the outcome says so.
    Interrupted by Ctrl-C it keeps what it had, marked as not complete, and raises
    KeyboardInterrupt; a camera without a number of frames is ended that way, and complete.

    Parameters
    ----------
    rest: see `rest_frames`
    source: folder of pictures, video file, picture or camera:0
    palette, tracker: names or files, see `load_palette` and `load_tracker`
    noise: of the camera [grey levels]; by default it is estimated
    fps: frame rate [Hz], for pictures and instead of a video's own
    frames: stop after so many
    out: folder, made if missing
    force: write over an earlier result
    tell: called with what is being done before the first frame is tracked
    progress: called after every frame

    Raises
    ------
    UserError
        When there is nothing to track.
    """
    colours = load_palette(palette)
    tracking = open_tracking(
        rest, source, palette=colours, tracker=tracker, noise=noise, fps=fps, tell=tell
    )
    if out is not None:
        open_folder(out, force, FILES)

    def open_files(files: ExitStack) -> Add:
        if out is None:
            return lambda index, frame, tracks: None
        table = files.enter_context(TrackTable(out / "tracks.parquet", colours.names))
        video = files.enter_context(OverlayVideo(out / "overlay.mp4", tracking.source.fps))
        resting, radius = tracking.resting, tracking.start.radius

        def add(index: int, frame: Frame, tracks: Tracks) -> None:
            table.add(index, tracks)
            video.append(draw_tracks(frame.image, colours, tracks, resting, radius))

        return add

    told = {"format": FORMAT, "palette": palette, **tracking.told}
    return follow(tracking, told, open_files, frames, out, progress)


def open_tracking(
    rest: str,
    source: str,
    *,
    palette: Palette,
    tracker: str,
    noise: float | None,
    fps: float | None,
    tell: Callable[[str], None],
) -> Tracking:
    """Tracker that knows the unloaded sensor, and the frames to follow; see `track_source`.

    Raises
    ------
    UserError
        When there is nothing to track.
    """
    follower = load_tracker(tracker)
    opened = open_source(source, fps)
    tell("rest frame")
    with threadpool_limits(1):
        still, rest_words, coming = rest_frames(rest, opened, palette, tell)
        if noise is None:
            tell("noise")
            noise, noise_words = noise_level(still, opened.lossy)
        else:
            noise_words = _GIVEN
        tell("markers at rest")
        start = read_rest(still, palette)
        made = follower(palette, noise)
        resting = _reset(made, still, noise, noise_words)
        _check_rest(resting, palette, tracker)
        first, coming = _first(coming, opened, start)
    return Tracking(
        tracker=made,
        name=tracker,
        palette=palette,
        start=start,
        resting=resting,
        source=opened,
        coming=coming,
        told={
            "source": opened.name,
            "rest": rest_words,
            "tracker": tracker,
            "noise_levels": noise,
            "noise_from": noise_words,
            "width_px": first.image.shape[1],
            "height_px": first.image.shape[0],
            "fps": opened.fps,
        },
    )


def follow(
    tracking: Tracking,
    told: dict[str, Any],
    open_files: Callable[[ExitStack], Add],
    limit: int | None,
    out: Path | None,
    progress: Progress,
    results: Callable[[], dict[str, Any]] = dict,
) -> Outcome:
    """Track frame after frame; the summary is written however it ends.

    Parameters
    ----------
    tracking: what to follow
    told: of the summary, what is known beforehand
    open_files: opens what is written while frames pass, and gives what each frame is told to
    limit: stop after so many frames
    out: folder of the summary; None writes none
    progress: called after every frame
    results: of the summary, what else the frames gave, once the files are closed
    """
    palette, resting, source = tracking.palette, tracking.resting, tracking.source
    known = np.isfinite(resting.position[..., 0])
    tally = _Tally(known=known, seen=np.zeros(known.shape, dtype=np.int64))
    total = source.count if limit is None else min(limit, source.count or limit)
    complete, ended, broken = False, "", None
    try:
        with ExitStack() as files, threadpool_limits(1):
            # One thread: frames are small, and sources are tracked side by side.
            cv2.setNumThreads(1)
            add = open_files(files)
            for index, frame in enumerate(itertools.islice(tracking.coming, limit)):
                begin = time.perf_counter()
                tracks = tracking.tracker.update(frame)
                seconds = time.perf_counter() - begin
                _check_tracks(tracks, resting, tracking.name)
                tally.add(tracks, seconds)
                add(index, frame, tracks)
                progress(tally.frames, total)
        complete, ended = True, "end of the source"
        if limit is not None and tally.frames == limit:
            ended = f"after {limit} frames, as asked"
    except UserError as error:
        kept = "" if out is None else f"; the results of the {tally.frames} frames before are kept"
        ended = broken = f"{error}{kept}"
    except KeyboardInterrupt:
        complete, ended = source.live and limit is None, "interrupted"
        if not complete:
            raise
    except Exception as error:  # of anybody's tracker: told in the summary, and raised
        ended = f"{type(error).__name__}: {error}"
        raise
    finally:
        summary = {**told, "complete": complete, "ended": ended, **_results(tally, palette)}
        summary |= {**results(), "versions": versions()}
        if out is not None:
            text = json.dumps(summary, indent=2)
            (out / "summary.json").write_text(text + "\n", encoding="utf-8")
    return Outcome(summary=summary, broken=broken)


def _first(
    coming: Iterator[Frame], source: Source, start: RestFrame
) -> tuple[Frame, Iterator[Frame]]:
    """First frame, and all of them, each checked to be as large as the rest frame."""
    first = next(coming, None)
    if first is None:
        raise UserError(f"{source.name} has no frames")
    _check_size(first, 0, source, start)
    return first, itertools.chain([first], _checked(coming, source, start))


def _checked(coming: Iterator[Frame], source: Source, start: RestFrame) -> Iterator[Frame]:
    for index, frame in enumerate(coming, 1):
        _check_size(frame, index, source, start)
        yield frame


def _check_size(frame: Frame, index: int, source: Source, start: RestFrame) -> None:
    (height, width), (tall, wide) = frame.image.shape[:2], start.image.shape[:2]
    if (height, width) != (tall, wide):
        raise UserError(
            f"frame {index} of {source.name} is {width}×{height} pixels, the rest frame "
            f"{wide}×{tall}"
        )


def _check_tracks(tracks: object, resting: Tracks, name: str) -> None:
    """Refuse what somebody's tracker gives that are no tracks of the same markers."""
    if not isinstance(tracks, Tracks):
        raise UserError(f"tracker {name!r} gave a {type(tracks).__name__}; wanted: Tracks")
    if tracks.position.shape != resting.position.shape:
        raise UserError(
            f"tracker {name!r} gave positions of shape {tracks.position.shape}, at rest "
            f"{resting.position.shape}; wanted: the same markers in every frame"
        )


def _reset(tracker: Tracker, still: list[Frame], noise: float, noise_words: str) -> Tracks:
    """Tracks at rest; where they are refused, with a word on noise that may be too low."""
    try:
        return tracker.reset(still)
    except UserError as error:
        if noise_words == _GIVEN:
            raise
        raise UserError(
            f"{error}; the noise was taken as {noise:.2f} levels, give --noise if it is more"
        ) from None


def _check_rest(resting: object, palette: Palette, name: str) -> None:
    """Refuse what somebody's tracker gives at rest that are no tracks of the palette's layers."""
    if not isinstance(resting, Tracks):
        raise UserError(f"tracker {name!r} gave a {type(resting).__name__}; wanted: Tracks")
    if len(resting.position) != len(palette.names):
        raise UserError(
            f"tracker {name!r} gave {len(resting.position)} layers; wanted: {len(palette.names)}"
        )


def open_folder(folder: Path, force: bool, files: tuple[str, ...]) -> None:
    """Folder without an earlier result's files.

    Raises
    ------
    UserError
        When it holds files and `force` is not given, or cannot be written to.
    """
    prepare(folder, force)
    try:
        for name in files:
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise UserError(f"folder {folder} cannot be written: {error.strerror}") from None


def _results(tally: _Tally, palette: Palette) -> dict[str, Any]:
    """Counts of the frames tracked."""
    last, frames = tally.last, tally.frames
    layers = {
        name: {
            "markers": int(known.sum()),
            "visible_share": float(seen[known].mean() / frames) if frames and known.any() else None,
        }
        for name, known, seen in zip(palette.names, tally.known, tally.seen, strict=True)
    }
    lost = []
    if last is not None:
        for k, m in np.argwhere(tally.known & ~last.visible):
            when = float(last.last_seen[k, m])
            lost.append(
                {
                    "marker": int(m),
                    "layer": palette.names[k],
                    "last_seen_s": when if np.isfinite(when) else None,
                }
            )
    return {
        "frames": frames,
        "layers": layers,
        "lost": lost,
        "ambiguous": tally.ambiguous,
        "ms_per_frame": 1e3 * tally.seconds / frames if frames else None,
    }
