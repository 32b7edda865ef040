"""Running a scene: in memory, or into a run folder that an interruption leaves readable.

Packages that only a folder needs (FFmpeg, Arrow, matplotlib) are imported where one is written.
"""

import json
import shutil
import time
from array import array
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

from ..by_name import Choice
from ..control import Controller
from ..errors import UserError
from ..extras import need, require
from ..output.folder import prepare
from ..output.frames import FrameFiles, FrameFormat
from ..output.processes import one_thread
from ..output.versions import versions
from ..scene.scene import Scene, dump_scene, load_scene
from ..tracking import SensorCalibration, Tracks
from ..tracking.forces import CameraPose, rest_pose
from ..tracking.forces.chain import Used, used
from .camera import SimulatedCamera, open_camera
from .grasp import grasp
from .methods import Methods, choose
from .rig import Sample, readable
from .trace import COLUMNS, Summary, Trace, columns_of, make_trace, row, summarise

if TYPE_CHECKING:
    from .tactile_video import TactileVideo

#: Files of a run folder.
FILES = ("summary.json", "trace.parquet", "figure.png", "tactile.mp4", "scene.toml")
#: Folder of the camera's raw pictures in it, where they were asked for.
FRAMES = "frames"

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
) -> Result:
    """Run a scene; with `out`, write summary, trace, figure, video and scene into that folder.

    After Ctrl-C or an error of a controller the results up to there are written, marked as not
    complete, and the exception is raised.

    Parameters
    ----------
    scene: a Scene, or a name or file as in `load_scene`
    out: run folder, made if missing
    overwrite: write into a folder that is not empty, over an earlier run's files
    progress: called after every frame
    controller: in place of the scene's: an object with `reset` and `command`, a class or other
        factory without arguments, or a name
    tracker, reconstructor, renderer: in place of the scene's: a class or other factory, or a name
    frames: keep the camera's raw pictures too, in the folder `frames` of `out`

    Raises
    ------
    UserError
        For a scene, a method, a folder or a renderer that cannot be used.
    """
    if frames is not None and out is None:
        raise UserError(f"pictures as {frames} need a folder: give `out`")
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
    known = readable(scene, methods)
    read_with = None if known is None else used(methods.reconstructor, known)
    if out is not None:
        require("data", "video", purpose="writing a run folder")
    with ExitStack() as stack, one_thread():
        camera = None
        if scene.path == "camera" or scene.body == "chain" or out is not None:
            camera = stack.enter_context(closing(open_camera(scene, methods)))
        if out is None:
            return _record(scene, methods, camera, known, read_with, None, progress)
        with RunFiles(Path(out), overwrite, scene, frames) as files:
            return _record(scene, methods, camera, known, read_with, files, progress)


