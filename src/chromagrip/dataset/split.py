"""Split a dataset by object: no object is in two parts."""

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING
from zlib import crc32

import msgspec
import numpy as np

from ..errors import UserError
from ..extras import need
from ..folders import write_whole
from ..strange_files import read_small, shortened
from .folder import TABLE, Place, read_manifest, sequence_name
from .labels.tables import damaged, read_table
from .recipe import Values
from .remote import SPLIT, fetched, is_address, put

if TYPE_CHECKING:
    import pyarrow as pa


def split(
    folder: Place, shares: dict[str, float], seed: int = 0, *, follow_links: bool = False
) -> dict[str, list[str]]:
    """Split a dataset into parts, and write split.json; returns the sequences' names by part.

    All sequences of one object (equal in every drawn value of `object.…`) are in one part.

    Parameters
    ----------
    folder: folder of the dataset, or its address
    shares: share of each part, by name, adding up to 1
    seed: seed of the order of the objects (default 0)
    follow_links: whether links in the folder may lead out of it, as in caches of hubs

    Raises
    ------
    UserError
        When shares do not add up, a part has a name that no folder can have, the dataset is
        damaged, or there are fewer objects than parts.
    """
    for name in shares:
        _check_part(name, "shares")
    if abs(sum(shares.values()) - 1.0) > 1e-9 or min(shares.values()) <= 0.0:
        given = ", ".join(f"{name} {share:g}" for name, share in shares.items())
        raise UserError(f"shares must be above 0 and add up to 1, got {given}")
    address, folder = folder, fetched(folder, follow_links)
    objects = _objects(drawn_table(folder, list(read_manifest(folder)["sequences"])).to_pylist())
    keys = sorted(objects)
    if len(keys) < len(shares):
        raise UserError(f"{folder} has {len(keys)} objects, too few for {len(shares)} parts")
    order = np.random.default_rng([seed, crc32(b"split")]).permutation(len(keys))
    ends = np.rint(np.cumsum(list(shares.values())) * len(keys)).astype(int)
    # Every part has at least one object.
    for k in range(len(ends)):
        ends[k] = min(max(ends[k], k + 1), len(keys) - (len(ends) - 1 - k))
    parts = {
        name: sorted(sequence_name(n) for at in order[low:high] for n in objects[keys[at]])
        for name, low, high in zip(shares, [0, *ends[:-1]], ends, strict=True)
    }
    write_whole(folder / SPLIT, (json.dumps(parts, indent=1) + "\n").encode())
    if is_address(address):
        put(folder / SPLIT, os.fspath(address))
    return parts


def read_split(folder: Path) -> dict[str, list[str]]:
    """Read the names of the sequences of each part; empty for a dataset that is not split.

    Raises
    ------
    UserError
        When the parts do not have each sequence of the dataset once.
    """
    path = folder / SPLIT
    if not path.is_file():
        return {}
    try:
        parts = msgspec.json.decode(read_small(path), type=dict[str, list[str]])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        raise UserError(f"{path} is damaged; make it again with dataset split") from None
    for name in parts:
        _check_part(name, str(path))
    named = sorted(name for names in parts.values() for name in names)
    if named != sorted(read_manifest(folder)["sequences"]):
        raise UserError(
            f"{path} does not have each sequence of the dataset once; make it again with "
            "dataset split"
        )
    return parts


def names_of(folder: Path, part: str) -> list[str]:
    """Names of the sequences of a part.

    Raises
    ------
    UserError
        When there is no such part.
    """
    parts = read_split(folder)
    if part not in parts:
        there = f"it has {', '.join(parts)}" if parts else "it is not split, see dataset split"
        raise UserError(f"{folder} has no part {part!r}; {there}")
    return parts[part]


def _check_part(name: str, where: str) -> None:
    """Refuse a name that leads elsewhere: the parts of an export are folders."""
    if name in ("", ".", "..") or not name.isprintable() or set(name) & set("/\\"):
        raise UserError(f"{where}: a part cannot be called {shortened(name)}")


def drawn_table(folder: Path, names: list[str]) -> "pa.Table":
    """Read the table of the values drawn for each sequence of a dataset.

    Raises
    ------
    UserError
        When it is damaged or has other sequences.
    """
    table = read_table(
        folder / TABLE, len(names), {"number": need("pyarrow", "data").int64()}, others=True
    )
    numbers = sorted(table["number"].to_pylist())
    if [sequence_name(number) for number in numbers] != sorted(names):
        raise damaged(folder / TABLE, "it is not of the sequences of the dataset")
    return table


def _objects(rows: list[Values]) -> dict[str, list[int]]:
    """Numbers of the sequences of each object, by the values drawn for it."""
    found: dict[str, list[int]] = {}
    for row in rows:
        own = {key: value for key, value in sorted(row.items()) if key.split(".")[0] == "object"}
        found.setdefault(json.dumps(own, default=repr), []).append(row["number"])
    return found
