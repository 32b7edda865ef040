"""Running a scene: in memory, or into a run folder that an interruption leaves readable.

Packages that only a folder needs (FFmpeg, Arrow, matplotlib) are imported where one is written.
"""

import json
import shutil
import time
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

from ..by_name import Choice
from ..control import Controller
from ..errors import UserError
from ..extras import need, require
from ..output.folder import leave, prepare
from ..output.frames import FRAMES, FrameFiles, FrameFormat
from ..output.logs.write import LOG_FILES, LogFormat, require_logs, write_logs
from ..output.processes import one_thread
from ..output.versions import versions
from ..scene.scene import Scene, dump_scene, load_scene
from ..tracking import SensorCalibration, Tracks
from ..tracking.forces import CameraPose, rest_pose
from ..tracking.forces.chain import used
from .columns import FINGERS, Rows
from .grasp import gripped
from .methods import choose
from .rig import Rig
from .sample import Sample
from .trace import Summary, Trace, TraceLines, make_trace, summarise

if TYPE_CHECKING:
    from .pinch.video import PinchVideo
    from .shown.tactile_video import TactileVideo

#: Files of a run folder.
FILES = (
    "summary.json",
    "trace.parquet",
    "figure.png",
    "tactile.mp4",
    "scene.toml",
    "report.html",
)
#: Folder of unfinished files in it.
PARTS = ".parts"
#: Lines of the trace until now, in `PARTS`, for a run that is killed.
LINES = "trace.csv"
#: Time in which a controller that is not ours must answer [s].
ANSWER_WITHIN_S = 60.0

#: Called after each frame with the frames done and all frames.
Progress = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class Result:
    """Results of a run.

    Attributes
    ----------
    scene: that was run, with the names of the methods that were used
    summary: see `trace.summarise`
    trace: time series, truth beside estimate
    folder: where the files are; None when nothing was written
    """

    scene: Scene
    summary: Summary
    trace: Trace
    folder: Path | None


def run(
    scene: Scene | str,
    out: Path | str | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    controller: Choice | Controller | None = None,
    tracker: Choice | None = None,
    reconstructor: Choice | None = None,
    renderer: Choice | None = None,
    frames: FrameFormat | None = None,
    log: Sequence[LogFormat] = (),
    answer_within_s: float = ANSWER_WITHIN_S,
) -> Result:
    """Run a scene; with `out`, write summary, trace, figure, video and scene into that folder.

    After Ctrl-C or an error of a controller the results up to there are written, marked as not
    complete, and the exception is raised.

    Parameters
    ----------
    scene: a Scene, or a name or file as in `load_scene`
    out: run folder, made if missing
    overwrite: write into a folder that is not empty, over an earlier run's files
    progress: called after every frame with the frames done and all frames
    controller: in place of the scene's: an object with `reset` and `command`, a class or other
        factory without arguments, or a name
    tracker, reconstructor, renderer: in place of the scene's: a class or other factory, or a name
    frames: keep the camera's raw pictures too, in the folder `frames` of `out`; of two fingers in
        its folders `first` and `second`
    log: formats in which the run is also written into `out`, for other tools: `mcap`, `rerun`
    answer_within_s: time in which a controller that is not ours must answer; inf is no limit

    Returns
    -------
    Results; those of two fingers have the summary and the trace of a pinch.

    Raises
    ------
    UserError
        For a scene, a method, a folder or a renderer that cannot be used.
    """
    within = check_asked(out, frames, log, answer_within_s)
    if isinstance(scene, str):
        scene = load_scene(scene)
    scene, methods = choose(
        scene,
        controller=controller,
        tracker=tracker,
        reconstructor=reconstructor,
        renderer=renderer,
    )
    methods.build_controller(scene)  # a controller that cannot be made leaves no folder
    rig = Rig(scene, methods)
    if out is not None:
        rig.open()  # a renderer that cannot run leaves no folder
    files = None if out is None else RunFiles(Path(out), overwrite, scene, frames, log)
    with files or nullcontext(), closing(rig), one_thread():
        return _record(rig, files, progress, within)


