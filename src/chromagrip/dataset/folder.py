"""The format of a dataset: a folder for each sequence, and a manifest of a complete dataset.

    recipe.toml          everything it was made from
    manifest.json        versions, sequences and the checksum of each; written last
    sequences.parquet    values that were drawn for each sequence
    DATASET_CARD.md, contact-sheet.png
    sensors/             the user's own, see `own_files`
    objects/             meshes
    sequence-000000/     scene.toml, camera.yml, rest.png, frame-000.png … (see `pictures` for
                         those without noise), frames.parquet, markers.parquet, truth-000.npz …
                         where the recipe has `truth`, files.json (versions, checksums)

A sequence's folder gets its name when it is complete. No file holds a time or a host: the same
recipe and versions give the same bytes.
"""

import dataclasses
import hashlib
import json
import shutil
from collections.abc import Iterable
from functools import lru_cache
from importlib.metadata import version
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, TypeVar

import msgspec
import numpy as np
from msgspec.structs import replace

from ..errors import UserError, located
from ..extras import need
from ..output.folder import PART, disk_errors, whole_folder, write_whole
from ..output.png import encode_png
from ..output.versions import versions
from ..render import camera_text
from ..scene.scene import dump_scene, relative, seen_from
from .labels import COMMON, Column, Columns, Shot, columns_of
from .pictures import CLEAN, FRAME, NOISE, REST, change_png, noise_key
from .recipe import Recipe, Values, dump_recipe, load_recipe, portable
from .sequence import sequence, shots

if TYPE_CHECKING:
    import pyarrow as pa

Content = TypeVar("Content")
#: Name of a file or folder.
Place = str | PathLike[str]

#: Name and version of the format, kept in the manifest.
FORMAT = "chromagrip dataset 1"
#: Recipe of a dataset.
RECIPE = "recipe.toml"
#: Versions and checksums of a complete dataset.
MANIFEST = "manifest.json"
#: Versions and checksums of a complete sequence.
FILES = "files.json"
#: Camera of a sequence in OpenCV's format, with its place on the sensor's axis and the silicone's
#: surface that it looks through.
CAMERA = "camera.yml"
#: Values that were drawn for each sequence.
TABLE = "sequences.parquet"
#: Description of a dataset for people.
CARD = "DATASET_CARD.md"
#: Some pictures of a dataset.
SHEET = "contact-sheet.png"
#: Folder of the user's own sensors.
SENSORS = "sensors"
#: Folder of the meshes.
OBJECTS = "objects"


class Manifest(TypedDict):
    """Content of `manifest.json`, with SHA-256 of files and of each sequence's `files.json`."""

    format: str
    versions: dict[str, str]
    files: dict[str, str]
    sequences: dict[str, str]


class FileList(TypedDict):
    """Content of a sequence's `files.json`, with drawn values and SHA-256 of its files."""

    number: int
    versions: dict[str, str]
    values: Values
    files: dict[str, str]


def sequence_name(number: int) -> str:
    """Folder of a sequence.

    Parameters
    ----------
    number: of the sequence, from 0
    """
    return f"sequence-{number:06d}"


def write_sequence(recipe: Recipe, number: int, out: Path) -> int:
    """Make a sequence and write its folder, unless it exists; returns its number.

    Raises
    ------
    UserError
        When it cannot be written; nothing of it is left.
    """
    final = out / sequence_name(number)
    if not final.exists():
        with whole_folder(final) as part:
            _write_files(recipe, number, part)
    return number


