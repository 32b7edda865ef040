"""Summary of a dataset: the table of its sequences, its card, and a sheet of its pictures."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ..folders import write_whole
from ..output.figure import png
from ..scene.scene import Scene
from .folder import CARD, SHEET, TABLE, sequence_name
from .labels import STATES, Column, columns_of
from .labels.columns import Columns
from .labels.reading import reading_lines
from .labels.tables import Table, rows_bytes
from .read import Loaded, drawn_values, load_sequence, tables
from .recipe import CASE, Case, Recipe, Values, bodies_of, cases_of, dotted

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
    drawn = [drawn_values(folder / name) for name in names]
    keys = sorted({key for one in drawn for key in one})
    rows = [
        {"number": number} | {key: one.get(key) for key in keys}
        for number, one in zip(numbers, drawn, strict=True)
    ]
    write_whole(folder / TABLE, rows_bytes(rows))
    # Columns of frames whose histograms the card shows.
    counted = ["normal_n", "friction_n", "mu", "margin", "slipped_share"]
    if bodies_of(recipe) == ["dome"]:
        counted.insert(2, "torque_z_nmm")
    columns = [*counted, "slip_state"]
    parts = list(tables(folder, names, columns))
    values = {name: np.concatenate([part[name] for part in parts]) for name in columns}
    read = reading_lines(recipe.reading, tables(folder, names))
    down = 3  # rows of the sheet
    chosen = np.linspace(0, len(numbers) - 1, _ACROSS * down, dtype=int)
    shown = [load_sequence(folder / names[at]) for at in dict.fromkeys(chosen)]
    write_whole(folder / CARD, _card(recipe, numbers, drawn, values, read, shown[0]).encode())
    write_whole(folder / SHEET, _sheet(shown))


def _card(
    recipe: Recipe,
    numbers: list[int],
    drawn: list[Values],
    values: Table,
    read: list[str],
    one: Loaded,
) -> str:
    states = Counter(values.pop("slip_state").tolist())
    bodies = bodies_of(recipe)
    motions = [str(one.get("motion", "press")) for one in drawn]
    cases = cases_of(recipe)
    sensors = [
        Path(str(one.get("sensor", cases[number % len(cases)].scene.get("sensor", "thesis")))).stem
        for number, one in zip(numbers, drawn, strict=True)
    ]
    lines = [
        "# Dataset card",
        "",
        recipe.description,
        "",
        f"{len(drawn)} sequences, {states.total()} frames, made by chromagrip: simulated "
        "pictures of a fingertip with two layers of coloured markers, with what is true of them.",
        "",
        *_sizes(one),
        "",
        *_counts("case", [one[CASE] for one in drawn if CASE in one]),
        *_counts("sensor", sensors),
        *_counts("motion", motions),
        "| slip state | frames |",
        "|---|---|",
        *(f"| {name} | {states.get(name, 0)} |" for name in STATES),
        "",
    ]
    lines += [
        *_histograms(values, columns_of(bodies[0]).frame),
        *read,
        "![pictures](contact-sheet.png)",
        "",
        _SNIPPET.format(shape=one.pictures[-1].shape),
    ]
    for body in bodies:
        of = f", body {body}" if len(bodies) > 1 else ""
        lines += _tables_of(columns_of(body, bool(recipe.reading)), of)
    lines += ["## Drawn values", "", *_draws(recipe)]
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


def _tables_of(columns: Columns, of: str) -> Iterator[str]:
    """Tables of the columns of a sequence's files."""
    frame, markers, nodes = columns
    yield from (f"## Columns of `frames.parquet`{of}", "", *_columns(frame), "")
    yield from (f"## Columns of `markers.parquet`{of}", "")
    yield from ("Each cell is a list: 2M values, the outer layer's first, M pairs or N nodes.", "")
    yield from (*_columns({**markers, **nodes}), "")


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


def _histograms(values: Table, meanings: Mapping[str, Column]) -> Iterator[str]:
    """Histogram of each column, below its meaning."""
    for name, column in values.items():
        unit = f" [{meanings[name].unit}]" if meanings[name].unit else ""
        yield from (f"`{name}`: {meanings[name].meaning}{unit}", "")
        yield from ("```", *_histogram(column), "```", "")