def _record(rig: Rig, files: "RunFiles | None", progress: Progress | None, within: float) -> Result:
    """Run the loop, and write its results however it ends."""
    scene, lines, seconds = rig.scene, rows_of(rig.scene), 0.0
    rows, reasons = array("d"), list[str]()
    rest: Tracks | None = None
    samples = gripped(rig, within)
    try:
        while True:
            begin = time.perf_counter()
            sample = next(samples, None)
            if rows:  # the first sample includes the frames at rest
                seconds += time.perf_counter() - begin
            if sample is None:
                break
            rest = sample.readings[0].rest
            reasons += sample.reasons
            line = lines.line(sample)
            rows.extend(line)
            if files is not None:
                files.keep(line)
                files.show(sample, rig)
            if progress is not None:
                progress(sample.index + 1, scene.frames)
    finally:
        trace = make_trace(rows, lines.columns)
        summary = _summary(rig, trace, seconds, rest, reasons)
        if files is not None and rows:
            files.write(trace, summary)
    folder = None if files is None else files.folder
    return Result(scene=scene, summary=summary, trace=trace, folder=folder)


def rows_of(scene: Scene) -> Rows:
    """What makes the lines of a scene's trace."""
    return Rows(scene)


def _summary(
    rig: Rig, trace: Trace, seconds: float, rest: Tracks | None, reasons: list[str]
) -> Summary:
    known = rig.known[0]
    read_with = None if known is None else used(rig.methods.reconstructor, known)
    return summarise(rig.scene, trace, seconds, read_with, pose_at_rest(known, rest), reasons)


def check_asked(
    out: Path | str | None,
    frames: FrameFormat | None,
    log: Sequence[LogFormat],
    answer_within_s: float,
) -> float:
    """Refuse what no run can do; the time in which a controller must answer [s]."""
    if frames is not None and out is None:
        raise UserError(f"pictures as {frames} need a folder: give `out`")
    if log and out is None:
        raise UserError(f"a log as {log[0]} needs a folder: give `out`")
    require_logs(log)
    if not answer_within_s > 0.0:
        raise UserError(f"answer_within_s = {answer_within_s} must be above 0; inf is no limit")
    return answer_within_s


def pose_at_rest(known: SensorCalibration | None, rest: Tracks | None) -> CameraPose | None:
    """Pose of the camera; None on the truth path, and where a plug-in's tracks do not tell it."""
    if known is not None and rest is not None:
        with suppress(UserError):
            return rest_pose(known.sensor, rest)
    return None


class RunFiles:
    """Files of a run, which get their final names together, once all are written.

    Until then they lie in a folder inside the run folder, with the lines of the trace as text: a
    run that is killed leaves them. A disk that fills leaves nothing but the scene.

    Parameters
    ----------
    folder: run folder, made if missing
    overwrite: remove an earlier run's files
    scene: that is run
    frames: how the camera's pictures are kept; None does not keep them
    log: formats of the logs that are written after the other files
    """

    def __init__(
        self,
        folder: Path,
        overwrite: bool,
        scene: Scene,
        frames: FrameFormat | None = None,
        log: Sequence[LogFormat] = (),
    ) -> None:
        require("data", "video", purpose="writing a run folder")
        self.folder = folder
        self._parts = folder / PARTS
        self._scene, self._log = scene, log
        self._video: TactileVideo | PinchVideo | None = None
        self._frames: list[FrameFiles] = []
        self._lines: TraceLines | None = None
        refuse_killed(folder, overwrite)
        prepare(folder, overwrite)
        with self._writing():
            self._discard()
            for name in (*FILES, *LOG_FILES):
                (folder / name).unlink(missing_ok=True)
            shutil.rmtree(folder / FRAMES, ignore_errors=True)
            self._parts.mkdir()
            part = self._parts / "scene.toml"
            part.write_text(scene_text(scene), encoding="utf-8")
            part.replace(folder / part.name)
            self._lines = TraceLines(self._parts / LINES, rows_of(scene).columns)
            self._video = _open_video(self._parts, scene)
            if frames is not None:
                place = self._parts / FRAMES
                places = [place / name for name in FINGERS] if scene.pinch.mass_g else [place]
                for place in places:
                    place.parent.mkdir(exist_ok=True)
                    self._frames.append(FrameFiles(place, frames, scene.camera.rate_hz))

    def __enter__(self) -> Self:
        """Use as a context, which removes unfinished files."""
        return self

    def __exit__(self, *_: object) -> None:
        """Remove unfinished files."""
        self._drop()

    def keep(self, line: Sequence[float]) -> None:
        """Append a line of the trace to what a kill leaves."""
        if self._lines is not None:
            with self._writing():
                self._lines.add(line)

    def show(self, sample: Sample, rig: Rig) -> None:
        """Append a sample to the video, when its next picture is due, and keep its pictures."""
        if self._video is None:  # writing failed
            return
        due = self._video.due(sample)
        came = bool(self._frames) and sample.readings[0].observation is not None
        if not (due or came):
            return
        pictures = rig.pictures()
        with self._writing():
            if came and sample.index == 0:
                for file, still in zip(self._frames, rig.rest_pictures(), strict=True):
                    file.add_rest(still)
            for file, picture in zip(self._frames if came else (), pictures, strict=came):
                file.add(sample.index, picture)
            if due:
                self._video.show(sample, pictures)

    def write(
        self, trace: Trace, summary: Summary, scene: Scene | None = None, said: str = ""
    ) -> None:
        """Write the results, and give all files their names.

        Parameters
        ----------
        trace, summary: of the run
        scene: where it is known at the end only; its files are named relative to the folder
        said: a line about it
        """
        if self._video is None:  # writing failed before
            return
        with self._writing():
            if scene is not None:
                self._scene = scene
                text = scene_text(scene, said, self.folder)
                (self._parts / "scene.toml").write_text(text, encoding="utf-8")
            self._video.close()
            for file in self._frames:
                file.close()
            _write_results(self._parts, self._scene, trace, summary)
            if self._lines is not None:
                self._lines.drop()
            for part in sorted(self._parts.iterdir()):
                part.replace(self.folder / part.name)
        # Last, from the finished folder: a log that cannot be written costs no run.
        write_run_logs(self.folder, self._scene, trace, summary, self._log)

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
        """Remove unfinished files, and the folder where there are no others."""
        self._discard()
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


