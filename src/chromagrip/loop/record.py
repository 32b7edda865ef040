"""The record of a run: its trace and summary, and its folder where one is wanted."""

import time
from array import array
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

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
from .trace import Summary, Trace, make_trace, summarise


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


class Record:
    """Samples of a run as they come: of a simulation, of frames from outside or of a live grasp.

    Parameters
    ----------
    scene: that is run
    methods: that read its pictures
    known: calibration of the first finger; None on the truth path
    files: of the run; None writes nothing
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
        self._rows, self._reasons = array("d"), list[str]()
        self._rest: Tracks | None = None
        self._seconds = self._since = 0.0

    def add(self, sample: Sample, rig: Rig | None = None) -> None:
        """Append a frame.

        Parameters
        ----------
        sample: of the frame
        rig: that stands at the frame, for its pictures; None where they are not kept

        Raises
        ------
        UserError
            When the folder cannot be written; nothing of the run is left in it then.
        """
        if self._rows:  # the first frame includes those at rest
            self._seconds += time.perf_counter() - self._since
        self._rest = sample.readings[0].rest
        self._reasons += sample.reasons
        line = self._lines.line(sample)
        self._rows.extend(line)
        if self._files is not None:
            self._files.add(line, sample, rig)
        self._since = time.perf_counter()

    @property
    def trace(self) -> Trace:
        """Frames until now."""
        return make_trace(self._rows, self._lines.columns)

    def finish(self, scene: Scene | None = None, said: str = "", **more: Any) -> Result:
        """Write the results, however the run ended.

        Parameters
        ----------
        scene, said: where these are known at the end only, see `RunFiles.write`
        more: values of the summary beside its own, or in their place

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
        return summarise(scene, trace, self._seconds, self._read_with, pose, self._reasons)


def _pose_at_rest(known: SensorCalibration | None, rest: Tracks | None) -> CameraPose | None:
    """Pose of the camera; None on the truth path, and where a plug-in's tracks do not show it."""
    if known is not None and rest is not None:
        with suppress(UserError):
            return rest_pose(known.sensor, rest)
    return None
