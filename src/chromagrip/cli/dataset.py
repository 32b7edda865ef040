"""The commands `dataset …`: make, check, info, export, split, merge."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import tyro
from msgspec.structs import replace

from ..errors import UserError
from .options import (
    CORES,
    Allow,
    Flag,
    FollowLinks,
    Json,
    Workers,
    check_least,
    counting,
    option,
    print_values,
)

Folder = Annotated[
    str, tyro.conf.Positional, option("folder of a dataset, or its address", "DIR|URL")
]
NewFolder = Annotated[
    str, option("new or empty folder, or an address such as s3://bucket/data", "DIR|URL")
]
#: Largest number of sequences in a dataset.
MOST_SEQUENCES = 10_000_000


def make(
    recipe: Annotated[
        str,
        tyro.conf.Positional,
        option(
            "shipped recipe (force, slip, tiny, tracking; for a dome contact-3d, edges, objects, "
            "twist; for chain and dome benchmark-v2), or a .toml file",
            "RECIPE|FILE.toml",
        ),
    ],
    *,
    out: NewFolder,
    n: Annotated[
        int | None, option("number of sequences, instead of the recipe's", "N", "n")
    ] = None,
    truth: Annotated[
        tuple[Literal["flow", "depth", "masks", "traction", "contact"], ...],
        option(
            "labels of every pixel, in addition to the recipe's; traction and contact need a dome",
            "flow|depth|masks|traction|contact...",
        ),
    ] = (),
    reading: Annotated[
        str | None,
        option(
            "reconstructor whose estimates are stored next to the labels; auto is the default of "
            "each sequence's body",
            "NAME",
        ),
    ] = None,
    meshes: Annotated[
        Path | None, option("folder of meshes to press on a dome, instead of the recipe's", "DIR")
    ] = None,
    allow: Allow = (),
    workers: Workers = CORES,
    shard: Annotated[
        str, option("part to make: every K-th sequence from the i-th on, such as 2/8", "i/K")
    ] = "1/1",
    backend: Annotated[
        Literal["joblib", "dask", "ray"],
        option("library that runs the processes", "joblib|dask|ray"),
    ] = "joblib",
    address: Annotated[
        str, option("address of a running cluster, such as tcp://host:8786", "URL")
    ] = "",
    resume: Annotated[
        Flag, option("continue an interrupted dataset; damaged sequences are made again")
    ] = False,
    json_only: Json = False,
) -> int:
    """Make labelled sequences of pictures from a recipe.

    Sequence k depends on the recipe and k alone: workers, shards and interruptions change no byte.
    The recipe benchmark-v2 is frozen: its digest is printed, and compared with the recorded one.

    Example: chromagrip dataset make tiny --out data
    """
    from ..dataset.folder import CARD, SHEET
    from ..dataset.frozen import seal
    from ..dataset.make import make as make_dataset
    from ..dataset.recipe import load_recipe

    loaded = load_recipe(recipe, meshes, allow=allow)
    if n is not None:
        if not 1 <= n <= MOST_SEQUENCES:
            raise UserError(f"--n {n}: expected 1 to {MOST_SEQUENCES}")
        loaded = replace(loaded, sequences=n)
    loaded = replace(loaded, truth=tuple(dict.fromkeys((*loaded.truth, *truth))))
    if reading is not None:
        loaded = replace(loaded, reading=reading)
    check_least(workers=(workers, 1))
    again: list[str] = []
    try:
        with counting("sequences", transient=False) as progress:
            manifest = make_dataset(
                loaded, out, workers=workers, shard=_shard(shard), backend=backend, address=address,
                resume=resume, progress=progress, damaged=again.extend,
            )  # fmt: skip
    except KeyboardInterrupt:
        print(
            f"chromagrip: what is done is in {out}; the same command with --resume goes on",
            file=sys.stderr,
        )
        raise
    made: dict[str, object] = {"sequences": len(manifest["sequences"]), "folder": str(out)}
    if not json_only:
        made["see"] = f"{CARD} and {SHEET}"
    if resume:
        made["damaged_and_made_again"] = len(again)
    print_values(made | seal(out), json_only)
    return 0


def merge(
    folders: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        option("folders of the shards of one recipe", "DIR..."),
    ],
    *,
    out: NewFolder,
    follow_links: FollowLinks = False,
    json_only: Json = False,
) -> int:
    """Join shards of a dataset in one folder.

    Example: chromagrip dataset merge shard-1 shard-2 --out data
    """
    from ..dataset.make import merge as merge_datasets

    if not folders:
        raise UserError("give the shards to merge")
    manifest = merge_datasets(list(folders), out, follow_links=follow_links)
    print_values({"sequences": len(manifest["sequences"]), "folder": str(out)}, json_only)
    return 0


def check(folder: Folder, *, follow_links: FollowLinks = False, json_only: Json = False) -> int:
    """Verify checksums, columns, ranges and intervals of a dataset; name the first bad sample.

    It tells how many sequences of a frozen recipe are as recorded.

    Example: chromagrip dataset check data
    """
    from ..dataset.check import check as check_dataset
    from ..dataset.frozen import seal

    with counting("checking") as progress:
        count = check_dataset(folder, progress, follow_links=follow_links)
    made = seal(folder, follow_links=follow_links)
    print_values({"sequences": count, "whole": True} | made, json_only)
    return 0


def info(folder: Folder, *, follow_links: FollowLinks = False, json_only: Json = False) -> int:
    """Summarise a dataset.

    Example: chromagrip dataset info data --json
    """
    from ..dataset.read import summarise

    print_values(summarise(folder, follow_links=follow_links), json_only)
    return 0


def export(
    folder: Folder,
    *,
    to: Annotated[
        Literal["coco", "lerobot", "tapvid", "webdataset"],
        option("layout to write", "coco|lerobot|tapvid|webdataset"),
    ],
    out: NewFolder,
    follow_links: FollowLinks = False,
    json_only: Json = False,
) -> int:
    """Write a dataset in the layout of another tool.

    Example: chromagrip dataset export data --to coco --out coco
    """
    from ..dataset.export.layouts import export as export_dataset
    from ..dataset.folder import read_manifest
    from ..dataset.remote import fetched

    with counting("exporting") as progress:
        progress(0, len(read_manifest(fetched(folder, follow_links))["sequences"]))
        files = export_dataset(folder, to, out, progress, follow_links=follow_links)
    print_values({"files": len(files), "folder": str(out)}, json_only)
    return 0


def split(
    folder: Folder,
    *,
    shares: Annotated[
        str, option("name and share of each part", "NAME=SHARE,...")
    ] = "train=0.8,validation=0.1,test=0.1",
    by: Annotated[
        str,
        option(
            "property that no two parts share: shape, object, or a drawn value", "shape|object|KEY"
        ),
    ] = "shape",
    seed: Annotated[int, option("seed of the order", "N")] = 0,
    follow_links: FollowLinks = False,
    json_only: Json = False,
) -> int:
    """Split a dataset so that no two parts share a shape, object, sensor, …; writes split.json.

    It prints the values of each part, and how many shapes are in several parts.

    Example: chromagrip dataset split data --shares train=0.9,test=0.1 --by object
    """
    from ..dataset.remote import fetched
    from ..dataset.split import groups_of
    from ..dataset.split import split as split_dataset
    from ..output.report import Table, table_lines

    check_least(seed=(seed, 0))
    parts = split_dataset(folder, _shares(shares), seed, by=by, follow_links=follow_links)
    counts = {name: len(names) for name, names in parts.items()}
    if json_only:
        print_values(counts, json_only)
        return 0
    there = fetched(folder, follow_links)
    lines = [("sequences", *map(str, counts.values())), *_drawn(there, parts)]
    print(*table_lines(Table(("", *parts), tuple(lines))), sep="\n")
    of = {name: part for part, names in parts.items() for name in names}
    shapes = [{of[name] for name in names} for names in groups_of(there, "shape")]
    if leaking := len(shapes) > 1 and sum(len(own) > 1 for own in shapes):
        print(
            f"{leaking} of {len(shapes)} shapes are in several parts: --by shape keeps each in one"
        )
    return 0


def _drawn(folder: Path, parts: dict[str, list[str]]) -> Iterator[tuple[str, ...]]:
    """Lines of a table: values of each drawn key in each part, of keys with few values."""
    from ..dataset.read import drawn_values
    from ..dataset.recipe import dotted

    few = 12
    rows = {
        part: [dotted(drawn_values(folder / name)) for name in names]
        for part, names in parts.items()
    }
    for key in sorted({key for own in rows.values() for row in own for key in row}):
        found = {
            part: {v if isinstance(v := row.get(key), int | float) else str(v) for row in own}
            for part, own in rows.items()
        }
        if len(set().union(*found.values())) <= few:
            ordered = (sorted(own, key=lambda v: (isinstance(v, str), v)) for own in found.values())
            yield (
                key,
                *(
                    ", ".join(f"{v:g}" if isinstance(v, float) else f"{v}" for v in own)
                    for own in ordered
                ),
            )


def _shares(text: str) -> dict[str, float]:
    shares: dict[str, float] = {}
    for part in text.split(","):
        name, _, share = (word.strip() for word in part.partition("="))
        if name in shares:
            raise UserError(f"--shares {text}: the part {name} is given twice")
        if not name or not share.replace(".", "", 1).isdecimal():
            raise UserError(f"--shares {text}: expected NAME=SHARE,..., such as train=0.9,test=0.1")
        shares[name] = float(share)
    return shares


def _shard(text: str) -> tuple[int, int]:
    first, slash, count = text.partition("/")
    if slash and first.isdecimal() and count.isdecimal() and 1 <= int(first) <= int(count):
        return int(first), int(count)
    raise UserError(f"--shard {text}: expected i/K with i from 1 to K, such as 2/8")