def refuse_killed(folder: Path, overwrite: bool) -> None:
    """Refuse a folder of a run that was killed, and say where its trace is."""
    lines = folder / PARTS / LINES
    if not overwrite and lines.is_file():
        raise UserError(
            f"folder {folder} holds a run that was killed; its trace until then is {lines}; "
            "choose another folder or give --overwrite"
        )


def _open_video(folder: Path, scene: Scene) -> "TactileVideo | PinchVideo":
    from .pinch.video import PinchVideo
    from .shown.tactile_video import TactileVideo

    return (PinchVideo if scene.pinch.mass_g else TactileVideo)(folder / "tactile.mp4", scene)


def _write_results(folder: Path, scene: Scene, trace: Trace, summary: Summary) -> None:
    from .shown import figure
    from .shown.report import RunRead, write_report

    write_trace(scene, trace, folder / "trace.parquet")
    figure.draw_figure(scene, trace, folder / "figure.png")
    text = json.dumps({**summary, "versions": versions()}, indent=2)
    (folder / "summary.json").write_text(text + "\n", encoding="utf-8")
    read = RunRead(folder=folder, scene=scene, summary=summary, columns=trace.columns)
    write_report(read)


def write_run_logs(
    folder: Path, scene: Scene, trace: Trace, summary: Summary, formats: Sequence[LogFormat]
) -> None:
    """Write the logs of a run into its folder, which has all other files."""
    if formats:
        from .shown.log import log_of
        from .shown.report import RunRead

        read = RunRead(folder=folder, scene=scene, summary=summary, columns=trace.columns)
        write_logs(log_of(read), folder, formats)


def write_trace(scene: Scene, trace: Trace, path: Path) -> None:
    """Write a trace as a Parquet table, which holds the meaning of its columns."""
    pa = need("pyarrow", "data")
    pq = need("pyarrow.parquet", "data")
    rows = rows_of(scene)
    table = pa.table({name: pa.array(trace[name]) for name in rows.names})
    meaning = {name: rows.columns[name].encode() for name in rows.names}
    pq.write_table(table.replace_schema_metadata(meaning), path)


def scene_text(
    scene: Scene,
    said: str = "Everything this run was made from; run it again with --scene.",
    folder: Path | None = None,
) -> str:
    """TOML of a scene with a line about it, and the versions; files are relative to `folder`."""
    listed = ", ".join(f"{name} {number}" for name, number in versions().items())
    return f"# {said}\n# {listed}\n" + dump_scene(scene, folder)
