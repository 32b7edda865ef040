"""The folder of a run, which stays readable after an interruption.

Packages that only a folder needs (FFmpeg, Arrow, matplotlib) are imported when it is written.
"""

import json
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Self

from ..errors import UserError
from ..folders import filling, leave, prepared, sync
from ..output.frames import FRAMES, FrameFiles, FrameFormat
from ..output.logs.write import LOG_FILES, LogFormat, write_logs
from ..output.versions import versions
from ..scene.scene import Scene, dump_scene
from .columns import Rows, prefixes
from .results.trace_file import TRACE, VIDEO, write_trace
from .rig import Rig
from .sample import Sample
from .trace import Summary, Trace, TraceLines

if TYPE_CHECKING:
    from .pinch.video import PinchVideo
    from .results.tactile_video import TactileVideo

#: Files of a run folder.
FILES = (
    "summary.json",
    TRACE,
    "figure.png",
    VIDEO,
    "scene.toml",
    "report.html",
)
#: Folder of unfinished files in a run folder.
PARTS = ".parts"
#: File in `PARTS` with the lines of the trace so far, for a run that is killed.
LINES = "trace.csv"


class RunFiles:
    """Files of a run, which get their final names together, once all are written.

    Until then they are in a folder inside the run folder, with the lines of the trace as text;
    they remain there if the run is killed. On a full disk only the scene remains.

    Parameters
    ----------
    folder: run folder, made if missing
    overwrite: whether an earlier run's files are removed
    scene: scene that is run
    frames: format of the camera's kept pictures (default: they are not kept)
    log: formats of the logs that are written after the other files
    drawn: whether to make figure and video, which need the truth (default: yes)
    """

    def __init__(
        self,
        folder: Path,
        overwrite: bool,
        scene: Scene,
        frames: FrameFormat | None = None,
        log: Sequence[LogFormat] = (),
        drawn: bool = True,
    ) -> None:
        self.folder = folder
        self._parts = folder / PARTS
        self._scene, self._log, self._drawn = scene, log, drawn
        self._video: TactileVideo | PinchVideo | None = None
        self._frames: list[FrameFiles] = []
        self._lines: TraceLines | None = None
        self._held = ExitStack()
        if not overwrite:
            _refuse_killed(folder)
        self._held.enter_context(prepared(folder, overwrite))
        with self._writing():
            self._discard()
            for name in (*FILES, *LOG_FILES):
                (folder / name).unlink(missing_ok=True)
            shutil.rmtree(folder / FRAMES, ignore_errors=True)
            self._parts.mkdir()
            part = self._parts / "scene.toml"
            part.write_text(scene_text(scene), encoding="utf-8")
            part.replace(folder / part.name)
            self._lines = TraceLines(self._parts / LINES, Rows(scene).columns)
            if drawn:
                self._video = _open_video(self._parts, scene)
            if frames is not None:
                for name in prefixes(scene):
                    place = self._parts / FRAMES / name.removesuffix("_")
                    place.parent.mkdir(exist_ok=True)
                    self._frames.append(FrameFiles(place, frames, scene.camera.rate_hz))

    def __enter__(self) -> Self:
        """Use as a context, which removes unfinished files."""
        return self

    def __exit__(self, *_: object) -> None:
        """Remove unfinished files."""
        self._drop()

    def add(self, line: Sequence[float], sample: Sample, rig: Rig | None) -> None:
        """Keep a line of the trace, and pictures.

        Parameters
        ----------
        line: line of the trace
        sample: sample of the same frame; the video shows it if its next picture is due
        rig: rig at that frame; None for a run without pictures
        """
        if self._lines is None:  # writing failed
            return
        with self._writing():
            self._lines.add(line)
        video = self._video if self._video is not None and self._video.due(sample) else None
        frames = self._frames if sample.readings[0].observation is not None else []
        if rig is None or not (video or frames):
            return
        pictures = rig.pictures()
        with self._writing():
            if frames and sample.index == 0:
                for file, still in zip(frames, rig.rest_pictures(), strict=True):
                    file.add_rest(still)
            for file, picture in zip(frames, pictures, strict=False):
                file.add(sample.index, picture)
            if video is not None:
                video.show(sample, pictures)

    def write(
        self, trace: Trace, summary: Summary, scene: Scene | None = None, said: str = ""
    ) -> None:
        """Write the results, and give all files their names.

        Parameters
        ----------
        trace, summary: results of the run
        scene: scene that is known only at the end; its files are named relative to the folder
        said: line about the scene, for its file
        """
        if self._lines is None:  # writing failed before
            return
        with self._writing():
            if scene is not None:
                self._scene = scene
                text = scene_text(scene, said, self.folder)
                (self._parts / "scene.toml").write_text(text, encoding="utf-8")
            for file in (self._video, *self._frames):
                if file is not None:
                    file.close()
            _write_results(self._parts, self._scene, trace, summary, self._drawn)
            self._lines.drop()
            parts = sorted(self._parts.iterdir())
            for part in parts:  # complete files must outlast a power cut
                sync(part)
            for part in parts:
                part.replace(self.folder / part.name)
            sync(self.folder)
        # Last, from the finished folder: a log that cannot be written costs no run.
        _write_run_logs(self.folder, self._scene, trace, summary, self._log)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except UserError:  # of the video
            self._drop()
            raise
        except OSError as error:
            self._drop()
            reason = error.strerror or error
            raise UserError(f"folder {self.folder} cannot be written: {reason}") from None

    def _drop(self) -> None:
        """Remove unfinished files, and the folder if it has no others."""
        self._discard()
        self._held.close()
        leave(self.folder, "scene.toml")

    def _discard(self) -> None:
        """Close and remove unfinished files."""
        unfinished = (self._video, *self._frames, self._lines)
        self._video, self._frames, self._lines = None, [], None
        for file in unfinished:
            if file is not None:
                with suppress(OSError, UserError):
                    file.close()
        shutil.rmtree(self._parts, ignore_errors=True)