def _histogram(values: NDArray[np.float64]) -> list[str]:
    there = values[np.isfinite(values)]
    if not len(there):
        return ["nothing"]
    rounding = 1e-9  # largest relative difference that counts as rounding
    # Values that differ only by rounding count as one; all are newtons, or shares.
    alike = np.ptp(there) <= rounding * max(abs(there).max(), 1.0)
    around = (there[0] - 0.5, there[0] + 0.5) if alike else None
    counts, edges = np.histogram(there, 10, around)
    edges[abs(edges) <= rounding * abs(edges).max()] = 0.0
    longest = 30  # length of the longest bar of a histogram [characters]
    bars = np.rint(longest * counts / max(counts.max(), 1)).astype(int)
    return [
        f"{low:8.3g} … {high:8.3g}  {'#' * bar} {count}"
        for low, high, bar, count in zip(edges, edges[1:], bars, counts, strict=False)
    ]


def _sheet(shown: list[Loaded]) -> bytes:
    """Draw the last pictures of some sequences with the markers' motion, forces and Γ, as a PNG."""
    across = min(_ACROSS, len(shown))
    down = -(-len(shown) // across)
    width, height, foot = 3.0, 3.6, 0.4  # of a picture with its title, and of the last line [in]
    figure = Figure(figsize=(max(width * across, 6.0), height * down + foot))
    low = foot / (height * down + foot)
    figure.subplots_adjust(0.01, low, 0.99, 1.0 - 0.55 / (height * down + foot), 0.05, 0.28)
    axes = figure.subplots(down, across, squeeze=False)
    magnify = _magnification(shown)
    for axis in axes.flat:
        axis.set_axis_off()
    for axis, one in zip(axes.flat, shown, strict=False):
        _draw_motion(axis, one, magnify)
        axis.set_title("\n".join(_caption(one)), fontsize=9.5)
    said = f"arrows: motion of the outer layer from the first to the last picture, × {magnify}"
    figure.text(0.5, 0.25 * low, said, ha="center", fontsize=10)
    return png(figure, 90)


def _caption(one: Loaded) -> list[str]:
    """Number, sensor, motion, forces, torque and Γ of a sequence's last frame."""

    def last(name: str) -> float:
        return float(one.frames[name][-1]) if name in one.frames else np.nan

    margin, torque = last("margin"), last("torque_z_nmm")
    force = f"ΣFn {last('normal_n'):.2f} N, ΣFf {last('friction_n'):.2f} N"
    turned = f", torque about z {torque:z.2f} N·mm" if np.isfinite(torque) else ""
    return [
        f"{one.number}: {Path(one.scene.sensor).stem}, {one.values.get('motion', 'press')}, "
        f"{_shape_name(one.scene)}",
        force + ("" if np.isfinite(margin) else ", no contact"),
        (f"Γ {margin:.2f}" if np.isfinite(margin) else "Γ –") + turned,
    ]


def _shape_name(scene: Scene) -> str:
    """Name of the object's shape; the radius of a ball tells how round it is."""
    made, radius = scene.object, scene.object.radius_mm
    if made.mesh:
        return Path(made.mesh).stem
    if made.profile_mm:
        return "profile"
    if made.shape != "ball":
        return made.shape
    if math.isinf(radius):
        return "plane"
    return f"ball R {radius:.1f} mm" if radius > 0.0 else f"hollow R {-radius:.1f} mm"


def _motion(one: Loaded) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Places of the visible markers in the first picture, and their motion until the last [px]."""
    places, visible = one.places[:, 0], one.visible[0, 0] & one.visible[-1, 0]
    return places[0, visible], places[-1, visible] - places[0, visible]


def _magnification(shown: list[Loaded]) -> int:
    """Factor at which the largest motion of some sequences still fits into their pictures."""
    factors, longest = (1, 2, 5, 10, 20, 50), 0.12  # longest arrow over a picture's height
    largest = max(
        float(np.linalg.norm(_motion(one)[1], axis=1).max(initial=1e-9)) / one.pictures[-1].shape[0]
        for one in shown
    )
    return max([factor for factor in factors if factor * largest < longest], default=1)


def _draw_motion(axis: Axes, one: Loaded, magnify: int) -> None:
    """Draw a sequence's last picture and its markers' motion, about the part that moves."""
    picture, (start, moved) = one.pictures[-1], _motion(one)
    height, width, _ = picture.shape
    length = np.linalg.norm(moved, axis=1)
    axis.imshow(picture)
    axis.quiver(
        *start.T, *moved.T, color="#0072b2", angles="xy", scale_units="xy", scale=1.0 / magnify,
        width=7e-3,
    )  # fmt: skip
    moving = start[length > 0.2 * length.max(initial=1e-9)]
    if len(moving):
        low, high = moving.min(axis=0), moving.max(axis=0)
        half = min(0.5 * height, max(0.7 * float((high - low).max()), 0.25 * height))
        x, y = np.clip(0.5 * (low + high), half, [width - half, height - half])
        axis.set_xlim(x - half, x + half)
        axis.set_ylim(y + half, y - half)
