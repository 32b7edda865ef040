"""Running the grip loop on frames from outside, into a run folder without a truth."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, nullcontext
from pathlib import Path
from typing import Any

from ..by_name import Choice, name_of
from ..errors import UserError
from ..loop.methods import Methods, choose
from ..loop.record import Record, Result
from ..loop.rig import readable
from ..loop.run import ANSWER_WITHIN_S, check_asked
from ..loop.run_files import RunFiles
from ..output.logs.write import LogFormat
from ..output.pictures import open_source
from ..output.processes import one_thread
from ..scene.controllers import CONTROLLERS
from ..scene.scene import Scene
from ..tracking import SensorCalibration
from .feed import Feed
from .gripper import GRIPPERS, Gripper, HeldGripper
from .outside import grasp_outside

#: Time in which the next frame must come [s].
FRAME_WITHIN_S = 5.0


def run_outside(
    scene: Scene,
    source: str,
    out: Path | None = None,
    *,
    gripper: Choice | Gripper = "simulated",
    gripper_arguments: Mapping[str, Any] | None = None,
    overwrite: bool = False,
    fps: float | None = None,
    frame_within_s: float = FRAME_WITHIN_S,
    log: Sequence[LogFormat] = (),
    answer_within_s: float = ANSWER_WITHIN_S,
    progress: Callable[[int, int | None], None] = lambda done, total: None,
) -> Result:
    """Run a scene's controller on frames from outside; with `out`, write trace and summary.

    However it ends, the results up to there are written, and the grip stays.

    Parameters
    ----------
    scene: controller, sensor, calibration and length of the run
    source: camera, folder, video or pipe, see `open_source`
    out: run folder, made if missing
    gripper: a name, `module:Class`, class, or an object with `command`
    gripper_arguments: of a class, by name
    overwrite: write over an earlier run's files
    fps: rate of frames without times of their own [Hz]
    frame_within_s, answer_within_s: times in which the next frame must come, and controller and
        gripper must answer
    log: formats in which the run is also written into `out`, see `loop.run.run`
    progress: called with the number of frames done, and None

    Raises
    ------
    UserError
        For what cannot be used, and when source, controller or gripper fail.
    """
    scene, methods, known = _checked(scene)
    check_asked(out, None, log, answer_within_s)
    opened = open_source(source, fps)
    made = GRIPPERS.build(gripper, gripper_arguments)
    held = HeldGripper(made, name_of(gripper), answer_within_s)
    limit = math.inf if scene.controller in CONTROLLERS.entries else answer_within_s
    files = None if out is None else RunFiles(out, overwrite, scene, log=log, drawn=False)
    with files or nullcontext(), one_thread(), closing(Feed(opened, frame_within_s)) as feed:
        record, ended = Record(scene, methods, known, files), False
        try:
            for sample in grasp_outside(scene, methods, known, feed, held, limit):
                record.add(sample)
                progress(sample.index + 1, None)
            ended = True
        finally:
            result = record.finish(
                complete=ended,
                gross_slip=None,
                frames_skipped=feed.skipped,
                source=source,
                gripper=name_of(gripper),
            )
    return result


def _checked(scene: Scene) -> tuple[Scene, Methods, SensorCalibration]:
    """Scene, methods and calibration of a loop on frames from outside."""
    if scene.pinch.mass_g:
        raise UserError("frames from outside are those of one finger; this scene is a pinch of two")
    if scene.path != "camera":
        raise UserError('frames from outside are read by the camera path; set path = "camera"')
    scene, methods = choose(scene)
    known = readable(scene, methods)
    if known is None:
        raise UserError(f"sensor {scene.sensor} is a flat pad; no estimator reads forces off it")
    return scene, methods, known
