"""Frame after frame through a tracker, into a folder that stays readable if interrupted."""

import itertools
import json
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Generic, NamedTuple, TypedDict, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..compiled import working_time
from ..errors import UserError
from ..folders import prepared, write_whole
from ..output.processes import one_thread
from ..render import Frame
from ..sources.delivery import Counts
from ..sources.feed import Feed
from ..tracking import Palette, Tracks
from .opening import Opened

#: Called after each frame with the number of frames done, and of all frames if it is known.
Progress = Callable[[int, int | None], None]


class Came(NamedTuple):
    """How a frame came.

    Attributes
    ----------
    at: time of its arrival, by `time.monotonic` [s]
    skipped: number of frames that were left out so far, because newer ones had come
    """

    at: float
    skipped: int = 0


#: Called with each frame's number, picture and tracks, and how it came.
Add = Callable[[int, Frame, Tracks, Came], None]
Summary = TypeVar("Summary", bound=Mapping[str, object])


class LayerCount(TypedDict):
    """Markers of a layer, and the share of the frames in which they were visible."""

    markers: int
    visible_share: float | None


class LostMarker(TypedDict):
    """A marker that the last frame does not show."""

    marker: int
    layer: str
    last_seen_s: float | None


class Course(TypedDict):
    """Part of a summary that counts the frames tracked."""

    complete: bool
    ended: str
    frames: int
    source_doubt: str | None
    layers: dict[str, LayerCount]
    lost: list[LostMarker]
    ambiguous: int
    delivery: Counts
    ms_per_frame: float | None


@dataclass(frozen=True, kw_only=True)
class Outcome(Generic[Summary]):
    """Result of tracking.

    Attributes
    ----------
    summary: content of `summary.json`
    broken: why the source broke off; None if it did not
    """

    summary: Summary
    broken: str | None


@dataclass
class SpeedCount:
    """Mean time of a frame. The first of several loads kernels and tables, and does not count."""

    frames: int = 0
    seconds: float = 0.0

    def add(self, seconds: float) -> None:
        """Count a frame."""
        self.seconds = seconds if self.frames < 2 else self.seconds + seconds
        self.frames += 1

    @property
    def milliseconds(self) -> float | None:
        """Mean time [ms]; None without a frame."""
        return 1e3 * self.seconds / max(1, self.frames - 1) if self.frames else None


@dataclass(kw_only=True)
class _Tally:
    """Counts while frames pass; its size does not grow with their number.

    Arrays have the shape (L, M) of the tracks. `absent` is whether more than half of the markers
    were lost in each of the first frames.
    """

    known: NDArray[np.bool_]
    visible: NDArray[np.int64]
    frames: int = 0
    clock: SpeedCount = field(default_factory=SpeedCount)
    ambiguous: int = 0
    absent: bool = True
    last: Tracks | None = None
    broken: str | None = None

    def add(self, tracks: Tracks, seconds: float) -> None:
        self.frames += 1
        self.clock.add(seconds)
        self.visible += tracks.visible
        self.ambiguous += int(tracks.ambiguous.sum())
        self.last = tracks
        compared = 3  # frames whose markers are compared with those of the rest frame
        if self.frames <= compared:
            self.absent &= bool(2 * tracks.visible[self.known].sum() < self.known.sum())


@contextmanager
def opened_folder(folder: Path | None, overwrite: bool, files: tuple[str, ...]) -> Iterator[None]:
    """Hold a folder without the files of an earlier result; None is no folder.

    Raises
    ------
    UserError
        When it holds files and `overwrite` is not given, or cannot be written to.
    """
    with prepared(folder, overwrite):
        try:
            for path in [folder / name for name in files] if folder is not None else []:
                path.unlink(missing_ok=True)
        except OSError as error:
            raise UserError(f"folder {folder} cannot be written: {error.strerror}") from None
        yield


