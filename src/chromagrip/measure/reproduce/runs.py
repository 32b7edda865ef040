"""The grasps of a reproduction, also with unprinted parameters at other values."""

import json
import math
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from ...errors import UserError
from ...folders import whole_file
from ...loop.columns import columns_of
from ...loop.results.trace_file import read_trace, write_trace
from ...loop.run import run
from ...loop.trace import Trace
from ...model import ContactObject
from ...output.cells import read_cells, resumed
from ...output.processes import map_processes
from ...scene.scene import load_scene

#: Name and colour of the thesis's controllers in figures, as in the thesis.
CONTROLLERS = {
    "safety-margin": ("Safety Margin Control", "#1f5fa8"),
    "conservative": ("Conservative Control", "#c8442e"),
    "react-to-slip": ("React To Slip", "#e0a100"),
}
#: Marker of each of them, so that they differ by more than their colour.
MARKERS = {"safety-margin": "o", "conservative": "s", "react-to-slip": "^"}
#: File of the cells until all work is done.
UNFINISHED = "runs.unfinished.csv"

_DEFAULT = ContactObject()
#: Unprinted parameters that every figure here uses.
UNPRINTED = (
    f"Dahl n = {_DEFAULT.dahl_exponent:g}, σ0 = {_DEFAULT.dahl_stiffness:g} N/m per node, "
    f"drag {_DEFAULT.drag:g} N·s/m"
)


@dataclass(frozen=True)
class Variant:
    """One unprinted parameter at another value.

    Attributes
    ----------
    text: parameter and value
    changes: of the scene
    radii: of round objects, in place of the inferred ones [mm]
    """

    text: str
    changes: dict[str, float | str] = field(default_factory=dict)
    radii: dict[float, float] = field(default_factory=dict)


#: The values that are used everywhere else here.
PLAIN = Variant("as everywhere here")
#: Friction and drag of the object, one changed at a time.
SWEEP = [
    Variant("Dahl exponent 1", {"object.dahl_exponent": 1.0}),
    Variant("Dahl exponent 0.5", {"object.dahl_exponent": 0.5}),
    Variant("σ0 1000 N/m", {"object.dahl_stiffness_n_per_m": 1000.0}),
    Variant("σ0 20000 N/m", {"object.dahl_stiffness_n_per_m": 20000.0}),
    Variant("drag 25 N·s/m", {"object.drag_n_s_per_m": 25.0}),
    Variant("drag 60 N·s/m", {"object.drag_n_s_per_m": 60.0}),
    Variant("drag 240 N·s/m", {"object.drag_n_s_per_m": 240.0}),
]
#: The radius of the sharpest objects is inferred too (E5); it matters to Table 2 only.
BLUNTER = Variant("radii flat, 20 and 10 mm", radii={5.0: 10.0})

Changes = Mapping[str, object]


class Job(NamedTuple):
    """A scene with some values changed, the changes as JSON."""

    scene: str
    changes: str

    @property
    def values(self) -> dict[str, Any]:
        """Dotted key → new value."""
        return json.loads(self.changes)

    @property
    def file(self) -> str:
        """Name of the file of its trace."""
        values = self.values
        start = [self.scene, values.pop("path"), values.pop("controller")]
        changed = [f"{key.rpartition('.')[2]}-{value}" for key, value in values.items()]
        return "-".join(start + changed) + ".parquet"


def make_job(controller: str, changes: Changes | None = None, camera: str | None = None) -> Job:
    """Job of the validation experiment, on the truth path or through the camera of a scene."""
    path = {"path": "camera" if camera else "truth", "controller": controller}
    return Job(camera or "thesis", json.dumps(path | dict(changes or {})))


@dataclass(frozen=True, kw_only=True)
class Cell:
    """Result of a job; NaN where there is none.

    Attributes
    ----------
    scene, changes: the job
    pressure, pressure_pitch: largest, without and with one node pitch added to the width [N/m]
    displacement, rigid_slip: at the end [mm]
    margin_rmse: error of the estimated Γ
    final_margin: true
    reactions: of React To Slip
    stopped: why the run ended early, as where the object is let go; else empty
    """

    scene: str
    changes: str
    pressure: float = math.nan
    pressure_pitch: float = math.nan
    displacement: float = math.nan
    rigid_slip: float = math.nan
    margin_rmse: float = math.nan
    final_margin: float = math.nan
    reactions: int = 0
    stopped: str = ""

    @property
    def job(self) -> Job:
        """Job of this cell."""
        return Job(self.scene, self.changes)


@dataclass(frozen=True)
class Runs:
    """Results of all jobs, and the traces of some."""

    cells: dict[Job, Cell] = field(default_factory=dict)
    traces: dict[Job, Trace] = field(default_factory=dict)


def run_jobs(
    jobs: Sequence[Job],
    traced: Sequence[Job],
    out: Path | None,
    workers: int,
    progress: Callable[[str], None],
) -> Runs:
    """Run every job that an interrupted call has not done.

    Parameters
    ----------
    jobs: runs whose cells are wanted
    traced: runs whose traces are wanted too
    out: folder of `runs.csv` and `traces`; None writes nothing
    workers: processes; one runs in this process
    progress: called with the number of runs that are done

    Raises
    ------
    UserError
        When a run stops whose trace is wanted.
    """
    wanted = list(dict.fromkeys([*traced, *jobs]))
    wanted.sort(key=lambda job: job.values["path"] != "camera")  # long ones first
    part = None if out is None else out / UNFINISHED
    paths = {} if out is None else {job: out / "traces" / job.file for job in traced}
    read = {job: _read_trace(path) for job, path in paths.items()}
    traces = {job: trace for job, trace in read.items() if trace is not None}
    done = (c for c in read_cells(part, Cell) if c.job not in paths or c.job in traces)

    meanings = {name: column.meaning for name, column in columns_of("chain").items()}

    def results(waiting: list[Job]) -> Generator[Cell]:
        for cell, trace in map_processes(_run, waiting, workers):
            if cell.job in traced:
                if trace is None:
                    raise UserError(f"{cell.scene}, {cell.changes}: {cell.stopped}")
                traces[cell.job] = trace
                if cell.job in paths:
                    paths[cell.job].parent.mkdir(exist_ok=True)
                    with whole_file(paths[cell.job]) as file:
                        write_trace(file, trace.columns, meanings)
            yield cell

    def tell(count: int, total: int) -> None:
        progress(f"runs: {count} of {total}")

    return Runs(resumed(part, done, lambda cell: cell.job, wanted, results, tell), traces)


def _run(job: Job) -> tuple[Cell, Trace | None]:
    try:
        result = run(load_scene(job.scene, job.values))
    except UserError as error:
        return Cell(scene=job.scene, changes=job.changes, stopped=str(error)), None

    def value(name: str) -> float:
        return math.nan if result.summary[name] is None else float(result.summary[name])

    cell = Cell(
        scene=job.scene,
        changes=job.changes,
        pressure=value("max_pressure_n_per_m"),
        pressure_pitch=value("max_pressure_pitch_n_per_m"),
        displacement=value("lateral_displacement_mm"),
        rigid_slip=value("rigid_slip_mm"),
        margin_rmse=value("margin_rmse"),
        final_margin=value("final_margin_true"),
        reactions=len(result.summary["slip_reactions"]),
    )
    return cell, result.trace


def _read_trace(path: Path) -> Trace | None:
    """Trace of a run that was done; None where there is none that can be read."""
    try:
        return Trace(read_trace(path, list(columns_of("chain"))))
    except UserError:
        return None
