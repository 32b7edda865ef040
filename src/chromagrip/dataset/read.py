"""Read a dataset: its sequences, their tables, and a summary."""

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..scene.scene import Scene, load_scene
from ..strange_files import read_small, shortened
from .folder import (
    FILES,
    SPLIT,
    Manifest,
    Place,
    check_named,
    file_digest,
    open_recipe,
    read_files,
    read_manifest,
    sequence_name,
)
from .labels import READ, STATES, columns_of
from .labels.tables import (
    MEND,
    Table,
    damaged,
    frame_kinds,
    marker_kinds,
    read_table,
)
from .pictures import Pictures, pictures_in
from .recipe import Values
from .remote import fetched

#: Columns of a table by name.
Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True, kw_only=True)
class Loaded:
    """A sequence of a dataset; its pictures are read on demand.

    Attributes
    ----------
    number: number in the dataset
    values: drawn values, by key
    scene: scene that was run
    frames: values of every frame, by column of FRAME, shape (T,)
    markers: values of markers and nodes in every frame, by column of MARKERS and NODES, shape
        (T, 2M), (T, M) or (T, N)
    pictures: pictures of every frame; `pictures[t]` and `pictures.rest` read one
    """

    number: int
    values: Values
    scene: Scene
    frames: dict[str, NDArray[Any]]
    markers: dict[str, NDArray[Any]]
    pictures: Pictures

    def __repr__(self) -> str:
        """Name, frames and columns, without their arrays."""
        return (
            f"<{sequence_name(self.number)}: {len(self.pictures)} frames; "
            f"frames: {', '.join(self.frames)}; markers: {', '.join(self.markers)}>"
        )

    def images(self) -> Iterator[NDArray[np.uint8]]:
        """Read the pictures one by one, RGB, shape (H, W, 3)."""
        return iter(self.pictures)

    @property
    def places(self) -> NDArray[np.float32]:
        """Markers' centroids in the image [px], shape (T, 2, M, 2)."""
        both = np.stack([self.markers["x_px"], self.markers["y_px"]], axis=-1)
        return both.reshape(len(both), 2, -1, 2)

    @property
    def visible(self) -> NDArray[np.bool_]:
        """Visible markers, bool, shape (T, 2, M)."""
        flat = self.markers["visible"]
        return np.asarray(flat.reshape(len(flat), 2, -1), dtype=np.bool_)


def load_sequences(
    folder: Place, part: str | None = None, *, follow_links: bool = False
) -> Iterator[Loaded]:
    """Read the sequences of a dataset, in order.

    Parameters
    ----------
    folder: folder of the dataset, or its address
    part: part of its split (default: all sequences)
    follow_links: whether links in the folder may lead out of it, as in caches of hubs

    Raises
    ------
    UserError
        When the folder is not a complete dataset, is damaged, or has no such part.
    """
    folder = fetched(folder, follow_links)
    for name in names_of(folder, part):
        yield load_sequence(folder / name)


def verified(folder: Path, names: Iterable[str] | None = None) -> Iterator[Loaded]:
    """Read sequences after verifying their checksums and their picture at rest.

    Parameters
    ----------
    folder: folder of the dataset
    names: names of the sequences (default: all)

    Raises
    ------
    UserError
        For the first file that is missing, has changed or is damaged.
    """
    digests = read_manifest(folder)["sequences"]
    for name in digests if names is None else names:
        if name not in digests:
            raise UserError(f"{folder} has no {name}")
        check_files(folder / name, digests[name])
        one = load_sequence(folder / name)
        _ = one.pictures.rest
        yield one


def check_shared(folder: Path) -> Manifest:
    """Verify the files of a dataset that belong to no sequence; returns its manifest.

    Raises
    ------
    UserError
        For the first file that is missing or has changed.
    """
    manifest = read_manifest(folder)
    for name, digest in manifest["files"].items():
        if not (folder / name).is_file():
            raise UserError(f"{folder / name} is missing; {MEND}")
        if file_digest(folder / name) != digest:
            raise UserError(f"{folder / name} has changed; {MEND}")
    return manifest


def check_files(folder: Path, digest: str) -> None:
    """Verify the files of a sequence whose `files.json` has this checksum.

    Raises
    ------
    UserError
        For the first file that is missing, has changed or does not belong there.
    """
    if not (folder / FILES).is_file():
        raise UserError(f"{folder / FILES} is missing; {MEND}")
    if file_digest(folder / FILES) != digest:
        raise UserError(f"{folder / FILES} has changed; {MEND}")
    listed = read_files(folder)["files"]
    there = {path.name for path in folder.iterdir()} - {FILES}
    for name in sorted(there ^ set(listed)):
        what = f"is missing; {MEND}" if name in listed else "does not belong there; remove it"
        raise UserError(f"{folder / name} {what}")
    for name, expected in listed.items():
        if file_digest(folder / name) != expected:
            raise UserError(f"{folder / name} has changed; {MEND}")


