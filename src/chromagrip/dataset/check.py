"""Verification of a dataset: its files, the columns of its tables, and ranges of their values."""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from .folder import FILES, TABLE, Place, open_recipe, read_files, sequence_name
from .labels import INTERVALS, Column, columns_of
from .labels.tables import damaged, read_rows
from .read import Loaded, check_shared, verified
from .remote import fetched
from .sequence import was_drawn


def check(
    folder: Place,
    progress: Callable[[int, int], None] = lambda done, total: None,
    *,
    follow_links: bool = False,
) -> int:
    """Verify a dataset's checksums, columns, ranges and intervals; returns its sequence count.

    Parameters
    ----------
    folder: folder of the dataset, or its address
    progress: function called with the number of sequences checked and of all
    follow_links: whether links in the folder may lead out of it, as in caches of hubs

    Raises
    ------
    UserError
        For the first wrong sample, with the reason.
    """
    folder = fetched(folder, follow_links)
    manifest = check_shared(folder)
    recipe = open_recipe(folder)
    names = manifest["sequences"]
    rows = read_rows(folder / TABLE, len(names), {"number": "int64"})
    if sorted(sequence_name(row["number"]) for row in rows) != sorted(names):
        raise damaged(folder / TABLE, "it is not of the sequences of the dataset")
    for done, (name, one) in enumerate(zip(names, verified(folder), strict=True)):
        if read_files(folder / name)["versions"] != manifest["versions"]:
            raise UserError(f"{folder / name} was made with other versions than the rest")
        if one.number >= recipe.sequences:
            raise UserError(f"{folder / name} is not sequence {one.number} of its recipe")
        if not was_drawn(recipe, one.number, one.values, folder / name):
            raise UserError(
                f"{folder / name / FILES} is damaged: values are not those that the recipe draws"
            )
        for wrong in _wrong(one, bool(recipe.reading)):
            raise UserError(f"{folder / name}, {wrong}")
        progress(done + 1, len(names))
    return len(names)


def _wrong(one: Loaded, reading: bool) -> Iterator[str]:
    """Yield what is wrong with a sequence whose files are whole: file, frame, column and value.

    Parameters
    ----------
    reading: whether a reconstructor's estimates are stored with the labels
    """
    columns = columns_of(one.scene.body, reading)
    if list(one.frames) != list(columns.frame):
        yield f"frames.parquet: columns {list(one.frames)}, expected {list(columns.frame)}"
        return
    if len(one.pictures) != one.scene.frames:
        yield f"{len(one.pictures)} pictures; the scene has {one.scene.frames} frames"
        return
    for index in range(one.scene.frames):
        try:
            _ = one.pictures[index]
        except UserError as error:
            yield f"frame {index}: the picture cannot be read: {error}"
    for name, column in columns.frame.items():
        yield from _out_of_range(f"frames.parquet, frame {{}}: {name}", column, one.frames[name])
    for name, column in (columns.markers | columns.nodes).items():
        yield from _out_of_range(f"markers.parquet, frame {{}}: {name}", column, one.markers[name])
    for low, value, high in INTERVALS.values() if reading else ():
        ends = one.frames[low], one.frames[value], one.frames[high]
        for k in np.flatnonzero((ends[0] > ends[1]) | (ends[1] > ends[2]))[:1]:
            yield (
                f"frames.parquet, frame {k}: {value} is {ends[1][k]:g}, outside of its interval, "
                f"{low} = {ends[0][k]:g} to {high} = {ends[2][k]:g}"
            )


def _out_of_range(where: str, column: Column, values: NDArray[np.generic]) -> Iterator[str]:
    """Yield a message on the first value that is not finite, or out of a column's range.

    Parameters
    ----------
    where: start of the message, with {} for the number of the frame
    """
    if values.dtype.kind not in "if":
        return
    rounding = 1e-6  # of float32
    numbers = values.astype(float)
    fits = (numbers >= column.low - rounding) & (numbers <= column.high + rounding)
    fits &= np.isfinite(numbers)
    if column.missing:
        fits |= np.isnan(numbers)
    for at in np.argwhere(~fits)[:1]:
        cell = "".join(f"[{index}]" for index in at[1:])
        allowed = f"{column.low:g} to {column.high:g}" + (", or NaN" if column.missing else "")
        yield f"{where.format(at[0])}{cell} is {numbers[tuple(at)]:g}; allowed: {allowed}"
