"""Making a dataset: its sequences by any number of workers, in any order, and what sums it up."""

import socket
from collections.abc import Callable, Generator
from concurrent.futures import CancelledError
from contextlib import ExitStack, closing
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import msgspec

from ..errors import UserError
from ..extras import need, require
from ..output.folder import filling, prepare, whole_folder
from ..output.processes import Progress, exit_on_sigterm, map_processes
from .card import write_card
from .check import check_files
from .folder import (
    RECIPE,
    clean,
    file_digest,
    keep_recipe,
    link,
    numbers_in,
    open_recipe,
    read_manifest,
    sensor_files,
    write_manifest,
    write_sequence,
)
from .recipe import Recipe, portable
from .sensors import keep_sensors

Backend = Literal["joblib", "dask", "ray"]
#: Sequences that a cluster is told of at a time: enough for many workers, and no more memory.
_WAITING = 2000
_GO_ON = "what is done is kept, go on with --resume"
#: Makes the sequence of a number.
Job = Callable[[int], int]


def make(
    recipe: Recipe,
    out: Path,
    *,
    workers: int = 1,
    shard: tuple[int, int] = (1, 1),
    backend: Backend = "joblib",
    address: str = "",
    resume: bool = False,
    progress: Progress = lambda done, total: None,
) -> dict[str, Any]:
    """Make the sequences of a recipe that a folder does not hold yet; returns the manifest.

    Sequence k rests on the recipe and k alone: workers, shards and interruptions change no byte.

    Parameters
    ----------
    recipe: what is made
    out: folder, new or empty; with `resume` that of an interrupted run
    workers: processes on this machine; on a cluster as many as it has
    shard: (i, K), from 1: this run makes every K-th sequence from the i-th on
    backend: who hands out the work; dask and ray are extras
    address: of a running cluster
    resume: go on where it was; the recipe may ask for more sequences than before
    progress: told how many are done

    Raises
    ------
    UserError
        For a folder of another recipe, a sequence that cannot be made, or a cluster that is not
        there.
    """
    first, step = shard
    wanted = range(first - 1, recipe.sequences, step)
    if not wanted:
        raise UserError(f"shard {first}/{step} of {recipe.sequences} sequences has none")
    begun = (out / RECIPE).exists()
    if begun and not resume:
        raise UserError(f"{out} holds a dataset already; go on with --resume, or choose another")
    if not begun:
        prepare(out, overwrite=None)
    with filling(out):
        recipe = keep_sensors(recipe, out)
        keep_recipe(recipe, out)
        clean(out)
        there = set(numbers_in(out))
        todo = [number for number in wanted if number not in there]
        done = len(wanted) - len(todo)
        progress(done, len(wanted))
        with closing(_results(recipe, todo, out, workers, backend, address)) as results:
            for _ in results:
                done += 1
                progress(done, len(wanted))
        return _finish(out, recipe)


def merge(folders: list[Path], out: Path) -> dict[str, Any]:
    """One dataset of several shards of a recipe, in a new folder; returns its manifest.

    Raises
    ------
    UserError
        When the shards are of other recipes or versions, hold a sequence twice, or are not whole
        or not what they were.
    """
    recipe = open_recipe(folders[0])
    manifests = [read_manifest(folder) for folder in folders]
    seen: dict[str, Path] = {}
    for folder, manifest in zip(folders, manifests, strict=True):
        if portable(open_recipe(folder), folder) != portable(recipe, folders[0]):
            raise UserError(f"{folder} is of another recipe than {folders[0]}")
        if _sensors(folder) != _sensors(folders[0]):
            raise UserError(f"{folder} is of another sensor than {folders[0]}")
        if manifest["versions"] != manifests[0]["versions"]:
            raise UserError(f"{folder} was made with other versions than {folders[0]}")
        for name, digest in manifest["sequences"].items():
            if name in seen:
                raise UserError(f"{name} is in {seen[name]} and in {folder}")
            check_files(folder / name, digest)
            seen[name] = folder
    prepare(out, overwrite=None)
    recipe = keep_sensors(recipe, out)
    keep_recipe(recipe, out)
    for name, folder in seen.items():
        with whole_folder(out / name) as part:
            for file in (folder / name).iterdir():
                link(file, part / file.name)
    return _finish(out, recipe)


