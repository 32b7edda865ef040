"""Keeping a part of a live grasp as a run folder."""

import csv
import math
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import msgspec

from ..errors import UserError
from ..folders import disk_errors
from ..loop.record import Record
from ..loop.rig import Rig
from ..loop.run_files import PARTS, RunFiles
from ..loop.sample import Sample
from ..scene.scene import Scene
from ..scene.settings import LoadSettings
from .sliders import SliderValues

#: Key of the summary for the time of the grasp at which the recording began [s].
FROM = "recorded_live_from_s"


@dataclass
class Recorder:
    """Records a live grasp on demand, each time into a folder of its own.

    Attributes
    ----------
    parent: folder of the recordings
    tell: function called with a sentence about each recording, in the thread of the grasp
    wanted: whether the grasp is recorded; any thread may set it
    """

    parent: Path
    tell: Callable[[str], None]
    wanted: bool = False
    _now: "_Recording | None" = None

    def take(self, sample: Sample, rig: Rig, sliders: SliderValues) -> None:
        """Keep a frame."""
        try:
            if self._now is None:
                self._now = _Recording(_unused(self.parent), sample, rig)
                self.tell(f"**recording** into {self._now.folder}")
            self._now.add(sample, rig, sliders)
        except UserError as error:
            self._drop(f"**not recorded:** {error}")

    def finish(self) -> None:
        """Write the recording, if there is one; the next frame begins another one."""
        recording, self._now = self._now, None
        if recording is None:
            return
        try:
            self.tell(recording.finish())
        except UserError as error:
            self._drop(f"**not recorded:** {error}")

    def _drop(self, sentence: str) -> None:
        self.wanted, recording, self._now = False, self._now, None
        if recording is not None:
            recording.discard()
        self.tell(sentence)


class _Recording:
    """An unfinished recording: its files do not have their names yet.

    Parameters
    ----------
    folder: folder that is made for it
    sample: first sample
    rig: rig of the grasp
    """

    def __init__(self, folder: Path, sample: Sample, rig: Rig) -> None:
        self.folder = folder
        self._begin = sample.time
        self._scenes: list[tuple[float, Scene]] = []
        self._sliders: list[tuple[float, SliderValues]] = []
        self._files = RunFiles(folder, False, rig.scene)
        self._record = Record(rig.scene, rig.methods, rig.known[0], self._files)
        self._mesh = _kept_mesh(rig.scene.object.mesh, folder)

    def add(self, sample: Sample, rig: Rig, sliders: SliderValues) -> None:
        """Append a frame with its scene and sliders."""
        scene = rig.scene
        now = sample.time - self._begin
        if not self._scenes or self._scenes[-1][1] is not scene:
            self._scenes.append((now, scene))
        if not self._sliders or self._sliders[-1][1] != sliders:
            self._sliders.append((now, sliders))
        self._record.add(replace(sample, time=now), rig)

    def finish(self) -> str:
        """Write the files and give them their names; returns a sentence about it."""
        times = self._record.trace["time_s"]
        length = float(times[-1])
        shortest = 0.2  # shortest recording that is kept [s]
        if length < shortest or self._scenes[-1][1].camera.latency_frames >= len(times):
            self.discard()
            return f"**not recorded:** a recording of {length:.2f} s is too short"
        scene = as_run(self._scenes, length, self._mesh)
        said = (
            f"A live grasp from {self._begin:.3f} s on, with its sliders' loads and friction as "
            "steps; a run of this scene begins with a fresh grip and gives other values. See "
            "sliders.csv."
        )
        with self._files, disk_errors(self.folder):
            _write_sliders(self.folder / PARTS / "sliders.csv", self._sliders)
            self._record.finish(scene, said, **{FROM: self._begin})
        return f"recorded {length:.2f} s in {self.folder}"

    def discard(self) -> None:
        """Remove its folder."""
        with self._files:
            pass
        shutil.rmtree(self.folder, ignore_errors=True)


def as_run(scenes: list[tuple[float, Scene]], length: float, mesh: str = "") -> Scene:
    """Scene of a run with the loads and frictions of several scenes, each from its time on.

    The other values are those of the last scene.

    Parameters
    ----------
    scenes: scenes of the run, each with the time from which on it was used [s]
    length: length of the run [s]
    mesh: file of the object (default: the object has no mesh)
    """
    last = scenes[-1][1]
    times = tuple(round(at, 9) for at, _ in scenes)
    loads = [scene.load for _, scene in scenes]
    load = LoadSettings(
        times_s=times,
        forces_n=tuple(load.forces_n[0] for load in loads),
        sideways_n=tuple(load.sideways_n[0] for load in loads) if loads[0].sideways_n else (),
        twists_nmm=tuple(load.twists_nmm[0] for load in loads) if loads[0].twists_nmm else (),
    )
    frictions = tuple(scene.object.friction for _, scene in scenes)
    changed = len(set(frictions)) > 1
    obj = msgspec.structs.replace(
        last.object,
        friction=frictions[0],
        friction_times_s=times if changed else (),
        frictions=frictions if changed else (),
        mesh=mesh,
    )
    period = last.period
    length = period * math.floor(length / period + 1e-6) + 1e-9
    return msgspec.structs.replace(last, duration_s=length, load=load, object=obj)


def _kept_mesh(mesh: str, folder: Path) -> str:
    """Copy a mesh's file into a folder: a file dropped onto a page is removed with its server."""
    if not mesh:
        return ""
    kept = folder / f"object{Path(mesh).suffix}"
    with disk_errors(kept):
        shutil.copyfile(mesh, kept)
    return str(kept)


def _write_sliders(path: Path, sliders: list[tuple[float, SliderValues]]) -> None:
    """Write the table of the sliders' values, with a line at each change."""
    with path.open("w", encoding="utf-8", newline="") as file:
        names = list(asdict(sliders[0][1]))
        table = csv.writer(file)
        table.writerow(["time_s", *names])
        for at, values in sliders:
            table.writerow([f"{at:.9g}", *asdict(values).values()])


def _unused(parent: Path) -> Path:
    """First unused folder with a number as its name."""
    for number in range(1, 10_000):
        folder = parent / f"{number:03d}"
        if not folder.exists():
            return folder
    raise UserError(f"{parent} holds 9999 recordings; choose another folder with --record")
