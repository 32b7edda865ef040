"""Running the grip loop on frames from outside, into a run folder without a truth."""

import json
import math
import shutil
import time
from array import array
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from ..by_name import Choice, name_of
from ..errors import UserError
from ..extras import require
from ..loop.columns import Rows
from ..loop.methods import Methods, choose
from ..loop.rig import readable
from ..loop.run_folder import (
    ANSWER_WITHIN_S,
    FILES,
    LINES,
    PARTS,
    Result,
    check_asked,
    refuse_killed,
    scene_text,
    write_run_logs,
    write_trace,
)
from ..loop.sample import Sample
from ..loop.trace import Summary, Trace, TraceLines, make_trace, summarise
from ..output.folder import disk_errors, prepare, whole_file
from ..output.frames import FRAMES
from ..output.logs.write import LOG_FILES, LogFormat
from ..output.pictures import open_source
from ..output.processes import one_thread
from ..output.versions import versions
from ..scene.controllers import CONTROLLERS
from ..scene.scene import Scene
from ..tracking import SensorCalibration
from ..tracking.forces.chain import used
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
    log: formats in which the run is also written into `out`, see `loop.run_folder.run`
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
    record = OutsideRecord(scene, methods, known, out, overwrite, log)
    with one_thread(), closing(Feed(opened, frame_within_s)) as feed:
        about, ended = {"source": source, "gripper": name_of(gripper)}, False
        try:
            for seen in grasp_outside(scene, methods, known, feed, held, limit):
                record.add(seen)
                progress(seen.index + 1, None)
            ended = True
        finally:
            result = record.finish(ended, feed.skipped, about)
    return result


def _checked(scene: Scene) -> tuple[Scene, Methods, SensorCalibration]:
    """Scene, methods and calibration of a loop on frames from outside."""
    if scene.path != "camera":
        raise UserError('frames from outside are read by the camera path; set path = "camera"')
    scene, methods = choose(scene)
    known = readable(scene, methods)
    if known is None:
        raise UserError(f"sensor {scene.sensor} is a flat pad; no estimator reads forces off it")
    return scene, methods, known


class OutsideRecord:
    """Trace of a loop on frames from outside, and its files, which are complete or have no name.

    Parameters
    ----------
    scene, methods, known: of the loop
    out: run folder; None writes nothing
    overwrite: remove an earlier run's files
    log: formats of the logs that are written after the other files
    """

    def __init__(
        self,
        scene: Scene,
        methods: Methods,
        known: SensorCalibration,
        out: Path | None,
        overwrite: bool,
        log: Sequence[LogFormat] = (),
    ) -> None:
        self._scene, self._out, self._log = scene, out, log
        self._used = used(methods.reconstructor, known)
        self._columns = Rows(scene)
        self._rows, self._reasons = array("d"), list[str]()
        self._lines: TraceLines | None = None
        self._begin = time.perf_counter()
        if out is not None:
            require("data", purpose="writing a run folder")
            refuse_killed(out, overwrite)
            prepare(out, overwrite)
            with disk_errors(out / PARTS):
                for name in (*FILES, *LOG_FILES):
                    (out / name).unlink(missing_ok=True)
                for name in (PARTS, FRAMES):
                    shutil.rmtree(out / name, ignore_errors=True)
                (out / "scene.toml").write_text(scene_text(scene), encoding="utf-8")
                (out / PARTS).mkdir()
                self._lines = TraceLines(out / PARTS / LINES)

    def add(self, seen: Sample) -> None:
        """Append a frame."""
        assert seen.observation is not None
        line = self._columns.line(seen)
        if not self._rows:  # the first frame includes those at rest
            self._begin = time.perf_counter()
        self._rows.extend(line)
        if seen.observation.no_estimate:
            self._reasons.append(seen.observation.no_estimate)
        if self._lines is not None:
            with disk_errors(Path(LINES)):
                self._lines.add(line)

    def finish(self, complete: bool, skipped: int, about: Mapping[str, str]) -> Result:
        """Write the results.

        Parameters
        ----------
        complete: whether the loop came to its end
        skipped: frames that the loop was too slow for
        about: further values of the summary
        """
        trace = make_trace(self._rows)
        seconds = time.perf_counter() - self._begin
        summary = summarise(self._scene, trace, seconds, self._used, None, self._reasons)
        summary |= {"complete": complete, "gross_slip": None, "frames_skipped": skipped, **about}
        if self._out is not None and self._lines is not None:
            self._lines.close()
            if self._rows:
                _write(self._out, self._scene, trace, summary)
            shutil.rmtree(self._out / PARTS, ignore_errors=True)
            if self._rows:
                write_run_logs(self._out, self._scene, trace, summary, self._log)
        return Result(scene=self._scene, summary=summary, trace=trace, folder=self._out)


def _write(out: Path, scene: Scene, trace: Trace, summary: Summary) -> None:
    """Write the results; the summary is the last one but for the report."""
    from ..loop.shown.report import RunRead, write_report

    with whole_file(out / "trace.parquet") as part:
        write_trace(scene, trace, part)
    text = json.dumps({**summary, "versions": versions()}, indent=2)
    with whole_file(out / "summary.json") as part:
        part.write_text(text + "\n", encoding="utf-8")
    write_report(RunRead(folder=out, scene=scene, summary=summary, columns=trace.columns))
