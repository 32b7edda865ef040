"""Make a dataset: sequences by any number of workers in any order, then table, card, manifest."""

import os
import re
import socket
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import msgspec

from ..errors import UserError
from ..extras import need, require
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
from .frozen import refuse_older
from .own_files import keep_files
from .read import check_files, check_shared, verified
from .recipe import Recipe, check_asked, difference, portable
from .remote import Sender, fetch_begun, fetched, has_dataset, is_address, staged
from .sequence import was_drawn, write_sequence

Backend = Literal["joblib", "dask", "ray"]
#: Number of sequences submitted to a cluster at a time: enough for many workers, and for memory.
_WAITING = 2000
#: End of the message of an interruption.
_GO_ON = "what is done is kept, go on with --resume"
#: Function that makes the sequence of a number, and returns the number.
Job = Callable[[int], int]


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
    _check_made(recipe)
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
        with _syncing(out, there) as sync, closing(results):
            for done, number in enumerate(results, before + 1):
                sync(number)
                progress(done, len(ours))
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


@contextmanager
def _syncing(out: Path, there: Iterable[int]) -> Iterator[Callable[[int], None]]:
    """Write sequences through to the disk in a thread; all are written at the end."""
    waiting: deque[Future[None]] = deque()
    with ThreadPoolExecutor(1) as pool:

        def sync(number: int) -> None:
            waiting.append(pool.submit(_sync, out / sequence_name(number)))
            while waiting[0].done():
                waiting.popleft().result()
                if not waiting:
                    return

        for number in there:
            sync(number)
        yield sync
        for future in waiting:
            future.result()


def _sync(folder: Path) -> None:
    for path in (*folder.iterdir(), folder):
        synced(path)


def _check_made(recipe: Recipe) -> None:
    """Refuse a recipe that cannot be made here."""
    check_asked(recipe)
    refuse_older(recipe)


def _make_at(
    recipe: Recipe, place: str, resume: bool, progress: Progress, how: dict[str, Any]
) -> Manifest:
    """Make a dataset in the user's cache, and copy each sequence to an address of fsspec."""
    if has_dataset(place) and not resume:
        raise UserError(f"{place} holds a dataset already; go on with --resume, or choose another")
    folder = fetch_begun(place)
    sender = Sender(folder, place)

    def tell(done: int, total: int) -> None:
        sender.send()
        progress(done, total)

    def again(names: list[str]) -> None:
        sender.again(names)
        damaged(names)

    damaged = how.pop("damaged")
    manifest = make(recipe, folder, resume=True, progress=tell, damaged=again, **how)
    sender.finish()
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
        cluster = _dask if backend == "dask" else _ray
        with exit_on_sigterm(), closing(cluster(job, todo, workers, address)) as numbers:
            yield from numbers


def _make(recipe: bytes, out: str, number: int) -> int:
    """Make one sequence, in this process or in a worker."""
    return write_sequence(msgspec.msgpack.decode(recipe, type=Recipe), number, Path(out))


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


def _first(error: BaseException) -> str:
    """First line of a cluster's message, which may be pages long."""
    return (str(error) or type(error).__name__).splitlines()[0]


def _dask(job: Job, todo: list[int], workers: int, address: str) -> Generator[int, None, None]:
    require("dask")
    from distributed import Client, KilledWorker, LocalCluster, as_completed

    if address:
        _check_cluster("Dask", address)
    with ExitStack() as opened:
        try:
            cluster = address or opened.enter_context(
                LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
            )
            client = opened.enter_context(Client(cluster, timeout="10s"))
        except OSError as error:
            raise _absent("Dask", address, error) from None

        # If a worker dies, the others make its sequences.
        def submit(number: int) -> Any:
            return client.submit(job, number, pure=False, retries=3)

        remaining = iter(todo)
        waiting = as_completed([submit(number) for number in islice(remaining, _WAITING)])
        try:
            for future in waiting:
                yield future.result()
                waiting.update([submit(number) for number in islice(remaining, 1)])
        except KilledWorker as error:
            raise UserError(f"{error.task} killed several workers in turn; {_GO_ON}") from None
        except (CancelledError, OSError) as error:
            raise UserError(f"the Dask cluster failed: {_first(error)} ({_GO_ON})") from None


def _ray(job: Job, todo: list[int], workers: int, address: str) -> Generator[int, None, None]:
    ray = need("ray", "ray")
    quiet = {"log_to_driver": False, "logging_level": "error"}
    own = {"address": address} if address else {"num_cpus": workers, "include_dashboard": False}
    if address not in ("", "auto"):  # auto is the cluster of this machine
        _check_cluster("Ray", address)
    try:
        ray.init(**own, **quiet)
    except (OSError, RuntimeError) as error:
        raise _absent("Ray", address, error) from None
    try:
        remote = ray.remote(max_retries=3)(lambda number: job(number))
        remaining = iter(todo)
        waiting = [remote.remote(number) for number in islice(remaining, _WAITING)]
        while waiting:
            ready, waiting = ray.wait(waiting)
            yield from ray.get(ready)
            waiting += [remote.remote(number) for number in islice(remaining, len(ready))]
    except ray.exceptions.RayTaskError as error:
        raise error.cause from None
    except ray.exceptions.RayError as error:
        raise UserError(f"the Ray cluster failed: {_first(error)} ({_GO_ON})") from None
    finally:
        ray.shutdown()
