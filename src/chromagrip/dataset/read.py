"""Reading a dataset: its sequences, their tables, and a summary."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..extras import need
from ..scene.scene import Scene, load_scene
from .folder import (
    TABLE,
    Place,
    numbers_in,
    open_recipe,
    read_files,
    read_manifest,
    sequence_name,
)
from .pictures import Pictures, pictures_in
from .recipe import Values
from .remote import fetched
from .split import names_of

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True, kw_only=True)
class Loaded:
    """A sequence of a dataset; its pictures are read on demand.

    Attributes
    ----------
    number: in the dataset
    values: that were drawn
    scene: that was run
    frames: values of every frame, by column of FRAME, shape (T,)
    markers: of every frame, by column of MARKERS and NODES, shape (T, 2M), (T, M) or (T, N)
    pictures: of every frame; `pictures[t]` and `pictures.rest` read one, whatever the store
    """

    number: int
    values: Values
    scene: Scene
    frames: dict[str, NDArray[Any]]
    markers: dict[str, NDArray[Any]]
    pictures: Pictures

    def images(self) -> Iterator[NDArray[np.uint8]]:
        """Pictures one by one, RGB, shape (H, W, 3)."""
        return iter(self.pictures)

    @property
    def places(self) -> NDArray[np.float32]:
        """Markers' centroids in the image [px], shape (T, 2, M, 2)."""
        both = np.stack([self.markers["x_px"], self.markers["y_px"]], axis=-1)
        return both.reshape(len(both), 2, -1, 2)

    @property
    def visible(self) -> NDArray[np.bool_]:
        """Whether a marker is visible, shape (T, 2, M)."""
        flat = self.markers["visible"]
        return np.asarray(flat.reshape(len(flat), 2, -1), dtype=np.bool_)


def load_sequences(folder: Place, part: str | None = None) -> Iterator[Loaded]:
    """Sequences of a dataset, in order.

    Parameters
    ----------
    folder: of the dataset, or its address
    part: of its split; None is all of it

    Raises
    ------
    UserError
        When the folder is no complete dataset, or has no such part.
    """
    folder = fetched(folder)
    names = list(read_manifest(folder)["sequences"]) if part is None else names_of(folder, part)
    for name in names:
        yield load_sequence(folder / name)


def load_sequence(where: Path) -> Loaded:
    """One sequence of a dataset, by its folder."""
    pa, pq = need("pyarrow", "data"), need("pyarrow.parquet", "data")
    listed = read_files(where)
    try:
        frames = pq.read_table(where / "frames.parquet")
        markers = pq.read_table(where / "markers.parquet")
    except (OSError, pa.ArrowException) as error:
        raise UserError(f"{where} cannot be read: {error}") from None
    return Loaded(
        number=listed["number"],
        values=listed["values"],
        scene=load_scene(str(where / "scene.toml")),
        frames={column: frames[column].to_numpy() for column in frames.column_names},
        markers={column: stacked(markers[column]) for column in markers.column_names[1:]},
        pictures=pictures_in(where),
    )


def stacked(column: "pa.ChunkedArray") -> NDArray[Any]:
    """Column of lists as an array, a row for each."""
    lists = column.combine_chunks()
    flat = lists.flatten().to_numpy(zero_copy_only=False)
    return np.asarray(flat.reshape(len(lists), -1))


def summarise(folder: Place) -> dict[str, object]:
    """Counts, drawn keys, size and versions of a dataset, for `chromagrip dataset info`."""
    folder = fetched(folder)
    manifest, recipe = read_manifest(folder), open_recipe(folder)
    rows = need("pyarrow.parquet", "data").read_table(folder / TABLE).to_pylist()
    states: dict[str, int] = {}
    for _, table in tables(folder, "frames", ["slip_state"]):
        for state in table["slip_state"].to_pylist():
            states[state] = states.get(state, 0) + 1
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    return {
        "description": recipe.description,
        "sequences": len(manifest["sequences"]),
        "of": recipe.sequences,
        "frames": sum(states.values()),
        "slip_states": states,
        "drawn": sorted(set(rows[0]) - {"number"}) if rows else [],
        "megabytes": round(size / 1e6, 1),
        "versions": manifest["versions"],
    }


def tables(folder: Path, name: str, columns: list[str] | None = None) -> Iterator[tuple[int, Any]]:
    """Number and table (`frames` or `markers`) of every sequence."""
    pq = need("pyarrow.parquet", "data")
    for number in numbers_in(folder):
        path = folder / sequence_name(number) / f"{name}.parquet"
        yield number, pq.read_table(path, columns=columns)