def follow(
    opened: Opened,
    open_files: Callable[[ExitStack], Add],
    summarise: Callable[[Course], Summary],
    limit: int | None,
    out: Path | None,
    progress: Progress,
    newest: bool = False,
) -> Outcome[Summary]:
    """Track frame after frame; the summary is written however it ends.

    Parameters
    ----------
    opened: tracker and frames
    open_files: opens the files that are written while frames pass; returns what adds a frame to
        them
    summarise: makes the summary, once the files are closed
    limit: stop after so many frames
    out: folder of the summary; None writes none
    progress: called after every frame
    newest: whether frames of a live source are skipped when newer ones have come
    """
    known = np.isfinite(opened.resting.position[..., 0])
    tally = _Tally(known=known, visible=np.zeros(known.shape, dtype=np.int64))
    count = opened.source.count
    total = count if limit is None else min(limit, count or limit)
    complete, ended = False, ""
    opened.source.delivery.go_on()
    try:
        with ExitStack() as files, one_thread():
            add = open_files(files)
            for index, frame, tracks, came in _tracked(opened, tally, limit, newest):
                add(index, frame, tracks, came)
                progress(tally.frames, total)
        if tally.broken is not None:
            kept = f"; the results of the {tally.frames} frames before are kept"
            tally.broken += "" if out is None else kept
            ended = tally.broken
        elif limit is not None and tally.frames == limit:
            complete, ended = True, f"after {limit} frames, as asked"
        else:
            complete, ended = True, "end of the source"
    except KeyboardInterrupt:
        complete, ended = opened.source.live and limit is None, "interrupted"
        if not complete:
            raise
    except Exception as error:  # a disk that is full, or a bug of a plug-in or ours
        ended = str(error) if isinstance(error, UserError) else f"{type(error).__name__}: {error}"
        raise
    finally:
        summary = summarise(_course(tally, opened, complete, ended))
        if out is not None:
            text = json.dumps(summary, indent=2) + "\n"
            write_whole(out / "summary.json", text.encode())
    return Outcome(summary=summary, broken=tally.broken)


def _tracked(
    opened: Opened, tally: _Tally, limit: int | None, newest: bool
) -> Iterator[tuple[int, Frame, Tracks, Came]]:
    """Frames with their tracks, until the source ends or breaks off."""
    try:
        frames = itertools.islice(_coming(opened, newest), limit)
        for index, (frame, came) in enumerate(frames):
            begin = working_time()
            tracks = _followed(opened.reader.track(frame), tally.known)
            tally.add(tracks, working_time() - begin)
            yield index, frame, tracks, came
    except UserError as error:
        tally.broken = str(error)


def _followed(tracks: Tracks, known: NDArray[np.bool_]) -> Tracks:
    """Tracks of the markers (L, M) with a place at rest; others are not followed, so not seen."""
    if not ((tracks.visible | np.isfinite(tracks.last_seen)) & ~known).any():
        return tracks
    values = np.repeat(known.T, 3, axis=1)  # x, y and log_size of each layer
    return replace(
        tracks,
        position=np.where(known[..., None], tracks.position, np.nan),
        log_size=np.where(known, tracks.log_size, np.nan),
        visible=tracks.visible & known,
        ambiguous=tracks.ambiguous & known,
        last_seen=np.where(known, tracks.last_seen, np.nan),
        covariance=np.where(values[:, None] & values[..., None], tracks.covariance, np.nan),
    )


def _coming(opened: Opened, newest: bool) -> Iterator[tuple[Frame, Came]]:
    """Frames as they come; of a live source the newest, if wanted."""
    if not (newest and opened.source.live):
        for frame in opened.frames:
            yield frame, Came(time.monotonic())
        return
    frame_within = 10.0  # time in which the next frame must come [s]
    source = replace(opened.source, frames=lambda: opened.frames)
    with closing(Feed(source, frame_within)) as feed:
        while (found := feed.next()) is not None:
            yield found, Came(feed.arrived, feed.skipped)


def _course(tally: _Tally, opened: Opened, complete: bool, ended: str) -> Course:
    """Counts of the frames tracked."""
    frames, palette = tally.frames, opened.palette
    doubt = opened.source.doubt or opened.source.delivery.doubt
    if tally.absent and frames:
        name = opened.source.name
        doubt = (
            f"most markers of the rest picture are not in the first frames of {name}: is it of the "
            "same sensor?"
        )
    layers: dict[str, LayerCount] = {}
    for name, known, visible in zip(palette.names, tally.known, tally.visible, strict=True):
        share = float(visible[known].mean() / frames) if frames and known.any() else None
        layers[name] = {"markers": int(known.sum()), "visible_share": share}
    return {
        "complete": complete,
        "ended": ended,
        "frames": frames,
        "source_doubt": doubt or None,
        "layers": layers,
        "lost": [] if tally.last is None else _lost(tally.last, tally.known, palette),
        "ambiguous": tally.ambiguous,
        "delivery": opened.source.delivery.counts,
        "ms_per_frame": tally.clock.milliseconds,
    }


def _lost(tracks: Tracks, known: NDArray[np.bool_], palette: Palette) -> list[LostMarker]:
    """Markers that are known at rest and not visible now."""
    lost: list[LostMarker] = []
    for k, m in np.argwhere(known & ~tracks.visible):
        when = float(tracks.last_seen[k, m])
        last_seen = when if np.isfinite(when) else None
        lost.append({"marker": int(m), "layer": palette.names[k], "last_seen_s": last_seen})
    return lost
