"""Results of many runs in a CSV file, one line for each run, so that interrupted work resumes."""

import csv
from collections.abc import Callable, Generator, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, TypeVar

from ..errors import UserError
from ..folders import prepared, whole_file

Cell = TypeVar("Cell")
Key = TypeVar("Key", bound=Hashable)


def write_cells(
    cells: Sequence[Any], path: Path, more: Callable[[Any], Mapping[str, Any]] = lambda cell: {}
) -> None:
    """Write dataclasses of text and numbers, at least one; the file is never half written.

    Parameters
    ----------
    cells: what one names as `foreign` to it is empty in its line
    more: columns behind those of a cell
    """
    with whole_file(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(
            file, [*(field.name for field in fields(cells[0])), *more(cells[0])]
        )
        writer.writeheader()
        for cell in cells:
            foreign = dict.fromkeys(getattr(cell, "foreign", ()), "")
            writer.writerow({**asdict(cell), **foreign, **more(cell)})


def read_cells(path: Path | None, kind: type[Cell]) -> Iterator[Cell]:
    """Dataclasses of a file that `write_cells` wrote; none if there is no file.

    Raises
    ------
    UserError
        When it is damaged.
    """
    if path is None or not path.exists():
        return
    # Types of the fields are the converters: str, int and float.
    kinds: dict[str, Any] = {field.name: field.type for field in fields(kind)}  # type: ignore[arg-type]
    lines = 1
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file, strict=True)
            if reader.fieldnames is not None and set(reader.fieldnames) - set(kinds):
                raise ValueError
            for line in reader:
                lines = reader.line_num
                yield kind(**{name: kinds[name](text) for name, text in line.items()})
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror}") from None
    except (KeyError, TypeError, ValueError, csv.Error):
        raise UserError(
            f"{path}, line {lines}, is no result of this work (columns {', '.join(kinds)}); remove "
            "the line or the file, and it is made again"
        ) from None


@contextmanager
def unfinished_in(out: Path | None, name: str, overwrite: bool) -> Iterator[Path | None]:
    """File of the cells of unfinished work in an output folder, which is made and held.

    Parameters
    ----------
    out: folder; None writes nothing
    name: of the file; where there is one, the work resumes
    overwrite: whether the folder may hold files

    Raises
    ------
    UserError
        When the folder holds finished results and may not be overwritten.
    """
    file = None if out is None else out / name
    with prepared(out, overwrite or (file is not None and file.exists())):
        yield file


def resumed(
    path: Path | None,
    done: Iterable[Cell],
    key: Callable[[Cell], Key],
    wanted: Sequence[Key],
    run: Callable[[list[Key]], Generator[Cell]],
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[Key, Cell]:
    """Cell of each key: one that was done before, or else a new one.

    Parameters
    ----------
    path: file that gets every cell as soon as it is done; None writes nothing
    done: cells of interrupted work, of any keys
    key: of a cell
    wanted: keys
    run: makes the cells of some keys, in any order
    progress: called with the numbers of cells that are done and wanted, first and after each cell
    """
    before = {key(cell): cell for cell in done}
    cells = {one: before[one] for one in wanted if one in before}
    progress(len(cells), len(wanted))
    with closing(run([one for one in wanted if one not in cells])) as results:
        for cell in results:
            cells[key(cell)] = cell
            if path is not None:
                write_cells(list(cells.values()), path)
            progress(len(cells), len(wanted))
    return {one: cells[one] for one in wanted}