def load_sequence(where: Path) -> Loaded:
    """Read one sequence of a dataset from its folder.

    Raises
    ------
    UserError
        When a file of it is missing or damaged, or files belong to different sequences.
    """
    listed = read_files(where)
    if sequence_name(listed["number"]) != Path(os.path.abspath(where)).name:
        raise UserError(f"{where} has the {FILES} of sequence {listed['number']}; {MEND}")
    check_named(where / "scene.toml", where.parent)
    scene = load_scene(str(where / "scene.toml"))
    view = scene.build_sensor().view
    pictures = pictures_in(where, (view.height, view.width))
    names = [f"frame-{k:03d}.png" for k in range(max(len(pictures), 1))]
    for file, name in zip_longest([file.name for file in pictures.files], names):
        if file != name:
            raise UserError(f"{where / name} is missing; {MEND}")
    frames, markers = _tables(where, scene, len(pictures))
    return Loaded(
        number=listed["number"],
        values=listed["values"],
        scene=scene,
        frames=frames,
        markers=markers,
        pictures=pictures,
    )


def _tables(where: Path, scene: Scene, rows: int) -> tuple[Arrays, Arrays]:
    """Read the columns of frames and of markers; `rows` is the number of pictures."""
    path = where / "frames.parquet"
    columns = columns_of(scene.body)
    frames = read_table(path, rows, frame_kinds(columns), others=True)
    if any(name.startswith(READ) for name in frames):
        columns = columns_of(scene.body, reading=True)
        frames = read_table(path, rows, frame_kinds(columns), others=True)
    _check_frames(path, frames, columns.frame)
    if strange := set(frames["slip_state"]) - set(STATES):
        raise damaged(path, f"slip_state is {shortened(strange.pop())}, not {', '.join(STATES)}")
    path = where / "markers.parquet"
    markers = read_table(path, rows, marker_kinds(columns), others=True)
    _check_frames(path, markers, ("frame", *columns.markers, *columns.nodes))
    del markers["frame"]
    pairs = len(scene.build_sensor().places)
    nodes = scene.build_body().nodes
    lengths = dict.fromkeys(columns.markers, 2 * pairs) | dict.fromkeys(columns.nodes, nodes)
    for name, length in (lengths | {"overlap": pairs}).items():
        if markers[name].shape[1] != length:
            raise damaged(path, f"{name} has lists of {markers[name].shape[1]}, not of {length}")
    visible = markers["visible"]
    if not (np.isfinite(markers["x_px"][visible]) & np.isfinite(markers["y_px"][visible])).all():
        raise damaged(path, "a visible marker has no x_px or y_px")
    return frames, markers


def _check_frames(path: Path, table: Table, known: Iterable[str]) -> None:
    """Refuse a table with unknown columns, or with frames that are not numbered from 0."""
    if strange := [name for name in table if name not in known]:
        raise damaged(path, f"column {shortened(strange[0])} does not belong there")
    rows = len(table["frame"])
    if (table["frame"] != np.arange(rows)).any():
        raise damaged(path, f"its frames are not 0 to {rows - 1}")


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
    check_parts(parts, str(path))
    named = sorted(name for names in parts.values() for name in names)
    if named != sorted(read_manifest(folder)["sequences"]):
        raise UserError(
            f"{path} does not have each sequence of the dataset once; make it again with "
            "dataset split"
        )
    return parts


def check_parts(names: Iterable[str], where: str) -> None:
    """Refuse names that lead elsewhere: the parts of an export are folders."""
    for name in names:
        if name in ("", ".", "..") or not name.isprintable() or set(name) & set("/\\"):
            raise UserError(f"{where}: a part cannot be called {shortened(name)}")


def names_of(folder: Path, part: str | None) -> list[str]:
    """Names of the sequences of a part of a dataset, or of all.

    Raises
    ------
    UserError
        When there is no such part.
    """
    if part is None:
        return list(read_manifest(folder)["sequences"])
    parts = read_split(folder)
    if part not in parts:
        there = f"it has {', '.join(parts)}" if parts else "it is not split, see dataset split"
        raise UserError(f"{folder} has no part {part!r}; {there}")
    return parts[part]


def drawn_values(sequence: Path) -> Values:
    """Read the values drawn for a sequence; JSON holds infinity as text."""
    values: Values = _numbers(read_files(sequence)["values"])
    return values


def _numbers(value: Any) -> Any:
    """Value of JSON with infinity as a number, in tables too."""
    if isinstance(value, dict):
        return {key: _numbers(one) for key, one in value.items()}
    return float(value) if value in ("inf", "-inf") else value


def summarise(folder: Place, *, follow_links: bool = False) -> dict[str, object]:
    """Counts, drawn keys, size and versions of a dataset, for `chromagrip dataset info`."""
    folder = fetched(folder, follow_links)
    manifest, recipe = read_manifest(folder), open_recipe(folder)
    names = list(manifest["sequences"])
    drawn = {key for name in names for key in drawn_values(folder / name)}
    states: dict[str, int] = {}
    for table in tables(folder, names, ["slip_state"]):
        for state in table["slip_state"].tolist():
            states[state] = states.get(state, 0) + 1
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    return {
        "description": recipe.description,
        "sequences": len(names),
        "of": recipe.sequences,
        "frames": sum(states.values()),
        "slip_states": states,
        "drawn": sorted(drawn),
        "megabytes": round(size / 1e6, 1),
        "versions": manifest["versions"],
    }


def tables(
    folder: Path, names: Iterable[str], columns: Sequence[str] | None = None
) -> Iterator[Table]:
    """Read the table of frames of each sequence, with the given columns (default: all)."""
    kinds = frame_kinds(columns_of("dome", reading=True))
    for name in names:
        own = {column: kinds[column] for column in columns or ("frame",)}
        rows = len(pictures_in(folder / name))
        path = folder / name / "frames.parquet"
        yield read_table(path, rows, own, others=columns is None)