def _refuse_killed(folder: Path) -> None:
    """Refuse the folder of a run that was killed, and name the file of its trace."""
    lines = folder / PARTS / LINES
    if lines.is_file():
        with filling(folder):  # a run that still goes on is refused first
            raise UserError(
                f"folder {folder} holds a run that was killed; its trace until then is {lines}; "
                "choose another folder or give --overwrite"
            )


def _open_video(folder: Path, scene: Scene) -> "TactileVideo | PinchVideo":
    from .pinch.video import PinchVideo
    from .results.tactile_video import TactileVideo

    kinds: dict[int, type[TactileVideo | PinchVideo]] = {1: TactileVideo, 2: PinchVideo}
    return kinds[scene.fingers](folder / VIDEO, scene)


def _write_results(folder: Path, scene: Scene, trace: Trace, summary: Summary, drawn: bool) -> None:
    from .results.figure import draw_figure
    from .results.report import write_report
    from .results.run_folder import RunRead

    write_trace(folder / TRACE, trace.columns, Rows(scene).columns)
    if drawn:
        draw_figure(scene, trace, folder / "figure.png")
    text = json.dumps({**summary, "versions": versions()}, indent=2)
    (folder / "summary.json").write_text(text + "\n", encoding="utf-8")
    read = RunRead(folder=folder, scene=scene, summary=summary, columns=trace.columns)
    write_report(read)


def _write_run_logs(
    folder: Path, scene: Scene, trace: Trace, summary: Summary, formats: Sequence[LogFormat]
) -> None:
    """Write the logs of a run into its folder, which has all other files."""
    if formats:
        from .results.log import log_of
        from .results.run_folder import RunRead

        read = RunRead(folder=folder, scene=scene, summary=summary, columns=trace.columns)
        write_logs(log_of(read), folder, formats)


def scene_text(
    scene: Scene,
    said: str = "Everything this run was made from; run it again with --scene.",
    folder: Path | None = None,
) -> str:
    """Write a scene as TOML, after a line about it and the versions; see `dump_scene`."""
    listed = ", ".join(f"{name} {number}" for name, number in versions().items())
    return f"# {said}\n# {listed}\n" + dump_scene(scene, folder)
