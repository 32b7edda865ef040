"""Split a dataset by what must not be in two parts: shapes, objects, sensors or any drawn value."""

import json
import math
import os
from pathlib import Path
from zlib import crc32

import msgspec
import numpy as np

from ..errors import UserError, meant
from ..folders import write_whole
from ..strange_files import read_small, shortened
from .folder import TABLE, FileList, Place, read_files, read_manifest, sequence_name
from .labels.tables import damaged, read_rows
from .recipe import Values, dotted
from .remote import SPLIT, fetched, is_address, put

#: Drawn values that make a shape.
_SHAPE = tuple(
    f"object.{key}"
    for key in ("shape", "radius_mm", "profile_mm", "size_mm", "rounding_mm", "mesh", "surface")
)
#: Most values of a key that are told apart in a table of parts.
_FEW = 12


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
    by: `shape` (radius, profile, size, mesh), `object` (every drawn value of `object.…`), or the
        key of a drawn value, such as `sensor` or `camera.noise_levels`
    follow_links: whether links in the folder may lead out of it, as in caches of hubs

    Raises
    ------
    UserError
        When shares do not add up, a part has a name that no folder can have, the dataset is
        damaged, nothing of that name was drawn, or there are fewer groups than parts.
    """
    for name in shares:
        _check_part(name, "shares")
    if abs(sum(shares.values()) - 1.0) > 1e-9 or min(shares.values()) <= 0.0:
        given = ", ".join(f"{name} {share:g}" for name, share in shares.items())
        raise UserError(f"shares must be above 0 and add up to 1, got {given}")
    address, folder = folder, fetched(folder, follow_links)
    rows = _drawn_in(folder)
    groups = _groups(rows, by)
    if by == "shape" and len(groups) == 1:
        by, groups = "object", _groups(rows, "object")
    keys = sorted(groups)
    if len(keys) < len(shares):
        advice = "; by object there may be more" if by == "shape" else ""
        raise UserError(
            f"{folder} differs in {len(keys)} of {by}, too few for {len(shares)} parts{advice}"
        )
    order = np.random.default_rng([seed, crc32(b"split")]).permutation(len(keys))
    parts = _filled([groups[keys[at]] for at in order], shares)
    write_whole(folder / SPLIT, (json.dumps(parts, indent=1) + "\n").encode())
    if is_address(address):
        put(folder / SPLIT, os.fspath(address))
    return parts


def _filled(groups: list[list[str]], shares: dict[str, float]) -> dict[str, list[str]]:
    """Parts with whole groups: each, the largest first, goes where the most names are lacking."""
    parts: dict[str, list[str]] = {name: [] for name in shares}
    total = sum(map(len, groups))
    for k, group in enumerate(sorted(groups, key=len, reverse=True)):
        empty = [name for name, names in parts.items() if not names]
        open_to = empty if len(groups) - k <= len(empty) else shares
        parts[max(open_to, key=lambda name: shares[name] * total - len(parts[name]))] += group
    return {name: sorted(names) for name, names in parts.items()}


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


def drawn_row(listed: FileList) -> Values:
    """Number and drawn values of a sequence; JSON holds infinity as text."""
    values = {k: float(v) if v in ("inf", "-inf") else v for k, v in listed["values"].items()}
    return {"number": listed["number"], **values}


def drawn_rows(folder: Path, names: list[str]) -> list[Values]:
    """Read the values drawn for each sequence of a dataset, with its `number`.

    They are in each sequence's own file too, which is read where the table is not Parquet.

    Raises
    ------
    UserError
        When they are damaged or have other sequences.
    """
    path = folder / TABLE
    if not path.is_file():
        return [drawn_row(read_files(folder / name)) for name in names]
    rows = read_rows(path, len(names), {"number": "int64"})
    if sorted(sequence_name(row["number"]) for row in rows) != sorted(names):
        raise damaged(path, "it is not of the sequences of the dataset")
    return rows


def _drawn_in(folder: Path) -> dict[str, Values]:
    """Drawn values of each sequence by its name; those of a table by their own keys."""
    rows = drawn_rows(folder, list(read_manifest(folder)["sequences"]))
    # Of tables with unlike keys, Parquet gives each the keys of all.
    return {
        sequence_name(row["number"]): {
            key: value
            for key, value in dotted(row).items()
            if value is not None and key != "number"
        }
        for row in rows
    }


def _groups(rows: dict[str, Values], by: str) -> dict[str, list[str]]:
    """Names of the sequences that are equal in what `by` names."""
    drawn = sorted({key for row in rows.values() for key in row})
    keys = {
        "object": [key for key in drawn if key.split(".")[0] == "object"],
        "shape": [key for key in drawn if key in _SHAPE],
    }.get(by, [key for key in drawn if key == by])
    if not keys and by not in ("object", "shape"):
        known = ["shape", "object", *drawn]
        raise UserError(
            f"nothing called {by} was drawn{meant(by, known)}; there is {', '.join(known)}"
        )
    found: dict[str, list[str]] = {}
    for name, row in rows.items():
        own = {key: row.get(key) for key in keys}
        found.setdefault(json.dumps(own, default=repr), []).append(name)
    return found


def values_of_parts(folder: Path, parts: dict[str, list[str]]) -> dict[str, dict[str, list[str]]]:
    """Values of each drawn key in each part, of keys with few values; by key, then by part."""
    by_name = _drawn_in(folder)
    found = {}
    for key in sorted({key for row in by_name.values() for key in row}):
        values = {
            part: sorted({_text(by_name[name].get(key)) for name in names}, key=_order)
            for part, names in parts.items()
        }
        if len({value for each in values.values() for value in each}) <= _FEW:
            found[key] = values
    return found


def shared_shapes(folder: Path, parts: dict[str, list[str]]) -> list[str]:
    """A sentence for the shapes that each set of parts of a dataset has in common, if any."""
    rows = _drawn_in(folder)
    groups = _groups(rows, "shape").values()
    if len(groups) < 2:  # all have one shape
        return []
    among: dict[str, list[str]] = {}  # shapes that the same parts have
    for names in groups:
        both = [part for part, own in parts.items() if not set(own).isdisjoint(names)]
        if len(both) > 1:
            among.setdefault(" and ".join(both), []).append(_shape_text(rows[names[0]]))
    return [
        f"{'; '.join(sorted(shapes))} {'is' if len(shapes) == 1 else 'are each'} in {both}"
        for both, shapes in among.items()
    ]


def _shape_text(row: Values) -> str:
    """Drawn values that make the shape of a sequence."""
    own = {key.removeprefix("object."): row[key] for key in _SHAPE if key in row}
    return ", ".join(f"{name} {_text(value)}" for name, value in own.items())


def _order(text: str) -> tuple[float, str]:
    """Numbers by their size, then texts."""
    try:
        return float(text), ""
    except ValueError:
        return math.inf, text


def _text(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