def _sensors(folder: Path) -> dict[str, str]:
    return {name: file_digest(folder / name) for name in sensor_files(folder)}


def _finish(out: Path, recipe: Recipe) -> dict[str, Any]:
    clean(out)
    numbers = numbers_in(out)
    write_card(out, portable(recipe, out), numbers)
    return write_manifest(out, numbers)


def _results(
    recipe: Recipe, todo: list[int], out: Path, workers: int, backend: Backend, address: str
) -> Generator[int, None, None]:
    """Numbers of sequences as they are made."""
    job = partial(_make, msgspec.msgpack.encode(recipe), str(out.absolute()))
    if address and backend == "joblib":
        raise UserError("--address goes with --backend dask or ray")
    if backend == "joblib":
        yield from map_processes(job, todo, workers, advice=_GO_ON)
    elif todo:
        cluster = _dask if backend == "dask" else _ray
        with exit_on_sigterm(), closing(cluster(job, todo, workers, address)) as numbers:
            yield from numbers


def _make(recipe: bytes, out: str, number: int) -> int:
    """Make one sequence, in this process or in a worker."""
    return write_sequence(msgspec.msgpack.decode(recipe, type=Recipe), number, Path(out))


def _knock(address: str) -> None:
    """Refuse an address at which nobody answers; the clusters' own clients try for minutes."""
    host, _, port = address.rpartition("/")[2].rpartition(":")
    if not (host and port.isdecimal()):
        raise UserError("expected HOST:PORT, such as 10.0.0.1:8786")
    socket.create_connection((host, int(port)), timeout=10.0).close()


def _first(error: BaseException) -> str:
    """First line of what a cluster says, which may be pages."""
    return (str(error) or type(error).__name__).splitlines()[0]


def _dask(job: Job, todo: list[int], workers: int, address: str) -> Generator[int, None, None]:
    require("dask")
    from distributed import Client, KilledWorker, LocalCluster, as_completed

    with ExitStack() as opened:
        try:
            if address:
                _knock(address)
                where: Any = address
            else:
                where = opened.enter_context(
                    LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
                )
            client = opened.enter_context(Client(where, timeout="10s"))
        except (OSError, ValueError) as error:
            raise UserError(f"there is no Dask cluster at {address}: {error}") from None

        # A worker that dies takes nothing along: its sequences are made by the others.
        def submit(number: int) -> Any:
            return client.submit(job, number, pure=False, retries=3)

        left = iter(todo)
        waiting = as_completed([submit(number) for number in islice(left, _WAITING)])
        try:
            for future in waiting:
                yield future.result()
                waiting.update([submit(number) for number in islice(left, 1)])
        except KilledWorker as error:
            raise UserError(f"{error.task} killed several workers in turn; {_GO_ON}") from None
        except (CancelledError, OSError) as error:
            raise UserError(f"the Dask cluster failed: {_first(error)} ({_GO_ON})") from None


def _ray(job: Job, todo: list[int], workers: int, address: str) -> Generator[int, None, None]:
    ray = need("ray", "ray")
    quiet = {"log_to_driver": False, "logging_level": "error"}
    try:
        if address:
            if address != "auto":  # the one that runs on this machine
                _knock(address)
            ray.init(address=address, **quiet)
        else:
            ray.init(num_cpus=workers, include_dashboard=False, **quiet)
    except (OSError, RuntimeError, ValueError) as error:
        raise UserError(f"there is no Ray cluster at {address}: {error}") from None
    try:
        remote = ray.remote(max_retries=3)(lambda number: job(number))
        left = iter(todo)
        waiting = [remote.remote(number) for number in islice(left, _WAITING)]
        while waiting:
            ready, waiting = ray.wait(waiting)
            yield from ray.get(ready)
            waiting += [remote.remote(number) for number in islice(left, len(ready))]
    except ray.exceptions.RayTaskError as error:
        raise error.cause from None
    except ray.exceptions.RayError as error:
        raise UserError(f"the Ray cluster failed: {_first(error)} ({_GO_ON})") from None
    finally:
        ray.shutdown()
