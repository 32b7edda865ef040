"""Tracks of the markers of one's own pictures, in a folder."""

from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from ..by_name import Choice
from ..extras import require
from ..output.parquet import TrackTable
from ..output.versions import versions
from ..render import Frame
from ..tracking import Tracks, load_palette
from .following import Add, Course, Outcome, Progress, follow, open_folder
from .opening import Opened, Setup, open_tracking
from .overlay import OverlayVideo, draw_tracks

FORMAT = "chromagrip track 1"
#: Files of a folder of tracks; the summary is written last.
FILES = ("summary.json", "tracks.parquet", "overlay.mp4")


class TrackSummary(Setup, Course):
    """Content of `summary.json`."""

    format: str
    palette: str
    versions: dict[str, str]


def track_source(
    rest: str,
    source: str,
    *,
    palette: str,
    tracker: Choice,
    noise: float | None = None,
    fps: float | None = None,
    frames: int | None = None,
    out: Path | None = None,
    overwrite: bool = False,
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
    source: folder of pictures, video file, picture or camera:0
    palette: name or file, see `load_palette`
    tracker: name, `module:Class`, or a class or other factory, see `load_tracker`
    noise: of the camera [grey levels]; by default it is estimated
    fps: frame rate [Hz], for pictures and instead of a video's own
    frames: stop after so many
    out: folder, made if missing
    overwrite: whether an earlier result is replaced
    tell: called with the current step before the first frame is tracked
    progress: called after every frame

    Raises
    ------
    UserError
        When there is nothing to track.
    """
    if out is not None:
        require("data", "video", purpose="writing tracks")
    colours = load_palette(palette)
    if out is not None:
        require("data", "video", purpose="a folder of tracks")
    opened = open_tracking(
        rest, source, palette=colours, tracker=tracker, noise=noise, fps=fps, tell=tell
    )
    if out is not None:
        open_folder(out, overwrite, FILES)

    def summarise(course: Course) -> TrackSummary:
        return {
            "format": FORMAT,
            "palette": palette,
            **opened.setup,
            **course,
            "versions": versions(),
        }

    return follow(opened, partial(_open_files, opened, out), summarise, frames, out, progress)


def _open_files(opened: Opened, out: Path | None, files: ExitStack) -> Add:
    """Open table and overlay; returns what adds a frame to them."""
    if out is None:
        return lambda index, frame, tracks: None
    palette, resting = opened.palette, opened.resting
    table = files.enter_context(TrackTable(out / "tracks.parquet", palette.names))
    video = files.enter_context(OverlayVideo(out / "overlay.mp4", opened.source.fps))

    def add(index: int, frame: Frame, tracks: Tracks) -> None:
        table.add(index, tracks)
        video.append(draw_tracks(frame.image, palette, tracks, resting, opened.start.radius))

    return add
