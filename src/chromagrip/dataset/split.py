"""Split a dataset by what must not be in two parts: shapes, objects, sensors or any drawn value."""

import json
import os
from pathlib import Path
from zlib import crc32

import numpy as np

from ..errors import UserError, meant
from ..folders import write_whole
from .folder import SPLIT, Place, read_manifest
from .read import check_parts, drawn_values
from .recipe import dotted
from .remote import fetched, send_file

#: Drawn values of an object that make its shape.
_SHAPE = ("shape", "radius_mm", "profile_mm", "size_mm", "rounding_mm", "mesh", "surface")


def split(
    folder: Place,
    shares: dict[str, float],
    seed: int = 0,
    *,
    by: str = "shape",
    follow_links: bool = False,
) -> dict[str, list[str]]:
    """Split a dataset into parts, and write split.json; returns the sequences' names by part.

    Sequences that are equal in what `by` names are in one part. Where all have one shape, `shape`
    is the same as `object`.

    Parameters
    ----------
    folder: folder of the dataset, or its address
    shares: share of each part, by name, adding up to 1
    seed: seed of the order of the groups (default 0)
    by: `shape`, `object` (every drawn value of `object.…`), or the key of a drawn value
    follow_links: whether links in the folder may lead out of it, as in caches of hubs

    Raises
    ------
    UserError
        For shares that do not add up, a part that no folder can be called, a damaged dataset, an
        unknown key, or fewer groups than parts.
    """
    check_parts(shares, "shares")
    if abs(sum(shares.values()) - 1.0) > 1e-9 or min(shares.values()) <= 0.0:
        given = ", ".join(f"{name} {share:g}" for name, share in shares.items())
        raise UserError(f"shares must be above 0 and add up to 1, got {given}")
    folder, address = fetched(folder, follow_links), os.fspath(folder)
    groups = groups_of(folder, by)
    if by == "shape" and len(groups) == 1:
        by, groups = "object", groups_of(folder, "object")
    if len(groups) < len(shares):
        few = f"{len(groups)} of {by}, too few for {len(shares)} parts"
        raise UserError(f"{folder} differs in {few}")
    order = np.random.default_rng([seed, crc32(b"split")]).permutation(len(groups))
    parts: dict[str, list[str]] = {name: [] for name in shares}
    total = sum(map(len, groups))
    # Each group, the largest first, goes where the most sequences are lacking.
    for k, group in enumerate(sorted([groups[at] for at in order], key=len, reverse=True)):
        empty = [name for name, names in parts.items() if not names]
        open_to = empty if len(groups) - k <= len(empty) else shares
        parts[max(open_to, key=lambda name: shares[name] * total - len(parts[name]))] += group
    parts = {name: sorted(names) for name, names in parts.items()}
    write_whole(folder / SPLIT, (json.dumps(parts, indent=1) + "\n").encode())
    send_file(folder / SPLIT, address)
    return parts


def groups_of(folder: Path, by: str) -> list[list[str]]:
    """Names of the sequences that are equal in what `by` names, as in `split`."""
    names = read_manifest(folder)["sequences"]
    rows = {name: dotted(drawn_values(folder / name)) for name in names}
    drawn = sorted({key for row in rows.values() for key in row})
    whole = [key for key in drawn if key.split(".")[0] == "object"]
    shape = [key for key in whole if key.removeprefix("object.") in _SHAPE]
    own = {"shape": shape, "object": whole}
    keys = own.get(by, [by])
    if by not in (known := [*own, *drawn]):
        question = meant(by, known)
        raise UserError(f"nothing called {by} was drawn{question}; there is {', '.join(known)}")
    found: dict[str, list[str]] = {}
    for name, row in rows.items():
        equal = json.dumps({key: row.get(key) for key in keys}, default=repr)
        found.setdefault(equal, []).append(name)
    return [found[key] for key in sorted(found)]
