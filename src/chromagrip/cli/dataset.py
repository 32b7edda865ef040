"""The commands `dataset …`: make, check, info, split, merge."""

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from msgspec.structs import replace
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from ..errors import UserError
from ..extras import need
from .options import Flag, option

Folder = Annotated[Path, tyro.conf.Positional, option("of a dataset", "DIR")]
Json = Annotated[Flag, option("one JSON object", name="json")]


class _Rate(ProgressColumn):
    """Sequences a second."""

    def render(self, task: Task) -> Text:
        """So many a second, or nothing where it is not known yet."""
        return Text("" if not task.speed else f"{task.speed:.2g}/s")


@contextmanager
def _counting(what: str, *more: ProgressColumn) -> Iterator[Callable[..., None]]:
    """Show a count: what is yielded is told how much is done, and of how much if it is known."""
    columns = TextColumn(what), BarColumn(), MofNCompleteColumn(), *more
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(what, total=None)

        def tell(done: int, total: int | None = None) -> None:
            bar.update(task, completed=done, total=total)

        yield tell


def dataset_make(
    recipe: Annotated[
        str,
        tyro.conf.Positional,
        option("shipped (force, slip, tiny, tracking), or a .toml file", "RECIPE|FILE.toml"),
    ],
    *,
    out: Annotated[Path, option("folder, new or empty", "DIR")],
    n: Annotated[int | None, option("sequences, instead of the recipe's", "N", "n")] = None,
    truth: Annotated[
        tuple[Literal["flow", "depth", "masks"], ...],
        option("kept of every pixel, beside what the recipe keeps", "flow|depth|masks..."),
    ] = (),
    workers: Annotated[int, option("processes", "N")] = os.cpu_count() or 1,
    shard: Annotated[
        str, option("every K-th sequence from the i-th on, such as 2/8", "i/K")
    ] = "1/1",
    backend: Annotated[
        Literal["joblib", "dask", "ray"], option("who hands out the work", "joblib|dask|ray")
    ] = "joblib",
    address: Annotated[str, option("of a running cluster, such as tcp://host:8786", "URL")] = "",
    resume: Annotated[Flag, option("go on with an interrupted dataset")] = False,
    json_only: Json = False,
) -> int:
    """Make labelled sequences of pictures as a recipe says.

    Sequence k rests on the recipe and k alone: workers, shards and interruptions change no byte.
    """
    from ..dataset.make import make
    from ..dataset.recipe import load_recipe

    told = load_recipe(recipe)
    if n is not None:
        if not 1 <= n <= 10_000_000:
            raise UserError(f"--n {n}: expected 1 to 10000000")
        told = replace(told, sequences=n)
    told = replace(told, truth=tuple(dict.fromkeys((*told.truth, *truth))))
    if workers < 1:
        raise UserError(f"--workers {workers}: expected 1 or more")
    with _counting("sequences", _Rate(), TimeRemainingColumn()) as tell:
        manifest = make(
            told, out, workers=workers, shard=_shard(shard), backend=backend, address=address,
            resume=resume, progress=tell,
        )  # fmt: skip
    _say({"sequences": len(manifest["sequences"]), "folder": str(out)}, json_only)
    return 0


def dataset_merge(
    folders: Annotated[
        tuple[Path, ...], tyro.conf.Positional, option("shards of one recipe", "DIR...")
    ],
    *,
    out: Annotated[Path, option("folder, new or empty", "DIR")],
    json_only: Json = False,
) -> int:
    """Join shards of a dataset in one folder."""
    from ..dataset.make import merge

    if not folders:
        raise UserError("give the shards to merge")
    manifest = merge(list(folders), out)
    _say({"sequences": len(manifest["sequences"]), "folder": str(out)}, json_only)
    return 0


def dataset_check(folder: Folder, *, json_only: Json = False) -> int:
    """Verify a dataset: checksums, counts, ranges and physics; names the first bad sample."""
    from ..dataset.check import check

    with _counting("checking") as tell:
        count = check(folder, tell)
    _say({"sequences": count, "whole": True}, json_only)
    return 0


def dataset_info(folder: Folder, *, json_only: Json = False) -> int:
    """Summarise a dataset."""
    from ..dataset.folder import TABLE, open_recipe, read_manifest, tables

    manifest, recipe = read_manifest(folder), open_recipe(folder)
    rows = need("pyarrow.parquet", "data").read_table(folder / TABLE).to_pylist()
    states: dict[str, int] = {}
    for _, table in tables(folder, "frames", ["slip_state"]):
        for state in table["slip_state"].to_pylist():
            states[state] = states.get(state, 0) + 1
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    _say(
        {
            "description": recipe.description,
            "sequences": len(manifest["sequences"]),
            "of": recipe.sequences,
            "frames": sum(states.values()),
            "slip_states": states,
            "drawn": sorted(set(rows[0]) - {"number"}) if rows else [],
            "megabytes": round(size / 1e6, 1),
            "versions": manifest["versions"],
        },
        json_only,
    )
    return 0


def dataset_export(
    folder: Folder,
    *,
    to: Annotated[
        Literal["coco", "lerobot", "tapvid", "webdataset"],
        option("layout", "coco|lerobot|tapvid|webdataset"),
    ],
    out: Annotated[Path, option("folder, new or empty", "DIR")],
    json_only: Json = False,
) -> int:
    """Write a dataset in the layout of another tool."""
    from ..dataset.export import export
    from ..dataset.folder import read_manifest

    with _counting("exporting") as tell:
        tell(0, len(read_manifest(folder)["sequences"]))
        files = export(folder, to, out, tell)
    _say({"files": len(files), "folder": str(out)}, json_only)
    return 0


def dataset_split(
    folder: Folder,
    *,
    shares: Annotated[
        str, option("parts and their shares of the objects", "NAME=SHARE,...")
    ] = "train=0.8,validation=0.1,test=0.1",
    seed: Annotated[int, option("of the order of the objects", "N")] = 0,
    json_only: Json = False,
) -> int:
    """Split a dataset by object, so that the objects of one part are in no other; split.json."""
    from ..dataset.split import split

    told: dict[str, float] = {}
    for part in shares.split(","):
        name, equals, share = part.partition("=")
        try:
            told[name.strip()] = float(share)
        except ValueError:
            equals = ""
        if not equals or not name.strip():
            raise UserError(
                f"--shares {shares}: expected NAME=SHARE,..., such as train=0.9,test=0.1"
            )
    parts = split(folder, told, seed)
    _say({name: len(names) for name, names in parts.items()}, json_only)
    return 0


def _shard(text: str) -> tuple[int, int]:
    first, slash, count = text.partition("/")
    if slash and first.isdecimal() and count.isdecimal() and 1 <= int(first) <= int(count):
        return int(first), int(count)
    raise UserError(f"--shard {text}: expected i/K with i from 1 to K, such as 2/8")


def _say(values: dict[str, object], json_only: bool) -> None:
    if json_only:
        print(json.dumps(values, ensure_ascii=False))
        return
    width = max(map(len, values))
    for name, value in values.items():
        print(f"{name:<{width}}  {value}")


COMMANDS: dict[str, Callable[..., Any]] = {
    "make": dataset_make,
    "check": dataset_check,
    "info": dataset_info,
    "export": dataset_export,
    "split": dataset_split,
    "merge": dataset_merge,
}
