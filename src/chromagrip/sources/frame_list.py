"""List of the pictures in a folder with the time of each: `frames.csv`."""

import csv
import math
from collections.abc import Collection
from pathlib import Path

from ..errors import UserError

#: Name of the list in a folder of pictures.
FRAME_LIST = "frames.csv"
_MEND = "; mend the list or remove it"


def read_list(path: Path) -> list[tuple[float, str]]:
    """Time of each picture in a list [s], and the file that it is in.

    Raises
    ------
    UserError
        When it cannot be read, lacks a column or a value, or has times that do not increase.
    """
    listed: list[tuple[float, str]] = []
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = csv.DictReader(file)
            if not {"time_s", "file"} <= {*(rows.fieldnames or ())}:
                there = ", ".join(rows.fieldnames or ()) or "none"
                raise UserError(f"{path} has the columns {there}; wanted: time_s [s] and file")
            last = -math.inf
            for row in rows:
                name, time = row["file"], _seconds(row["time_s"])
                place = f"{path}, line {rows.line_num}"
                if not name:
                    raise UserError(f"{place} names no file; wanted: a line for each picture")
                if not last < time < math.inf:
                    raise UserError(
                        f"{place} has the time_s {row['time_s']!r}, after {last:g} s; wanted: "
                        "times that increase"
                    )
                listed.append((last := time, name))
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror}") from None
    except (ValueError, csv.Error) as error:
        raise UserError(f"{path} cannot be read as a list of pictures: {error}") from None
    return listed


def times_of(path: Path, files: Collection[Path], there: Collection[Path]) -> dict[Path, float]:
    """Times of pictures by the list in their folder, in its order [s].

    Parameters
    ----------
    path: of the list
    files: pictures that are read
    there: all files of the folder; the list may name others than those that are read

    Raises
    ------
    UserError
        When the list cannot be used, or does not have the pictures that are there.
    """
    listed: dict[str, float] = {}
    names, wanted = {each.name for each in there}, {each.name: each for each in files}
    for time, name in read_list(path):
        if name not in names or name in listed:
            why = "twice" if name in listed else "which is not in its folder"
            raise UserError(f"{path} names {name}, {why}{_MEND}")
        listed[name] = time
    lacking = [name for name in wanted if name not in listed]
    if lacking:
        raise UserError(
            f"{path} has no line for {len(lacking)} of {len(files)} pictures, such as "
            f"{lacking[0]}{_MEND}"
        )
    return {wanted[name]: time for name, time in listed.items() if name in wanted}


def _seconds(text: str | None) -> float:
    """Number of a text; NaN if it is none."""
    try:
        return float(text or "nan")
    except ValueError:
        return math.nan