def _write_files(recipe: Recipe, number: int, part: Path) -> None:
    made = sequence(recipe, number)
    rest, frames = shots(recipe, made)
    digests: dict[str, str] = {}

    def keep(name: str, data: bytes) -> None:
        (part / name).write_bytes(data)
        digests[name] = hashlib.sha256(data).hexdigest()

    keep("scene.toml", dump_scene(made.scene, part).encode())
    view = made.scene.build_sensor().view
    place = {"position_mm": 1e3 * view.position, "port_mm": 1e3 * view.port}
    port = {"port_is_flat": view.flat, "refractive_index": view.index}
    keep(CAMERA, camera_text(view.camera, **place, **port).encode())
    clean = recipe.store == "clean"
    keep(CLEAN if clean else REST, encode_png(rest))
    if clean:
        key = noise_key(made.scene.camera.noise_levels, made.scene.seed)
        keep(NOISE, msgspec.json.encode(key))
    rows: list[Shot] = []
    for shot in frames:
        index = int(shot.values["frame"])
        data = change_png(shot.image, rest) if clean else encode_png(shot.image)
        keep(f"{FRAME[recipe.store]}-{index:03d}.png", data)
        if shot.truth:
            path = part / f"truth-{index:03d}.npz"
            np.savez_compressed(path, **shot.truth)  # type: ignore[arg-type]
            digests[path.name] = file_digest(path)
        # Pictures are on the disk; a long sequence must not keep them.
        rows.append(dataclasses.replace(shot, image=np.empty(0, np.uint8), truth={}))
    columns = columns_of(made.scene.body, bool(recipe.reading))
    tables = {"frames": frame_table(rows, columns), "markers": marker_table(rows, columns)}
    for name, table in tables.items():
        keep(f"{name}.parquet", to_parquet(table))
    listed: FileList = {
        "number": number,
        "versions": made_with(),
        "values": _plain(made.values, part),
        "files": dict(sorted(digests.items())),
    }
    (part / FILES).write_text(json.dumps(listed, indent=1, ensure_ascii=False) + "\n", "utf-8")


def frame_table(rows: list[Shot], meaning: Columns) -> "pa.Table":
    """Table of the frames' values."""
    pa = need("pyarrow", "data")
    columns = {}
    for name in meaning.frame:
        values = [row.values[name] for row in rows]
        if isinstance(values[0], str | bool):
            columns[name] = pa.array(values)
        else:
            whole = name in ("frame", "contact_nodes")
            columns[name] = pa.array(values, pa.int32() if whole else pa.float64())
    return _with_meaning(pa.table(columns), meaning.frame)


def marker_table(rows: list[Shot], meaning: Columns) -> "pa.Table":
    """Table of the frames' markers and nodes, as lists."""
    pa = need("pyarrow", "data")
    columns = {"frame": pa.array([int(row.values["frame"]) for row in rows], pa.int32())}
    for name in meaning.markers:
        columns[name] = _lists([row.markers[name] for row in rows])
    for name in meaning.nodes:
        columns[name] = _lists([row.nodes[name] for row in rows])
    said = {"frame": COMMON["frame"], **meaning.markers, **meaning.nodes}
    return _with_meaning(pa.table(columns), said)


def _lists(values: list[Any]) -> "pa.Array":
    """Lists of one length; numbers in single precision, which resolves 0.05 nm and 0.00006 px."""
    pa = need("pyarrow", "data")
    stacked = np.stack(values)
    flat = stacked.ravel() if stacked.dtype == bool else stacked.astype(np.float32).ravel()
    return pa.FixedSizeListArray.from_arrays(pa.array(flat), stacked.shape[1])


def _with_meaning(table: "pa.Table", columns: dict[str, Column]) -> "pa.Table":
    return table.replace_schema_metadata(
        {name: of.meaning.encode() for name, of in columns.items()}
    )


def to_parquet(table: "pa.Table") -> bytes:
    """Bytes of a Parquet file."""
    pa, pq = need("pyarrow", "data"), need("pyarrow.parquet", "data")
    # Numbers do not repeat, but their signs and exponents do: bytes of equal rank lie together.
    split = [
        f"{field.name}.list.element"
        for field in table.schema
        if pa.types.is_fixed_size_list(field.type) and field.type.value_type == pa.float32()
    ]
    sink = pa.BufferOutputStream()
    pq.write_table(
        table, sink, compression="zstd", use_dictionary=False, use_byte_stream_split=split
    )
    return sink.getvalue().to_pybytes()


def _plain(values: Values, folder: Path) -> Values:
    """Values for JSON: infinity as text, files relative to the folder."""
    plain = {
        k: str(v) if isinstance(v, float) and not np.isfinite(v) else v for k, v in values.items()
    }
    if "sensor" in plain:
        plain["sensor"] = seen_from(folder, plain["sensor"])
    if "object.mesh" in plain:
        plain["object.mesh"] = relative(plain["object.mesh"], folder)
    own: Values = values.get("object", {})
    if own.get("mesh"):
        return plain | {"object": {**own, "mesh": relative(own["mesh"], folder)}}
    return plain


