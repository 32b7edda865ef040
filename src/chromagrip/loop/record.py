"""The record of a run: its trace and summary, and the files of its folder."""

from array import array
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..compiled import working_time
from ..errors import UserError
from ..scene.scene import Scene
from ..tracking import SensorCalibration, Tracks
from ..tracking.forces import CameraPose, rest_pose
from ..tracking.forces.chain import used
from .columns import Rows
from .methods import Methods
from .rig import Rig
from .run_files import RunFiles
from .sample import Sample
from .trace import Spent, Summary, Trace, make_trace, summarise


@dataclass(frozen=True, kw_only=True)
class Result:
    """Results of a run.

    Attributes
    ----------
    scene: scene that was run, with the names of the methods used
    summary: values of the run by name, see `trace.summarise`
    trace: time series of truth and estimates
    folder: folder of the files; None if no files were written
    """

    scene: Scene
    summary: Summary
    trace: Trace
    folder: Path | None


class Record:
    """Records samples as they come: from a simulation, a real camera or a live grasp.

    Parameters
    ----------
    scene: scene that is run
    methods: methods that read its pictures
    known: calibration of the first finger; None on the truth path
    files: files of the run; None: no files are written
    """

    def __init__(
        self,
        scene: Scene,
        methods: Methods,
        known: SensorCalibration | None,
        files: RunFiles | None,
    ) -> None:
        self._scene, self._known, self._files = scene, known, files
        self._read_with = None if known is None else used(methods.reconstructor, known)
        self._lines = Rows(scene)
        self._rows, self._reasons, self._reading = array("d"), list[str](), array("d")
        self._rest: Tracks | None = None
        self._seconds = self._since = 0.0

    def add(self, sample: Sample, rig: Rig | None = None) -> None:
        """Append a frame.

        Parameters
        ----------
        sample: sample of the frame
        rig: rig at that frame, for its pictures; None if they are not kept

        Raises
        ------
        UserError
            When the folder cannot be written; the run's files are then removed.
        """
        if self._rows:  # the first frame includes those at rest
            self._seconds += working_time() - self._since
        self._rest = sample.readings[0].rest
        self._reasons += sample.reasons
        if any(one.frame is not None for one in sample.readings):
            self._reading.append(sum(one.seconds for one in sample.readings))
        line = self._lines.line(sample)
        self._rows.extend(line)
        if self._files is not None:
            self._files.add(line, sample, rig)
        self._since = working_time()

    @property
    def trace(self) -> Trace:
        """Trace of the frames so far."""
        return make_trace(self._rows, self._lines.columns)

    def finish(self, scene: Scene | None = None, said: str = "", **more: Any) -> Result:
        """Write the results, also of a run that was interrupted.

        Parameters
        ----------
        scene, said: scene and note that are known only at the end, see `RunFiles.write`
        more: further values of the summary, or replacements of its own

        Raises
        ------
        UserError
            When the folder cannot be written.
        """
        trace = self.trace
        summary = self._summary(scene or self._scene, trace) | more
        folder = None if self._files is None else self._files.folder
        if self._files is not None and len(trace):
            self._files.write(trace, summary, scene, said)
        return Result(scene=scene or self._scene, summary=summary, trace=trace, folder=folder)

    def _summary(self, scene: Scene, trace: Trace) -> Summary:
        pose = _pose_at_rest(self._known, self._rest)
        spent = Spent(self._seconds, self._reading)
        return summarise(scene, trace, spent, self._read_with, pose, self._reasons)


def _pose_at_rest(known: SensorCalibration | None, rest: Tracks | None) -> CameraPose | None:
    """Pose of the camera; None on the truth path, and if it cannot be fitted to the tracks."""
    if known is not None and rest is not None:
        with suppress(UserError):
            return rest_pose(known.sensor, rest)
    return None
