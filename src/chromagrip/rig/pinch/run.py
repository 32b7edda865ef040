"""Running a scene of two fingers: in memory, or into a run folder."""

import math
import time
from collections.abc import Sequence
from pathlib import Path

from ...by_name import Choice
from ...control import Controller
from ...extras import require
from ...loop.latency import HoldingController
from ...loop.methods import choose
from ...loop.run_folder import ANSWER_WITHIN_S, Progress, Result, check_asked
from ...output.frames import FrameFormat
from ...output.logs.write import LogFormat
from ...output.processes import one_thread
from ...scene.controllers import CONTROLLERS
from ...scene.scene import Scene, load_scene
from .files import PinchFiles
from .rig import PinchRig, PinchSample
from .trace import Rows, summarise


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
    frames: FrameFormat | None = None,
    log: Sequence[LogFormat] = (),
    answer_within_s: float = ANSWER_WITHIN_S,
) -> Result:
    """Run a scene of two fingers; with `out`, write a run folder there.

    It has summary, trace, figure, video and scene.

    After Ctrl-C or an error of a controller the results up to there are written, marked as not
    complete, and the exception is raised.

    Parameters
    ----------
    scene: a Scene, or a name or file as in `load_scene`
    out: run folder, made if missing
    overwrite: write into a folder that is not empty, over an earlier run's files
    progress: called after every frame
    frames: keep both cameras' raw pictures too, in the folder `frames` of `out`
    controller, tracker, reconstructor, renderer, log, answer_within_s: as in `loop.run_folder.run`

    Raises
    ------
    UserError
        For a scene, a method or a folder that cannot be used; when the silicone cannot go on.
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
    limit = math.inf if scene.controller in CONTROLLERS.entries else within
    held = HoldingController(methods.build_controller(scene), scene.controller, limit)
    rig = PinchRig(scene, methods)
    if out is None:
        return _record(rig, held, None, progress)
    require("data", "video", purpose="writing a run folder")
    with one_thread(), PinchFiles(Path(out), overwrite, scene, frames, log) as files:
        return _record(rig, held, files, progress)


def _record(
    rig: PinchRig, held: HoldingController, files: PinchFiles | None, progress: Progress | None
) -> Result:
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
                seconds += time.perf_counter() - begin
                if files is not None:
                    files.show(sample, rig)
                begin = time.perf_counter()
                if progress is not None:
                    progress(len(rows), scene.frames)
                if rig.done:
                    break
                rig.step(grip)
    finally:
        rig.close()
        trace = rows.trace()
        summary = summarise(scene, trace, seconds, reasons)
        if files is not None and len(rows):
            files.write(trace, summary)
    folder = None if files is None else files.folder
    return Result(scene=scene, summary=summary, trace=trace, folder=folder)


def _reasons(sample: PinchSample) -> list[str]:
    seen = [reading.observation for reading in sample.readings]
    return [each.no_estimate for each in seen if each is not None and each.no_estimate]