def clean(out: Path) -> None:
    """Remove the incomplete folders of interrupted workers."""
    for part in out.glob(f"{PART}*"):
        shutil.rmtree(part, ignore_errors=True)


def numbers_in(folder: Path) -> list[int]:
    """Numbers of the complete sequences."""
    found = sorted(path.name for path in folder.glob("sequence-*") if path.is_dir())
    return [int(name.removeprefix("sequence-")) for name in found]


def read_manifest(folder: Path) -> Manifest:
    """Manifest of a dataset.

    Raises
    ------
    UserError
        When there is none, because the folder is no dataset or not complete.
    """
    path = folder / MANIFEST
    if not path.is_file():
        begun = (folder / RECIPE).is_file()
        problem = "is not whole: go on with --resume" if begun else "is no dataset"
        raise UserError(f"{folder} {problem}; it has no {MANIFEST}")
    manifest = _read_json(path, Manifest)
    if manifest["format"] != FORMAT:
        raise UserError(f"{folder} has the format {manifest['format']!r}, not {FORMAT!r}")
    return manifest


@lru_cache(maxsize=1)
def made_with() -> dict[str, str]:
    """Versions that decide a dataset's bytes."""
    return versions() | {"pyarrow": version("pyarrow")}


def write_manifest(folder: Path, numbers: Iterable[int]) -> Manifest:
    """Write the manifest, which marks a dataset as complete."""
    names = [sequence_name(number) for number in numbers]
    manifest: Manifest = {
        "format": FORMAT,
        "versions": made_with(),
        "files": {
            name: file_digest(folder / name)
            for name in (RECIPE, TABLE, CARD, SHEET, *own_files(folder))
        },
        "sequences": {name: file_digest(folder / name / FILES) for name in names},
    }
    text = json.dumps(manifest, indent=1, ensure_ascii=False) + "\n"
    write_whole(folder / MANIFEST, text.encode())
    return manifest


def own_files(folder: Path) -> list[str]:
    """Files of the user's own sensors and meshes in a dataset."""
    found = [*folder.glob(f"{SENSORS}/*/*"), *folder.glob(f"{OBJECTS}/*")]
    return sorted(path.relative_to(folder).as_posix() for path in found)


def read_files(sequence: Path) -> FileList:
    """List of the files of a sequence's folder; errors as in `read_manifest`."""
    return _read_json(sequence / FILES, FileList)


def _read_json(path: Path, kind: type[Content]) -> Content:
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except (OSError, msgspec.DecodeError):
        raise UserError(f"{path} is missing or damaged") from None


def link(source: Path, target: Path) -> None:
    """Give a file another name: as a hard link where the disk can, else as a copy."""
    try:
        target.hardlink_to(source)
    except OSError:
        target.write_bytes(source.read_bytes())


def file_digest(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def open_recipe(folder: Path) -> Recipe:
    """Recipe of a dataset's folder."""
    with located(f"{folder}"):
        return load_recipe(str(folder / RECIPE))


def keep_recipe(recipe: Recipe, folder: Path) -> None:
    """Write the recipe into a new folder or an incomplete dataset, and remove its manifest.

    Raises
    ------
    UserError
        When the folder holds a dataset of another recipe, of more sequences or of other versions.
    """
    path = folder / RECIPE
    if path.exists():
        before = open_recipe(folder)
        if replace(before, sequences=recipe.sequences) != recipe:
            raise UserError(f"{folder} holds a dataset of another recipe, see its {RECIPE}")
        if before.sequences > recipe.sequences:
            raise UserError(
                f"{folder} is to have {before.sequences} sequences; it can get more, not fewer"
            )
        for number in numbers_in(folder)[:1]:
            begun = read_files(folder / sequence_name(number))["versions"]
            if begun != made_with():
                raise UserError(f"{folder} was begun with other versions: {_changes(begun)}")
    with disk_errors(folder / MANIFEST):
        (folder / MANIFEST).unlink(missing_ok=True)
    write_whole(path, dump_recipe(portable(recipe, folder)).encode())


def _changes(begun: dict[str, str]) -> str:
    now = made_with()
    names = [name for name in {**begun, **now} if begun.get(name) != now.get(name)]
    return ", ".join(f"{name} {begun.get(name, '–')}, now {now.get(name, '–')}" for name in names)