def _record(
    scene: Scene,
    methods: Methods,
    camera: SimulatedCamera | None,
    known: SensorCalibration | None,
    read_with: Used | None,
    files: "RunFiles | None",
    progress: Progress | None,
) -> Result:
    """Run the loop, and write its results however it ends."""
    rows = array("d")
    samples = grasp(scene, camera, known=known, methods=methods)
    seconds = 0.0
    rest: Tracks | None = None
    reasons: list[str] = []
    try:
        while True:
            begin = time.perf_counter()
            sample = next(samples, None)
            if rows:  # the first sample includes the frames at rest
                seconds += time.perf_counter() - begin
            if sample is None:
                break
            rest = sample.rest
            if sample.observation is not None and sample.observation.no_estimate:
                reasons.append(sample.observation.no_estimate)
            rows.extend(row(sample))
            if files is not None:
                files.show(sample, camera)
            if progress is not None:
                progress(len(rows) // len(COLUMNS), scene.frames)
    finally:
        trace = make_trace(rows)
        summary = summarise(scene, trace, seconds, read_with, _pose(known, rest), reasons)
        if files is not None and rows:
            files.write(trace, summary)
    folder = None if files is None else files.folder
    return Result(scene=scene, summary=summary, trace=trace, folder=folder)


def _pose(known: SensorCalibration | None, rest: Tracks | None) -> CameraPose | None:
    """Pose of the camera; None on the truth path, and where a plug-in's tracks do not tell it."""
    if known is not None and rest is not None:
        with suppress(UserError):
            return rest_pose(known.sensor, rest)
    return None


class RunFiles:
    """Files of a run, which get their final names together, once all are written.

    Until then they lie in a folder inside the run folder. A disk that fills leaves nothing but the
    scene.

    Parameters
    ----------
    folder: run folder, made if missing
    overwrite: remove an earlier run's files
    scene: that is run
    frames: how the camera's pictures are kept; None does not keep them
    """

    def __init__(
        self, folder: Path, overwrite: bool, scene: Scene, frames: FrameFormat | None = None
    ) -> None:
        self.folder = folder
        self._parts = folder / ".parts"
        self._scene = scene
        self._video: TactileVideo | None = None
        self._frames: FrameFiles | None = None
        self._slot = -1
        prepare(folder, overwrite)
        with self._writing():
            self._discard()
            for name in FILES:
                (folder / name).unlink(missing_ok=True)
            shutil.rmtree(folder / FRAMES, ignore_errors=True)
            self._parts.mkdir()
            part = self._parts / "scene.toml"
            part.write_text(scene_text(scene), encoding="utf-8")
            part.replace(folder / part.name)
            self._video = _open_video(self._parts, scene)
            if frames is not None:
                self._frames = FrameFiles(self._parts / FRAMES, frames, scene.camera.rate_hz)

    def __enter__(self) -> Self:
        """Use as a context, which removes unfinished files."""
        return self

    def __exit__(self, *_: object) -> None:
        """Remove unfinished files."""
        self._discard()

    def show(self, sample: Sample, camera: SimulatedCamera | None) -> None:
        """Append a sample to the video, when its next picture is due, and keep its picture."""
        if self._video is None or sample.observation is None:  # writing failed, or no picture came
            return
        slot = self._video.slot(sample.time)
        if slot <= self._slot and self._frames is None:
            return
        assert camera is not None  # a run with files has one
        frame = sample.frame or camera.expose(sample.truth.state, sample.index)
        with self._writing():
            if self._frames is not None:
                if sample.index == 0:
                    self._frames.add_rest(camera.expose_rest(sample.truth.state, 1)[0])
                self._frames.add(sample.index, frame)
            if slot > self._slot:
                self._slot = slot
                show = self._video.add_traction if self._on_dome else self._video.add
                show(frame.image, sample)

    @property
    def _on_dome(self) -> bool:
        return self._scene.body == "dome"

    def write(self, trace: Trace, summary: Summary) -> None:
        """Write the results, and give all files their names."""
        if self._video is None:  # writing failed before
            return
        with self._writing():
            self._video.close()
            if self._frames is not None:
                self._frames.close()
            _write_results(self._parts, self._scene, trace, summary)
            for part in sorted(self._parts.iterdir()):
                part.replace(self.folder / part.name)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except UserError:  # of the video
            self._discard()
            raise
        except OSError as error:
            self._discard()
            reason = error.strerror or error
            raise UserError(f"folder {self.folder} cannot be written: {reason}") from None

    def _discard(self) -> None:
        """Close and remove unfinished files."""
        unfinished = (self._video, self._frames)
        self._video = self._frames = None
        for file in unfinished:
            if file is not None:
                with suppress(OSError, UserError):
                    file.close()
        shutil.rmtree(self._parts, ignore_errors=True)


def _open_video(folder: Path, scene: Scene) -> "TactileVideo":
    from .tactile_video import TactileVideo

    return TactileVideo(folder / "tactile.mp4", scene)


def _write_results(folder: Path, scene: Scene, trace: Trace, summary: Summary) -> None:
    pa = need("pyarrow", "data")
    pq = need("pyarrow.parquet", "data")

    from .figure import draw_figure

    names = columns_of(scene.body)
    table = pa.table({name: pa.array(trace[name]) for name in names})
    meaning = {name: COLUMNS[name].encode() for name in names}
    pq.write_table(table.replace_schema_metadata(meaning), folder / "trace.parquet")
    draw_figure(scene, trace, folder / "figure.png")
    text = json.dumps({**summary, "versions": versions()}, indent=2)
    (folder / "summary.json").write_text(text + "\n", encoding="utf-8")


def scene_text(
    scene: Scene, said: str = "Everything this run was made from; run it again with --scene."
) -> str:
    """TOML of a scene with a line about it, and the versions that it was run with."""
    listed = ", ".join(f"{name} {number}" for name, number in versions().items())
    return f"# {said}\n# {listed}\n" + dump_scene(scene)
