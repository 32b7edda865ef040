"""Running a scene of two fingers: in memory, or into a run folder."""

import json
import math
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ..by_name import Choice
from ..control import Controller
from ..errors import UserError
from ..extras import need, require
from ..loop.latency import HoldingController
from ..loop.methods import choose
from ..loop.run_folder import ANSWER_WITHIN_S, scene_text
from ..loop.trace import Summary, Trace
from ..output.folder import prepare
from ..output.processes import one_thread
from ..output.versions import versions
from ..scene.controllers import CONTROLLERS
from ..scene.scene import Scene, load_scene
from .pinch_rig import PinchRig, PinchSample
from .pinch_trace import COLUMNS, Rows, summarise

#: Files of a run folder.
FILES = ("summary.json", "trace.parquet", "figure.png", "scene.toml")

#: Called after each frame with the frames done and all frames.
Progress = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class PinchResult:
    """Results of a pinch.

    Attributes
    ----------
    scene: that was run, with the names of the methods that were used
    summary: see `pinch_trace.summarise`
    trace: time series, truth beside both estimates
    folder: where the files are; None when nothing was written
    """

    scene: Scene
    summary: Summary
    trace: Trace
    folder: Path | None


def run_pinch(
    scene: Scene | str,
    out: Path | str | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    controller: Choice | Controller | None = None,
    tracker: Choice | None = None,
    reconstructor: Choice | None = None,
    renderer: Choice | None = None,
    answer_within_s: float = ANSWER_WITHIN_S,
) -> PinchResult:
    """Run a scene of two fingers; with `out`, write summary, trace, figure and scene there.

    After Ctrl-C or an error of a controller the results up to there are written, marked as not
    complete, and the exception is raised.

    Parameters
    ----------
    scene: a Scene, or a name or file as in `load_scene`
    out: run folder, made if missing
    overwrite: write into a folder that is not empty, over an earlier run's files
    progress: called after every frame
    controller, tracker, reconstructor, renderer, answer_within_s: as in `loop.run_folder.run`

    Raises
    ------
    UserError
        For a scene, a method or a folder that cannot be used; when the silicone cannot go on.
    """
    if isinstance(scene, str):
        scene = load_scene(scene)
    scene, methods = choose(
        scene,
        controller=controller,
        tracker=tracker,
        reconstructor=reconstructor,
        renderer=renderer,
    )
    limit = math.inf if scene.controller in CONTROLLERS.entries else answer_within_s
    held = HoldingController(methods.build_controller(scene), scene.controller, limit)
    rig = PinchRig(scene, methods)
    folder = None if out is None else Path(out)
    if folder is not None:
        require("data", purpose="writing a run folder")
        prepare(folder, overwrite)
    return _record(rig, held, folder, progress)


def _record(
    rig: PinchRig, held: HoldingController, folder: Path | None, progress: Progress | None
) -> PinchResult:
    """Run the loop, and write its results however it ends."""
    scene = rig.scene
    rows, reasons, seconds = Rows(scene), list[str](), 0.0
    try:
        with one_thread():
            held.start(rig.reset())
            begin = time.perf_counter()
            while True:
                grip = held.command(rig.arrived)
                sample = rig.sample(grip)
                rows.add(sample)
                reasons.extend(_reasons(sample))
                seconds = time.perf_counter() - begin
                if progress is not None:
                    progress(len(rows), scene.frames)
                if rig.done:
                    break
                rig.step(grip)
    finally:
        rig.close()
        trace = rows.trace()
        summary = summarise(scene, trace, seconds, reasons)
        if folder is not None and len(rows):
            write(folder, scene, trace, summary)
    return PinchResult(scene=scene, summary=summary, trace=trace, folder=folder)


def _reasons(sample: PinchSample) -> list[str]:
    seen = [reading.observation for reading in sample.readings]
    return [each.no_estimate for each in seen if each is not None and each.no_estimate]


def write(folder: Path, scene: Scene, trace: Trace, summary: Summary) -> None:
    """Write the files of a run folder, which get their names together.

    Raises
    ------
    UserError
        When the folder cannot be written.
    """
    pa, pq = need("pyarrow", "data"), need("pyarrow.parquet", "data")

    from .pinch_figure import draw_figure

    parts = folder / ".parts"
    try:
        for name in FILES:
            (folder / name).unlink(missing_ok=True)
        parts.mkdir(exist_ok=True)
        (parts / "scene.toml").write_text(scene_text(scene), encoding="utf-8")
        table = pa.table({name: pa.array(trace[name]) for name in COLUMNS})
        meaning = {name: words.encode() for name, words in COLUMNS.items()}
        pq.write_table(table.replace_schema_metadata(meaning), parts / "trace.parquet")
        draw_figure(scene, trace, parts / "figure.png")
        text = json.dumps({**summary, "versions": versions()}, indent=2)
        (parts / "summary.json").write_text(text + "\n", encoding="utf-8")
        for part in sorted(parts.iterdir()):
            part.replace(folder / part.name)
    except OSError as error:
        reason = error.strerror or error
        raise UserError(f"folder {folder} cannot be written: {reason}") from None
    finally:
        with suppress(OSError):
            shutil.rmtree(parts)
