"""Split of a dataset by object: no object is in two parts."""

import json
import os
from pathlib import Path
from zlib import crc32

import msgspec
import numpy as np

from ..errors import UserError
from ..extras import need
from ..output.folder import write_whole
from .folder import TABLE, Place, read_manifest, sequence_name
from .recipe import Values
from .remote import SPLIT, fetched, is_address, put


def split(folder: Place, shares: dict[str, float], seed: int = 0) -> dict[str, list[str]]:
    """Names of the sequences of each part, which are written to split.json too.

    All sequences of one object (equal in every drawn value of `object.…`) are in one part.

    Parameters
    ----------
    folder: of the dataset
    shares: of each part, adding up to 1
    seed: of the order of the objects

    Raises
    ------
    UserError
        When shares do not add up, or there are fewer objects than parts.
    """
    if abs(sum(shares.values()) - 1.0) > 1e-9 or min(shares.values()) <= 0.0:
        given = ", ".join(f"{name} {share:g}" for name, share in shares.items())
        raise UserError(f"shares must be above 0 and add up to 1, got {given}")
    address, folder = folder, fetched(folder)
    read_manifest(folder)
    pq = need("pyarrow.parquet", "data")
    objects = _objects(pq.read_table(folder / TABLE).to_pylist())
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
    """Names of the sequences of each part; of a dataset that is not split there are no parts.

    Raises
    ------
    UserError
        When the parts are not those of the dataset as it is now.
    """
    path = folder / SPLIT
    if not path.is_file():
        return {}
    try:
        parts = msgspec.json.decode(path.read_bytes(), type=dict[str, list[str]])
    except (OSError, msgspec.DecodeError):
        raise UserError(f"{path} is damaged; make it anew with dataset split") from None
    named = sorted(name for names in parts.values() for name in names)
    if named != sorted(read_manifest(folder)["sequences"]):
        raise UserError(
            f"{path} does not have each sequence of the dataset once; make it anew with "
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


def _objects(rows: list[Values]) -> dict[str, list[int]]:
    """Numbers of the sequences of each object, by what was drawn of it."""
    found: dict[str, list[int]] = {}
    for row in rows:
        own = {key: value for key, value in sorted(row.items()) if key.split(".")[0] == "object"}
        found.setdefault(json.dumps(own), []).append(row["number"])
    return found
