"""Make a dataset: sequences by any number of workers in any order, then table, card, manifest."""

import os
import re
import socket
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Literal

import msgspec

from ..errors import UserError
from ..extras import require
from ..folders import disk_errors, prepared, remove, synced, whole_folder
from ..output.processes import Progress, exit_on_sigterm, map_processes
from ..strange_files import refuse_links
from .card import write_card
from .folder import (
    FILES,
    RECIPE,
    SENSORS,
    Manifest,
    Place,
    clean,
    file_digest,
    is_sequence,
    keep_recipe,
    link,
    made_with,
    numbers_in,
    open_recipe,
    own_files,
    read_files,
    read_manifest,
    sequence_name,
    write_manifest,
)
from .own_files import keep_files
from .read import check_files, check_shared, verified
from .recipe import Recipe, check_asked, difference, portable
from .remote import begun, fetched, is_address, send, staged
from .sequence import was_drawn, write_sequence

Backend = Literal["joblib", "dask", "ray"]
#: End of the message of an interruption.
_GO_ON = "what is done is kept, go on with --resume"


def make(
    recipe: Recipe,
    out: Place,
    *,
    workers: int = 1,
    shard: tuple[int, int] = (1, 1),
    backend: Backend = "joblib",
    address: str = "",
    resume: bool = False,
    progress: Progress = lambda done, total: None,
    damaged: Callable[[list[str]], None] = lambda names: None,
) -> Manifest:
    """Make the sequences of a recipe that a folder does not hold yet; returns the manifest.

    Sequence k depends only on the recipe and k: workers, shards and interruptions change no byte.
    Existing sequences are verified, and made again if they are damaged. Everything is on the disk,
    not only in its cache, before the manifest is written.

    Parameters
    ----------
    recipe: recipe of the dataset
    out: folder, or address of fsspec, new or empty; with `resume` that of an interrupted run
    workers: number of processes on this machine (default 1); a running cluster uses all of its own
    shard: (i, K), from 1: this run makes every K-th sequence from the i-th on (default: all)
    backend: library that runs the work (default `joblib`); dask and ray are extras
    address: address of a running cluster (default: none is used)
    resume: whether to continue an interrupted run; the recipe may have more sequences than before
    progress: function called with the number of sequences done and of all
    damaged: function called with the names of damaged sequences that are made again

    Raises
    ------
    UserError
        For a folder of another recipe, a sequence that cannot be made, or a cluster that does not
        answer.
    """
    check_asked(recipe)
    if is_address(out):
        how: dict[str, Any] = {"workers": workers, "shard": shard, "backend": backend}
        how |= {"address": address, "damaged": damaged}
        return _make_at(recipe, os.fspath(out), resume, progress, how)
    out = Path(out)
    first, step = shard
    ours = range(first - 1, recipe.sequences, step)
    if not ours:
        raise UserError(f"shard {first}/{step} of {recipe.sequences} sequences has none")
    with _begun(out, resume):
        recipe, again = _taken_up(recipe, out)
        damaged(again)
        there = set(numbers_in(out))
        todo = [number for number in ours if number not in there]
        before = len(ours) - len(todo)
        progress(before, len(ours))
        results = _results(recipe, todo, out, workers, backend, address)
        with closing(results):
            for done, _ in enumerate(results, before + 1):
                progress(done, len(ours))
        with ThreadPoolExecutor() as pool:  # a disk waits for many files at once
            list(pool.map(_sync, out.glob("sequence-*")))
        return _finish(out, recipe)


@contextmanager
def _begun(out: Path, resume: bool) -> Iterator[None]:
    """Lock a new folder, or that of an interrupted run."""
    begun = (out / RECIPE).exists()
    if begun and not resume:
        raise UserError(f"{out} holds a dataset already; go on with --resume, or choose another")
    if begun:
        refuse_links(out)
    with prepared(out, overwrite=begun or None):
        yield


def _taken_up(recipe: Recipe, out: Path) -> tuple[Recipe, list[str]]:
    """Write the recipe, and remove damaged sequences; returns the recipe and their names."""
    digests: dict[str, str] = {}
    with suppress(UserError):  # only a complete dataset has them
        digests = read_manifest(out)["sequences"]
    recipe = keep_files(recipe, out)
    keep_recipe(recipe, out)
    clean(out)
    damaged = []
    for path in sorted(out.glob("sequence-*")):
        if is_sequence(path.name) and not _is_whole(path, recipe, digests.get(path.name)):
            with disk_errors(path):
                remove(path)
            damaged.append(path.name)
    return recipe, damaged


def _is_whole(path: Path, recipe: Recipe, digest: str | None) -> bool:
    """Return True if a sequence has the files and the values with which it was made."""
    try:
        check_files(path, digest or file_digest(path / FILES))
        listed = read_files(path)
    except UserError:
        return False
    number = listed["number"]
    return (
        sequence_name(number) == path.name
        and listed["versions"] == made_with()
        and was_drawn(recipe, number, listed["values"], path)
    )


def _sync(folder: Path) -> None:
    for path in (*folder.iterdir(), folder):
        synced(path)


def _make_at(
    recipe: Recipe, place: str, resume: bool, progress: Progress, how: dict[str, Any]
) -> Manifest:
    """Make a dataset in the user's cache, and copy it to an address of fsspec."""
    folder = begun(place, resume)
    manifest = make(recipe, folder, resume=True, progress=progress, **how)
    send(folder, place)
    return manifest


