"""Summary of a dataset: the table of its sequences, its card, and a sheet of its pictures."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..extras import need
from ..output.folder import write_whole
from ..output.png import encode_png
from .folder import (
    CARD,
    SHEET,
    TABLE,
    read_files,
    sequence_name,
    to_parquet,
)
from .labels import COMMON, STATES, columns_of
from .labels.reading import reading_lines
from .pictures import pictures_in
from .read import tables
from .recipe import CASE, Case, Recipe, Values, bodies_of, dotted

if TYPE_CHECKING:
    import pyarrow as pa

#: Columns of frames whose histograms the card shows.
_COUNTED = ("normal_n", "friction_n", "mu", "margin", "slipped_share")
#: Bins of a histogram.
_BINS = 10
#: Characters of its longest bar.
_WIDTH = 30
#: Relative difference that is rounding.
_ROUNDING = 1e-9
#: Pictures in a row of the sheet.
_ACROSS = 4
#: Rows of the sheet.
_DOWN = 3
#: Width of a picture on the sheet [px].
_PICTURE = 240


def write_card(folder: Path, recipe: Recipe, numbers: list[int]) -> None:
    """Write the table, DATASET_CARD.md and contact-sheet.png."""
    drawn = [read_files(folder / sequence_name(number))["values"] for number in numbers]
    write_whole(folder / TABLE, to_parquet(_table(numbers, drawn)))
    columns = [*_COUNTED, "slip_state"]
    parts: dict[str, list[Any]] = {name: [] for name in columns}
    for _, table in tables(folder, "frames", columns):
        for name in columns:
            parts[name].append(table[name].combine_chunks())
    pa = need("pyarrow", "data")
    values = {name: pa.chunked_array(parts[name]) for name in columns}
    read = reading_lines(recipe.reading, (table for _, table in tables(folder, "frames")))
    write_whole(folder / CARD, _card(recipe, drawn, values, read).encode())
    write_whole(folder / SHEET, encode_png(_sheet(folder, numbers)))


def _table(numbers: list[int], drawn: list[Values]) -> "pa.Table":
    pa = need("pyarrow", "data")
    columns = {"number": pa.array(numbers, pa.int64())}
    for key in sorted({key for values in drawn for key in values}):
        column = [values.get(key) for values in drawn]  # a key may be of some cases alone
        # JSON holds infinity as text.
        columns[key] = pa.array([float(v) if v in ("inf", "-inf") else v for v in column])
    return pa.table(columns)


def _card(
    recipe: Recipe, drawn: list[Values], values: "dict[str, pa.ChunkedArray]", read: list[str]
) -> str:
    counted = values.pop("slip_state").value_counts().to_pylist()
    states = {one["values"]: one["counts"] for one in counted}
    bodies = bodies_of(recipe)
    motions = [str(one.get("motion", "press")) for one in drawn]
    lines = [
        "# Dataset card",
        "",
        recipe.description,
        "",
        f"{len(drawn)} sequences, {sum(states.values())} frames, made by chromagrip: simulated "
        "pictures of a fingertip with two layers of coloured markers, with what is true of them.",
        "",
        *_counts("case", [one[CASE] for one in drawn if CASE in one]),
        *_counts("motion", motions),
        "| slip state | frames |",
        "|---|---|",
        *(f"| {name} | {states.get(name, 0)} |" for name in STATES),
        "",
    ]
    for name, column in values.items():
        lines += [f"`{name}`: {COMMON[name]}", "", "```", *_histogram(column), "```", ""]
    lines += [
        *read,
        "![pictures](contact-sheet.png)",
        "",
    ]
    for body in bodies:
        frame, markers, nodes = columns_of(body, bool(recipe.reading))
        of = f", body {body}" if len(bodies) > 1 else ""
        lines += [
            f"## Columns of `frames.parquet`{of}",
            "",
            *(f"- `{name}`: {text}" for name, text in frame.items()),
            "",
            f"## Columns of `markers.parquet`{of}",
            "",
            *(f"- `{name}`: {text}" for name, text in markers.items()),
            *(f"- `{name}`: {text}" for name, text in nodes.items()),
            "",
        ]
    lines += ["## What was drawn", "", *_draws(recipe)]
    for case in recipe.cases:
        said = [f"- `{key}` = {value}" for key, value in dotted(case.scene).items()]
        lines += ["", f"### Case {case.name}", "", *said, *_draws(case)]
    return "\n".join(lines) + "\n"


def _draws(part: Recipe | Case) -> list[str]:
    return [
        f"- `{key}`: {kind} {numbers}"
        for key, how in part.draw.items()
        for kind, numbers in how.items()
    ]


def _counts(what: str, names: list[str]) -> list[str]:
    """Table of the sequences of each name; nothing where there are none."""
    if not names:
        return []
    lines = [f"| {name} | {names.count(name)} |" for name in sorted(set(names))]
    return [f"| {what} | sequences |", "|---|---|", *lines, ""]


def _histogram(column: "pa.ChunkedArray") -> list[str]:
    values = column.to_numpy()
    there = values[np.isfinite(values)]
    if not len(there):
        return ["nothing"]
    # Values that differ by rounding alone are one; all are newtons, or shares.
    alike = np.ptp(there) <= _ROUNDING * max(abs(there).max(), 1.0)
    around = (there[0] - 0.5, there[0] + 0.5) if alike else None
    counts, edges = np.histogram(there, _BINS, around)
    bars = np.rint(_WIDTH * counts / max(counts.max(), 1)).astype(int)
    return [
        f"{low:8.3g} … {high:8.3g}  {'#' * bar} {count}"
        for low, high, bar, count in zip(edges, edges[1:], bars, counts, strict=False)
    ]


def _size(image: NDArray[Any]) -> tuple[int, int]:
    """Width and height of a picture on the sheet [px]."""
    return _PICTURE, round(_PICTURE * image.shape[0] / image.shape[1])


def _sheet(folder: Path, numbers: list[int]) -> NDArray[np.uint8]:
    """Last pictures of some sequences, side by side."""
    chosen = np.linspace(0, len(numbers) - 1, _ACROSS * _DOWN, dtype=int)
    small: list[NDArray[np.uint8]] = []
    for at in dict.fromkeys(chosen):
        image = pictures_in(folder / sequence_name(numbers[at]))[-1]
        # Pictures of other sensors take the shape of the first one.
        size = small[0].shape[1::-1] if small else _size(image)
        small.append(np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8))
    blank = np.full_like(small[0], 255)
    rows = [small[k : k + _ACROSS] for k in range(0, len(small), _ACROSS)]
    return np.vstack(
        [np.hstack(row + [blank] * (min(_ACROSS, len(small)) - len(row))) for row in rows]
    )
