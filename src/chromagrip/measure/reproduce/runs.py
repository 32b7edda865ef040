"""The grasps that a reproduction is made of: in parallel, and kept as they are done."""

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

from ...errors import UserError
from ...extras import need
from ...loop.run_folder import run
from ...loop.trace import COLUMNS, Trace
from ...output.cells import read_cells, write_cells
from ...output.processes import start_worker
from ...scene.scene import load_scene

NAN = float("nan")


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
        """Name of its trace's file, if it is one of those that are kept."""
        values = self.values
        start = [self.scene, values.pop("path"), values.pop("controller")]
        changed = [f"{key.rpartition('.')[2]}-{value}" for key, value in values.items()]
        return "-".join(start + changed) + ".parquet"


def make_job(
    controller: str, changes: dict[str, Any] | None = None, camera: str | None = None
) -> Job:
    """Job of the validation experiment, on the truth path or through the camera of a scene."""
    path = {"path": "camera" if camera else "truth", "controller": controller}
    return Job(camera or "thesis", json.dumps(path | (changes or {})))


@dataclass(frozen=True)
class Cell:
    """What a job came to; NaN where there is nothing to say.

    Attributes
    ----------
    scene, changes: the job
    pressure, pressure_pitch: largest, without and with one node pitch added to the width [N/m]
    displacement, rigid_slip: at the end [mm]
    margin_rmse: error of the observed Γ
    final_margin: true
    reactions: of React To Slip
    stopped: why it did not come to its end, as where the object is let go; else empty
    """

    scene: str
    changes: str
    pressure: float
    pressure_pitch: float
    displacement: float
    rigid_slip: float
    margin_rmse: float
    final_margin: float
    reactions: int
    stopped: str = ""

    @property
    def job(self) -> Job:
        """The job that it is of."""
        return Job(self.scene, self.changes)


@dataclass(frozen=True)
class Runs:
    """What all jobs came to, and the traces of some."""

    cells: dict[Job, Cell] = field(default_factory=dict)
    traces: dict[Job, Trace] = field(default_factory=dict)


def run_jobs(
    jobs: list[Job],
    traced: list[Job],
    out: Path | None,
    workers: int,
    progress: Callable[[str], None],
) -> Runs:
    """Run every job, those left out that an interrupted run has done.

    Parameters
    ----------
    jobs: what is summed up in a cell
    traced: what a trace is kept of too
    out: folder of `runs.csv` and `traces`; None writes nothing
    workers: processes; one runs in this process
    progress: told how many are done

    Raises
    ------
    UserError
        When a run stops of which a trace is wanted.
    """
    wanted = list(dict.fromkeys([*traced, *jobs]))  # long ones first: the camera's traces
    wanted.sort(key=lambda job: job.values["path"] != "camera")
    runs = Runs() if out is None else _done(wanted, traced, out)
    waiting = [
        job for job in wanted if job not in runs.cells or (job in traced and job not in runs.traces)
    ]
    done = len(wanted) - len(waiting)
    progress(f"runs: {done} of {len(wanted)}")
    for job, cell, trace in _results(waiting, workers):
        runs.cells[job] = cell
        if job in traced:
            if trace is None:
                raise UserError(f"{job.scene}, {job.changes}: {cell.stopped}")
            runs.traces[job] = trace
            if out is not None:
                _write_trace(trace, out / "traces" / job.file)
        if out is not None:
            _write(list(runs.cells.values()), out / UNFINISHED)
        done += 1
        progress(f"runs: {done} of {len(wanted)}")
    return runs


#: Where runs are kept until all is done.
UNFINISHED = "runs.unfinished.csv"


def _write(cells: list[Cell], path: Path) -> None:
    """Write a table that is whole whenever it is there."""
    part = path.with_suffix(".part")
    write_cells(cells, part)
    part.replace(path)


def _done(wanted: list[Job], traced: list[Job], out: Path) -> Runs:
    found = {cell.job: cell for cell in read_cells(out / UNFINISHED, Cell)}
    cells = {job: found[job] for job in wanted if job in found}
    paths = {job: out / "traces" / job.file for job in traced if job in cells}
    return Runs(cells, {job: _read_trace(path) for job, path in paths.items() if path.exists()})


def _results(jobs: list[Job], workers: int) -> Iterator[tuple[Job, Cell, Trace | None]]:
    """Results in the order in which they come."""
    if workers == 1 or len(jobs) < 2:
        yield from map(_run, jobs)
        return
    with get_context("spawn").Pool(min(workers, len(jobs)), initializer=start_worker) as pool:
        yield from pool.imap_unordered(_run, jobs)


def _run(job: Job) -> tuple[Job, Cell, Trace | None]:
    try:
        result = run(load_scene(job.scene, job.values))
    except UserError as error:
        nothing = (NAN,) * 6
        return job, Cell(job.scene, job.changes, *nothing, 0, str(error)), None
    return job, _cell(job, result.summary), result.trace


def _cell(job: Job, summary: dict[str, Any]) -> Cell:
    def value(name: str) -> float:
        return NAN if summary[name] is None else float(summary[name])

    return Cell(
        scene=job.scene,
        changes=job.changes,
        pressure=value("max_pressure_n_per_m"),
        pressure_pitch=value("max_pressure_pitch_n_per_m"),
        displacement=value("lateral_displacement_mm"),
        rigid_slip=value("rigid_slip_mm"),
        margin_rmse=value("margin_rmse"),
        final_margin=value("final_margin_true"),
        reactions=len(summary["slip_reactions"]),
    )


def _write_trace(trace: Trace, path: Path) -> None:
    pa, pq = need("pyarrow", "data"), need("pyarrow.parquet", "data")
    path.parent.mkdir(exist_ok=True)
    table = pa.table({name: pa.array(column) for name, column in trace.columns.items()})
    part = path.with_suffix(".part")
    pq.write_table(table, part)
    part.replace(path)


def _read_trace(path: Path) -> Trace:
    table = need("pyarrow.parquet", "data").read_table(path)
    return Trace({name: table[name].to_numpy() for name in COLUMNS})


def largest(values: Iterable[float]) -> float:
    """Largest of some values, NaN if one of them is."""
    found = list(values)
    return NAN if any(value != value for value in found) else max(found)
