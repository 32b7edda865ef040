"""Running a scene: in memory, or into a run folder that an interruption leaves readable.

What only a folder needs (FFmpeg, Arrow, matplotlib) is imported where one is written.
"""

import json
import time
from array import array
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
from threadpoolctl import threadpool_limits

from ..errors import UserError
from ..extras import need, require
from ..output.folder import prepare
from ..output.versions import versions
from ..scene.scene import Scene, dump_scene, load_scene
from ..tracking import check_reconstructor
from .camera import SimulatedCamera
from .grasp import grasp, known_sensor, open_camera
from .trace import COLUMNS, Trace, make_trace, row, summarise

if TYPE_CHECKING:
    from .tactile_video import TactileVideo

#: What a run folder holds.
FILES = ("summary.json", "trace.parquet", "figure.png", "tactile.mp4", "scene.toml")

#: Told after each frame: frames done and frames in all.
Progress = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class Result:
    """What a run left.

    Attributes
    ----------
    scene: that was run
    summary: see `trace.summarise`
    trace: time series, truth beside estimate
    folder: where the files are; None when nothing was written
    """

    scene: Scene
    summary: dict[str, Any]
    trace: Trace
    folder: Path | None


def run(
    scene: Scene | str,
    out: Path | str | None = None,
    *,
    force: bool = False,
    progress: Progress | None = None,
) -> Result:
    """Run a scene; with `out`, leave summary, trace, figure, video and scene in that folder.

    Interrupted by Ctrl-C it keeps what it had, marked as not complete, and raises
    KeyboardInterrupt.

    Parameters
    ----------
    scene: a Scene, or what `load_scene` takes
    out: run folder, made if missing
    force: write into a folder that is not empty, over an earlier run's files
    progress: called after every frame

    Raises
    ------
    UserError
        For a scene, a folder or a renderer that will not do.
    """
    if isinstance(scene, str):
        scene = load_scene(scene)
    scene.build_controller()  # refuses one that is not there before there is a folder
    if scene.path == "camera" and not scene.build_sensor().shape.flat:
        check_reconstructor(scene.reconstructor, known_sensor(scene))
    if out is not None:
        require("data", "video", purpose="writing a run folder")
    with closing(open_camera(scene)) as camera, threadpool_limits(1):
        # One thread: frames are small, and runs are made side by side.
        cv2.setNumThreads(1)
        folder = None if out is None else _open_folder(Path(out), force, scene)
        return _record(scene, camera, folder, progress)


def _record(
    scene: Scene, camera: SimulatedCamera, folder: Path | None, progress: Progress | None
) -> Result:
    """Run the loop; write video while it runs and results however it ends."""
    rows = array("d")
    seconds, shown = 0.0, -1
    video: TactileVideo | None = None
    try:
        with ExitStack() as files:
            if folder is not None:
                video = files.enter_context(_open_video(folder, scene))
            samples = grasp(scene, camera)
            while True:
                begin = time.perf_counter()
                sample = next(samples, None)
                if rows:  # the first one reads the frames of rest, too
                    seconds += time.perf_counter() - begin
                if sample is None:
                    break
                rows.extend(row(sample))
                slot = 0 if video is None else video.slot(sample.state.time)
                if video is not None and slot > shown and sample.observation is not None:
                    shown = slot
                    frame = sample.frame or camera.expose(sample.state, sample.index)
                    video.add(frame.image, sample)
                if progress is not None:
                    progress(len(rows) // len(COLUMNS), scene.frames)
    finally:
        # Also after Ctrl-C or a failing controller: what was seen up to there is kept.
        trace = make_trace(rows)
        summary = summarise(scene, trace, seconds)
        if folder is not None and rows:
            _write_results(folder, scene, trace, summary)
    return Result(scene=scene, summary=summary, trace=trace, folder=folder)


def _open_video(folder: Path, scene: Scene) -> "TactileVideo":
    from .tactile_video import TactileVideo

    return TactileVideo(folder / "tactile.mp4", scene.build_sensor())


def _open_folder(folder: Path, force: bool, scene: Scene) -> Path:
    """Run folder with its scene in it, and without an earlier run's files."""
    prepare(folder, force)
    try:
        for name in FILES:
            (folder / name).unlink(missing_ok=True)
        (folder / "scene.toml").write_text(scene_text(scene), encoding="utf-8")
    except OSError as error:
        raise UserError(f"folder {folder} cannot be written: {error.strerror}") from None
    return folder


def _write_results(folder: Path, scene: Scene, trace: Trace, summary: dict[str, Any]) -> None:
    from .figure import draw_figure

    pa, pq = need("pyarrow", "data"), need("pyarrow.parquet", "data")
    table = pa.table({name: pa.array(column) for name, column in trace.columns.items()})
    meaning = {name: text.encode() for name, text in COLUMNS.items()}
    pq.write_table(table.replace_schema_metadata(meaning), folder / "trace.parquet")
    draw_figure(scene, trace, folder / "figure.png")
    text = json.dumps({**summary, "versions": versions()}, indent=2)
    (folder / "summary.json").write_text(text + "\n", encoding="utf-8")


def scene_text(scene: Scene) -> str:
    """TOML of a scene with the versions that it was run with."""
    listed = ", ".join(f"{name} {number}" for name, number in versions().items())
    return (
        f"# Everything this run was made from; run it again with --scene.\n# {listed}\n"
        + dump_scene(scene)
    )