def merge(folders: Iterable[Place], out: Place, *, follow_links: bool = False) -> Manifest:
    """Merge several shards of a recipe into one dataset in a new folder; returns its manifest.

    Parameters
    ----------
    folders: folders of the shards, or their addresses
    out: folder, or address, new or empty; it is removed if the merge fails
    follow_links: whether links in the shards may lead out of them, as in caches of hubs

    Raises
    ------
    UserError
        When the shards differ in recipe, sensor or versions, hold a sequence twice, are not
        complete or have changed.
    """
    shards = [fetched(folder, follow_links) for folder in folders]
    recipe = open_recipe(shards[0])
    manifests = [check_shared(folder) for folder in shards]
    origins: dict[str, Path] = {}
    for folder, manifest in zip(shards, manifests, strict=True):
        own, shared = portable(open_recipe(folder), folder), portable(recipe, shards[0])
        if own != shared:
            differs = difference(own, shared)
            raise UserError(f"{folder} is of another recipe than {shards[0]}: {differs}")
        differ = sorted(name for name, _ in _own(folder) ^ _own(shards[0]))
        if differ:
            what = "sensor" if differ[0].startswith(SENSORS) else "mesh"
            raise UserError(f"{folder} is of another {what} than {shards[0]}")
        if manifest["versions"] != manifests[0]["versions"]:
            raise UserError(f"{folder} was made with other versions than {shards[0]}")
        for name in manifest["sequences"]:
            if name in origins:
                raise UserError(f"{name} is in {origins[name]} and in {folder}")
            origins[name] = folder
        for _ in verified(folder):
            pass
    with staged(out) as whole:
        recipe = keep_files(recipe, whole)
        keep_recipe(recipe, whole)
        for name, folder in origins.items():
            with whole_folder(whole / name) as part:
                for file in (folder / name).iterdir():
                    link(file, part / file.name)
        return _finish(whole, recipe)


def _own(folder: Path) -> set[tuple[str, str]]:
    """List the user's own files with their checksums."""
    return {(name, file_digest(folder / name)) for name in own_files(folder)}


def _finish(out: Path, recipe: Recipe) -> Manifest:
    clean(out)
    numbers = numbers_in(out)
    write_card(out, portable(recipe, out), numbers)
    return write_manifest(out, numbers)


def _results(
    recipe: Recipe, todo: list[int], out: Path, workers: int, backend: Backend, address: str
) -> Generator[int, None, None]:
    """Make sequences, and yield their numbers."""
    job = partial(_make, msgspec.msgpack.encode(recipe), str(out.absolute()))
    if address and backend == "joblib":
        raise UserError("--address needs --backend dask or ray")
    if backend == "joblib":
        yield from map_processes(job, todo, workers, advice=_GO_ON)
    elif todo:
        with exit_on_sigterm(), closing(_on_cluster(job, todo, backend, workers, address)) as made:
            yield from made


def _make(recipe: bytes, out: str, number: int) -> int:
    """Make one sequence, in this process or in a worker."""
    return write_sequence(msgspec.msgpack.decode(recipe, type=Recipe), number, Path(out))


def _on_cluster(
    job: Callable[[int], int], todo: list[int], backend: Backend, workers: int, address: str
) -> Generator[int, None, None]:
    """Make sequences by joblib on a cluster that is started, or is at an address."""
    from joblib import Parallel, delayed, parallel_config

    name = backend.title()
    require(backend)
    if address and (backend, address) != ("ray", "auto"):  # the cluster of this machine
        _check_cluster(name, address)
    with ExitStack() as opened:
        try:
            settings, failures = (_dask if backend == "dask" else _ray)(opened, workers, address)
        except (OSError, RuntimeError) as error:
            raise _absent(name, address, error) from None
        # Ray's backend returns lists alone, so that progress is told after each.
        kind, size = ("list", 200) if backend == "ray" else ("generator_unordered", len(todo))
        with parallel_config(backend, **settings):
            parallel = Parallel(n_jobs=-1, batch_size=1, return_as=kind)
        try:
            with parallel:
                for first in range(0, len(todo), size):
                    numbers = todo[first : first + size]
                    yield from parallel(delayed(job)(number) for number in numbers)
        except failures as error:
            text = (str(error) or type(error).__name__).splitlines()[0]
            raise UserError(f"the {name} cluster failed: {text} ({_GO_ON})") from None


def _dask(opened: ExitStack, workers: int, address: str) -> tuple[dict[str, Any], Any]:
    """Settings of joblib's backend Dask, and errors of a cluster that fails."""
    from distributed import Client, KilledWorker, LocalCluster

    cluster = address or opened.enter_context(
        LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
    )
    client = opened.enter_context(Client(cluster, timeout="10s"))
    return {"client": client}, (KilledWorker, CancelledError, OSError)


def _ray(opened: ExitStack, workers: int, address: str) -> tuple[dict[str, Any], Any]:
    """Settings of joblib's backend Ray, and errors of a cluster that fails."""
    import ray
    from ray.util.joblib import register_ray

    own = {"address": address} if address else {"num_cpus": workers, "include_dashboard": False}
    ray.init(**own, log_to_driver=False, logging_level="error")
    opened.callback(ray.shutdown)
    register_ray()
    return {}, ray.exceptions.RayError


def _check_cluster(name: str, address: str) -> None:
    """Refuse an address where no cluster answers; the clusters' own clients try for minutes."""
    matched = re.fullmatch(r"(?:(?:tcp|tls|ws|wss|ray)://)?([^/:]+):(\d{1,5})", address)
    if matched is None:
        raise UserError(f"--address {address}: expected HOST:PORT, such as 10.0.0.1:8786")
    try:
        socket.create_connection((matched[1], int(matched[2])), timeout=10.0).close()
    except (OSError, OverflowError) as error:
        raise _absent(name, address, error) from None


def _absent(name: str, address: str, error: Exception) -> UserError:
    return UserError(f"there is no {name} cluster at {address}: {error}")
