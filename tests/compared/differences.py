"""What differs between the results of two commits, and by how much."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .computing import Result
from .digests import read_columns, read_entries, read_pixels

#: Kinds of a difference.
CHANGED, NEW, GONE = "changed", "new", "gone"


@dataclass(frozen=True)
class Difference:
    """One difference.

    Attributes
    ----------
    kind: `CHANGED`; `NEW`, where only the later commit has it; or `GONE`
    text: job, file and part, and how much
    """

    kind: str
    text: str

    def __str__(self) -> str:
        return f"{self.kind:<7}  {self.text}"


def differences(old: Result, new: Result) -> Iterator[Difference]:
    """Differences between the results of a job in two commits.

    A job that fails in both is one, too: it shows nothing.
    """
    name = old.folder.name
    if old.failed or new.failed:
        how = "fails in both" if old.failed and new.failed else "fails"
        how = how if new.failed else "no longer fails"
        yield Difference(CHANGED, f"{name}: {how}: {new.failed or old.failed}")
        return
    for file in sorted({*old.files, *new.files}):
        one, other = old.files.get(file), new.files.get(file)
        if one is None or other is None:
            yield Difference(NEW if one is None else GONE, f"{name}: {file}")
            continue
        much = _how_much(old.folder / file, new.folder / file)
        for part in {**one, **other}:
            if part not in one or part not in other:
                yield Difference(NEW if part in other else GONE, f"{name}: {file}: {part}")
            elif one[part] != other[part]:
                yield Difference(CHANGED, f"{name}: {file}: {part}{much(part)}")


def _how_much(one: Path, other: Path) -> Callable[[str], str]:
    """Tells how much a part of two files differs; the files are read when it is asked."""
    columns = dict.fromkeys((".parquet", ".csv"), read_columns)
    entries = dict.fromkeys((".json", ".toml"), read_entries)
    read = {**columns, **entries}.get(one.suffix)

    def tell(part: str) -> str:
        if part == "pixels" and one.suffix == ".png":
            return _distance(read_pixels(one), read_pixels(other))
        if read is None:
            return ""
        pair = [read(file)[part] for file in (one, other)]
        if one.suffix in entries:
            return f": {pair[0]!r:.60} and {pair[1]!r:.60}"
        return _distance(*map(_numbers, pair))

    return tell


def _numbers(column: Any) -> np.ndarray[Any, Any] | None:
    """Numbers of a column, NaN where there is none; None where it holds words."""
    if not isinstance(column, list):
        column = column.to_pylist()
    values = [inner for each in column for inner in (each if isinstance(each, list) else [each])]
    try:
        return np.array([math.nan if v in (None, "") else float(v) for v in values])
    except (TypeError, ValueError):
        return None


def _distance(one: np.ndarray[Any, Any] | None, other: np.ndarray[Any, Any] | None) -> str:
    if one is None or other is None:
        return ""
    if one.shape != other.shape:
        return f": of {one.shape} and {other.shape}"
    missing = np.count_nonzero(np.isnan(one) != np.isnan(other))
    gaps = f", {missing} are missing in one" if missing else ""
    apart = np.abs(one.astype(float) - other.astype(float))
    return f": up to {np.nanmax(apart, initial=0.0):.2g}{gaps}"
