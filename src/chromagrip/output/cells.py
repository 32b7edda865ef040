"""Points of a map in a CSV file, one line each, so that an interrupted map can go on."""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, TypeVar

Cell = TypeVar("Cell")


def write_cells(cells: Sequence[Any], path: Path) -> None:
    """Write dataclasses of text and numbers, at least one."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(cells[0])])
        writer.writeheader()
        writer.writerows(asdict(cell) for cell in cells)


def read_cells(path: Path, kind: type[Cell]) -> Iterator[Cell]:
    """Dataclasses of a file that `write_cells` wrote; none if there is no file."""
    if not path.exists():
        return
    # Types of the fields are the converters: str, int and float.
    kinds: dict[str, Any] = {field.name: field.type for field in fields(kind)}  # type: ignore[arg-type]
    with path.open(newline="", encoding="utf-8") as file:
        for line in csv.DictReader(file):
            yield kind(**{name: kinds[name](text) for name, text in line.items()})
