"""A finished run for the page: its folder's curves and video, and forces from a repetition.

A folder does not have the force at each place. Its scene is run again with its seed, and each frame
is compared with the record.
"""

import bisect
import math
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field

import numpy as np

from ..by_name import not_allowed
from ..errors import UserError
from ..loop.columns import values_of
from ..loop.grasp import gripped
from ..loop.results.run_folder import RunRead
from ..loop.results.tactile_video import SLOWDOWN
from ..loop.rig import Rig
from ..loop.sample import Sample
from ..output.processes import one_thread
from ..sources import open_source
from .picture import packed, picture_of, resized
from .record import FROM
from .view import Drawn, GraspView
from .worker import Background

#: Largest number of frames kept of a run; of a longer run every second, third … frame is kept.
MOST = 1500
#: Columns by which a repetition is compared, with their names in words and the largest differences
#: that count as equal: another processor rounds differently.
_COMPARED = {
    "margin_true": ("the true Γ", 1e-6),
    "margin_estimated": ("the estimated Γ", 1e-6),
    "applied_n": ("the grip [N]", 1e-6),
}


@dataclass(frozen=True, kw_only=True)
class Kept:
    """A frame of a finished run.

    Attributes
    ----------
    time: time in the run [s]
    picture: picture as JPEG
    estimated, true: drawing of the estimated and of the true forces; None if only a video exists
    """

    time: float
    picture: bytes
    estimated: Drawn | None = None
    true: Drawn | None = None


@dataclass
class Replay(Background):
    """Frames of a finished run, made in a thread of their own; a context.

    Attributes
    ----------
    run: run that was read
    view: view for which the forces are drawn
    frames: frames so far, in order
    ended: whether no more frames will come
    failed: reason of a failure; empty if there was no failure
    differences: largest differences between record and repetition, by column
    """

    run: RunRead
    view: GraspView
    frames: list[Kept] = field(default_factory=list)
    ended: bool = False
    failed: str = ""
    differences: dict[str, float] = field(default_factory=dict)

    def at(self, time: float) -> Kept | None:
        """Last frame up to a time [s], or the first one; None before there are frames."""
        frames = self.frames[:]  # a copy: the thread appends to it
        index = bisect.bisect_right(frames, time + 1e-9, key=lambda kept: kept.time)
        return frames[max(index - 1, 0)] if frames else None

    def words(self) -> str:
        """Result of the repetition so far, in a sentence of Markdown."""
        if self.failed:
            return f"**the run cannot be shown in full:** {self.failed}"
        if because := not_repeated(self.run):
            return because
        reached = f"up to {self.frames[-1].time:.2f} s" if self.frames and not self.ended else ""
        off = {
            words: self.differences[name]
            for name, (words, most) in _COMPARED.items()
            if self.differences.get(name, 0.0) > most
        }
        if off:
            listed = ", ".join(f"{words} by up to {most:.2g}" for words, most in off.items())
            return f"**repeated {reached}: it differs from the record**, {listed}"
        if self.ended:
            return "repeated from scene and seed; it agrees with the record"
        return f"being repeated from scene and seed, {reached or 'from the start'}"

    def _run(self) -> None:
        try:
            found = _video(self.run) if not_repeated(self.run) else self._repeated()
            with one_thread():
                for kept in found:
                    self.frames.append(kept)
                    if self._stop.is_set():
                        return
        except UserError as error:
            self.failed = str(error)
        self.ended = True

    def _repeated(self) -> Iterator[Kept]:
        """Run the scene again, and yield its frames."""
        count = len(self.run.columns["time_s"])
        every = max(1, math.ceil(count / MOST))
        with closing(Rig(self.run.scene)) as rig:
            for index, sample in enumerate(gripped(rig, math.inf)):
                if index >= count or self._stop.is_set():
                    return
                self._compare(index, sample)
                if index % every:
                    continue
                picture = picture_of(rig.picture().image, sample.tracks, sample.rest)
                yield Kept(
                    time=sample.time,
                    picture=packed(picture),
                    estimated=self.view.drawn(sample, True),
                    true=self.view.drawn(sample, False),
                )

    def _compare(self, index: int, sample: Sample) -> None:
        """Note where a frame differs from the record."""
        for name, now in values_of(sample, _COMPARED).items():
            before = float(self.run.columns[name][index])
            if not np.isnan(before) or not np.isnan(now):
                off = abs(before - now)
                off = math.inf if np.isnan(off) else off
                self.differences[name] = max(self.differences.get(name, 0.0), off)


def not_repeated(run: RunRead) -> str:
    """Reason for which a run cannot be repeated, in a sentence; "" if it can."""
    if FROM in run.summary:
        why = "its sliders were moved by hand"
    elif "source" in run.summary:
        why = "its frames came from outside"
    elif code := not_allowed(run.scene):
        why = f"{code} is code of the folder, which runs only where --allow names its module"
    else:
        return ""
    shown = "curves and video are shown" if run.video else "only its curves are shown"
    return f"**no forces in three dimensions:** this run cannot be repeated, {why}; {shown}"


def _video(run: RunRead) -> Iterator[Kept]:
    """Pictures of a run's video."""
    if run.video is None:
        return
    source = open_source(str(run.video))
    every = max(1, math.ceil((source.count or 1) / MOST))
    wide = 840  # width of the pictures of a video, which have two halves [px]
    for index, frame in enumerate(source.frames()):
        if index % every == 0:
            yield Kept(time=frame.time / SLOWDOWN, picture=packed(resized(frame.image, wide)))
