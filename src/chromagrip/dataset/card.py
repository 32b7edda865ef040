"""Summary of a dataset: the table of its sequences, its card, and a sheet of its pictures."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..errors import UserError
from ..extras import need
from ..folders import write_whole
from ..output.figure import png
from .folder import CARD, SHEET, TABLE, read_files, sequence_name
from .labels import COMMON, STATES, Column, columns_of
from .labels.reading import reading_lines
from .labels.tables import to_parquet
from .read import Loaded, load_sequence, tables
from .recipe import CASE, Case, Recipe, Values, bodies_of, dotted

if TYPE_CHECKING:
    import pyarrow as pa

#: Pictures in a row of the sheet.
_ACROSS = 4
_SNIPPET = """## Loading

```python
from chromagrip.dataset import load_sequences

for one in load_sequences("FOLDER"):  # of this card
    picture = one.pictures[-1]  # RGB, shape {shape}
    force, margin = one.frames["normal_n"], one.frames["margin"]  # a value for each frame
```

Without chromagrip, pandas reads `frames.parquet` and `markers.parquet` of each sequence.
For PyTorch there is `chromagrip.dataset.torch.Frames`, for other tools `chromagrip dataset export`.

## Licence

chromagrip claims no right in what it makes: pictures and labels belong to whoever ran it.
Meshes and sensor designs that were given to it keep their own licences.
"""


def write_card(folder: Path, recipe: Recipe, numbers: list[int]) -> None:
    """Write the table, DATASET_CARD.md and contact-sheet.png."""
    names = [sequence_name(number) for number in numbers]
    drawn = [read_files(folder / name)["values"] for name in names]
    pa = need("pyarrow", "data")
    try:
        data = to_parquet(_table(numbers, drawn))
    except (pa.ArrowException, OverflowError) as error:  # of values that a stranger gave
        raise UserError(f"drawn values of the sequences fit in no table: {error}") from None
    write_whole(folder / TABLE, data)
    # Columns of frames whose histograms the card shows.
    counted = ("normal_n", "friction_n", "mu", "margin", "slipped_share")
    columns = [*counted, "slip_state"]
    parts: dict[str, list[Any]] = {name: [] for name in columns}
    for table in tables(folder, names, columns):
        for name in columns:
            parts[name].append(table[name].combine_chunks())
    values = {name: pa.chunked_array(parts[name]) for name in columns}
    read = reading_lines(recipe.reading, tables(folder, names))
    down = 3  # rows of the sheet
    chosen = np.linspace(0, len(numbers) - 1, _ACROSS * down, dtype=int)
    shown = [load_sequence(folder / names[at]) for at in dict.fromkeys(chosen)]
    write_whole(folder / CARD, _card(recipe, drawn, values, read, shown[0]).encode())
    write_whole(folder / SHEET, _sheet(shown))


def _table(numbers: list[int], drawn: list[Values]) -> "pa.Table":
    pa = need("pyarrow", "data")
    columns = {"number": pa.array(numbers, pa.int64())}
    for key in sorted({key for values in drawn for key in values}):
        column = [values.get(key) for values in drawn]  # a key may be of some cases alone
        # JSON holds infinity as text.
        columns[key] = pa.array([float(v) if v in ("inf", "-inf") else v for v in column])
    return pa.table(columns)


def _card(
    recipe: Recipe,
    drawn: list[Values],
    values: "dict[str, pa.ChunkedArray]",
    read: list[str],
    one: Loaded,
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
        *_sizes(one),
        "",
        *_counts("case", [one[CASE] for one in drawn if CASE in one]),
        *_counts("motion", motions),
        "| slip state | frames |",
        "|---|---|",
        *(f"| {name} | {states.get(name, 0)} |" for name in STATES),
        "",
    ]
    for name, column in values.items():
        said = COMMON[name]
        unit = f" [{said.unit}]" if said.unit else ""
        lines += [f"`{name}`: {said.meaning}{unit}", "", "```", *_histogram(column), "```", ""]
    lines += [
        *read,
        "![pictures](contact-sheet.png)",
        "",
        _SNIPPET.format(shape=one.pictures[-1].shape),
    ]
    for body in bodies:
        frame, markers, nodes = columns_of(body, bool(recipe.reading))
        of = f", body {body}" if len(bodies) > 1 else ""
        lines += [
            f"## Columns of `frames.parquet`{of}",
            "",
            *_columns(frame),
            "",
            f"## Columns of `markers.parquet`{of}",
            "",
            "Each cell is a list: of 2M values, the outer layer's first, of M pairs or of N nodes.",
            "",
            *_columns({**markers, **nodes}),
            "",
        ]
    lines += ["## What was drawn", "", *_draws(recipe)]
    for case in recipe.cases:
        keys = [f"- `{key}` = {value}" for key, value in dotted(case.scene).items()]
        lines += ["", f"### Case {case.name}", "", *keys, *_draws(case)]
    return "\n".join(lines) + "\n"


def _sizes(one: Loaded) -> list[str]:
    """Table of the sizes of a sequence."""
    height, width, _ = one.pictures[-1].shape
    nodes = one.markers["node_contact"].shape[1]
    return [
        "| of the first sequence | |",
        "|---|---|",
        f"| pictures | {len(one.pictures)}, and one at rest; {width} × {height} px, 8-bit RGB |",
        f"| markers in each of two layers, M | {one.places.shape[2]} |",
        f"| nodes of the mechanics, N | {nodes} |",
    ]


def _columns(columns: dict[str, Column]) -> list[str]:
    """Table of columns with their units."""
    rows = [f"| `{name}` | {of.unit or '–'} | {of.meaning} |" for name, of in columns.items()]
    return ["| column | unit | content |", "|---|---|---|", *rows]


def _draws(part: Recipe | Case) -> list[str]:
    return [
        f"- `{key}`: {kind} {numbers}"
        for key, how in part.draw.items()
        for kind, numbers in how.items()
    ]


def _counts(what: str, names: list[str]) -> list[str]:
    """Table of the number of sequences of each name; empty without names."""
    if not names:
        return []
    lines = [f"| {name} | {names.count(name)} |" for name in sorted(set(names))]
    return [f"| {what} | sequences |", "|---|---|", *lines, ""]


def _histogram(column: "pa.ChunkedArray") -> list[str]:
    values = column.to_numpy()
    there = values[np.isfinite(values)]
    if not len(there):
        return ["nothing"]
    rounding = 1e-9  # largest relative difference that counts as rounding
    # Values that differ only by rounding count as one; all are newtons, or shares.
    alike = np.ptp(there) <= rounding * max(abs(there).max(), 1.0)
    around = (there[0] - 0.5, there[0] + 0.5) if alike else None
    counts, edges = np.histogram(there, 10, around)
    longest = 30  # length of the longest bar of a histogram [characters]
    bars = np.rint(longest * counts / max(counts.max(), 1)).astype(int)
    return [
        f"{low:8.3g} … {high:8.3g}  {'#' * bar} {count}"
        for low, high, bar, count in zip(edges, edges[1:], bars, counts, strict=False)
    ]


def _sheet(shown: list[Loaded]) -> bytes:
    """Draw the last pictures of some sequences with the markers' motion, forces and Γ, as a PNG."""
    down = -(-len(shown) // _ACROSS)
    figure = Figure(figsize=(3.0 * _ACROSS, 3.1 * down + 0.5), layout="constrained")
    axes = figure.subplots(down, _ACROSS, squeeze=False)
    for axis in axes.flat:
        axis.set_axis_off()
    for axis, one in zip(axes.flat, shown, strict=False):
        magnify = _draw_motion(axis, one)
        force, margin = one.frames["normal_n"][-1], one.frames["margin"][-1]
        held = f"Γ {margin:.2f}" if np.isfinite(margin) else "no contact"
        title = f"{one.number}: {one.values.get('motion', 'press')}, motion × {magnify}"
        axis.set_title(f"{title}\nΣFn {force:.2f} N, {held}", fontsize=11)
    said = (
        "part of the last picture of a sequence; arrows: motion of the outer layer since the first"
    )
    figure.supxlabel(said, fontsize=11)
    return png(figure, 75)


def _draw_motion(axis: Axes, one: Loaded) -> int:
    """Draw a sequence's last picture and its markers' motion; returns the magnification."""
    picture, places = one.pictures[-1], one.places[:, 0]
    height, width, _ = picture.shape
    visible = one.visible[0, 0] & one.visible[-1, 0]
    start, moved = places[0, visible], places[-1, visible] - places[0, visible]
    length = np.linalg.norm(moved, axis=1)
    largest = max(float(length.max(initial=0.0)), 1e-9)
    # Factors by which a sheet may magnify motion, and its longest arrow over the picture's height.
    factors, longest = (1, 2, 5, 10, 20, 50), 0.12
    magnify = max([m for m in factors if m * largest < longest * height], default=1)
    axis.imshow(picture)
    axis.quiver(
        *start.T, *moved.T, color="#0072b2", angles="xy", scale_units="xy", scale=1.0 / magnify,
        width=7e-3,
    )  # fmt: skip
    moving = start[length > 0.2 * largest]
    if len(moving):
        low, high = moving.min(axis=0), moving.max(axis=0)
        half = min(0.5 * height, max(0.7 * float((high - low).max()), 0.25 * height))
        x, y = np.clip(0.5 * (low + high), half, [width - half, height - half])
        axis.set_xlim(x - half, x + half)
        axis.set_ylim(y + half, y - half)
    return magnify
