"""The format of a dataset: a folder for each sequence, and a manifest of a complete dataset.

    recipe.toml          everything it was made from
    manifest.json        versions, sequences and the checksum of each; written last
    sequences.parquet    values that were drawn for each sequence
    DATASET_CARD.md, contact-sheet.png
    sensors/             the user's own, see `own_files`
    objects/             meshes
    sequence-000000/     scene.toml, camera.yml, rest.png, frame-000.png …,
                         frames.parquet, markers.parquet, truth-000.npz …
                         where the recipe has `truth`, files.json (versions, checksums)

A sequence's folder gets its name when it is complete. No file holds a time or a host: the same
recipe and versions give the same bytes.
"""

import hashlib
import json
import os
import re
import shutil
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import lru_cache
from importlib.metadata import version
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, TypedDict, TypeVar

import msgspec
from msgspec import Meta
from msgspec.structs import replace

from ..errors import UserError, located
from ..folders import PART, disk_errors, remove, synced, write_whole
from ..output.versions import versions
from ..strange_files import inside, read_small, shortened
from ..strict_toml import read_toml
from .labels.tables import MEND
from .recipe import CASE, Recipe, difference, dump_recipe, load_recipe, portable

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
#: Table of the values drawn for each sequence.
TABLE = "sequences.parquet"
#: Description of a dataset for people.
CARD = "DATASET_CARD.md"
#: Parts of a dataset, which its manifest does not list.
SPLIT = "split.json"
#: Some pictures of a dataset.
SHEET = "contact-sheet.png"
#: Folder of the user's own sensors.
SENSORS = "sensors"
#: Folder of the meshes.
OBJECTS = "objects"


#: Names of sequences, of a sequence's files, and of the other files of a dataset.
_SEQUENCE = re.compile("sequence-(?:[0-9]{6}|[1-9][0-9]{6})")
_OF_SEQUENCE = re.compile(
    r"scene\.toml|camera\.yml|rest\.png|(?:frames|markers)\.parquet|"
    r"frame-[0-9]{3,8}\.png|truth-[0-9]{3,8}\.npz"
)
_OF_DATASET = re.compile(
    r"recipe\.toml|sequences\.parquet|DATASET_CARD\.md|contact-sheet\.png|"
    r"sensors/[^/]+/[^/]+|objects/[^/]+"
)
#: Files that every sequence and every dataset has.
_IN_SEQUENCE = ("scene.toml", "frames.parquet", "markers.parquet")
_IN_DATASET = (RECIPE, TABLE)
Digest = Annotated[str, Meta(pattern=r"^[0-9a-f]{64}\Z")]
#: Type of a drawn value; no recipe has deeper tables than an object's.
_Plain = str | int | float | bool | None
_Flat = _Plain | list[_Plain] | dict[str, _Plain]
_Nested = _Plain | list[_Flat] | dict[str, _Flat]
Drawn = _Plain | list[_Nested] | dict[str, _Nested]


class Manifest(TypedDict):
    """Content of `manifest.json`, with SHA-256 of files and of each sequence's `files.json`."""

    format: str
    versions: dict[str, str]
    files: dict[str, Digest]
    sequences: Annotated[dict[str, Digest], Meta(min_length=1)]


class FileList(TypedDict):
    """Content of a sequence's `files.json`, with drawn values and SHA-256 of its files."""

    number: Annotated[int, Meta(ge=0, lt=10_000_000)]
    versions: dict[str, str]
    values: dict[str, Drawn]
    files: dict[str, Digest]


def sequence_name(number: int) -> str:
    """Name of a sequence's folder.

    Parameters
    ----------
    number: number of the sequence, from 0
    """
    return f"sequence-{number:06d}"


def clean(out: Path) -> None:
    """Remove the incomplete files and folders of a run that was killed."""
    for part in out.glob(f"{PART}*"):
        with suppress(OSError):
            remove(part)


def numbers_in(folder: Path) -> list[int]:
    """Numbers of the complete sequences."""
    names = [path.name for path in folder.glob("sequence-*") if path.is_dir()]
    return sorted(int(name.removeprefix("sequence-")) for name in names if is_sequence(name))


def is_sequence(name: str) -> bool:
    """Return True for a name that a sequence's folder can have."""
    return _SEQUENCE.fullmatch(name) is not None


def read_manifest(folder: Path) -> Manifest:
    """Read the manifest of a dataset.

    Raises
    ------
    UserError
        When it is missing, because the folder is not a dataset or not complete.
    """
    path = folder / MANIFEST
    if not path.is_file():
        begun = (folder / RECIPE).is_file()
        problem = "is not whole: go on with --resume" if begun else "is no dataset"
        why = f"it has no {MANIFEST}" if folder.is_dir() else "there is no such folder"
        if folder.is_dir() and (folder.parent / MANIFEST).is_file():
            why = f"it lies in the dataset {folder.parent}"
        raise UserError(f"{folder} {problem}; {'it is a file' if folder.is_file() else why}")
    manifest = _read_json(path, Manifest)
    if manifest["format"] != FORMAT:
        raise UserError(f"{folder} has the format {shortened(manifest['format'])}, not {FORMAT!r}")
    _check_names(path, manifest["files"], _OF_DATASET, _IN_DATASET)
    _check_names(path, manifest["sequences"], _SEQUENCE, ())
    return manifest


def _check_names(
    path: Path, names: Iterable[str], allowed: re.Pattern[str], needed: tuple[str, ...]
) -> None:
    """Refuse names that the format does not have: they are joined to a folder's path."""
    for name in names:
        if not allowed.fullmatch(name):
            raise UserError(f"{path} names {shortened(name)}, which no dataset has; {MEND}")
        inside(path.parent, name, follow_links=True)  # links were checked when it was opened
    for name in needed:
        if name not in names:
            raise UserError(f"{path} does not name {name}; {MEND}")


@lru_cache(maxsize=1)
def made_with() -> dict[str, str]:
    """Versions that determine a dataset's bytes."""
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
    for name in manifest["files"]:
        synced(folder / name)
    text = json.dumps(manifest, indent=1, ensure_ascii=False) + "\n"
    write_whole(folder / MANIFEST, text.encode())
    synced(folder)
    return manifest


def own_files(folder: Path) -> list[str]:
    """Files of the user's own sensors and meshes in a dataset."""
    found = [*folder.glob(f"{SENSORS}/*/*"), *folder.glob(f"{OBJECTS}/*")]
    return sorted(path.relative_to(folder).as_posix() for path in found if path.is_file())


def read_files(sequence: Path) -> FileList:
    """Read the list of the files of a sequence's folder.

    Raises
    ------
    UserError
        When it is missing or damaged, or has a name that no file of a sequence has.
    """
    path = sequence / FILES
    listed = _read_json(path, FileList)
    _check_names(path, listed["files"], _OF_SEQUENCE, _IN_SEQUENCE)
    for key in (CASE, "motion"):
        if not isinstance(listed["values"].get(key, ""), str):
            raise UserError(f"{path} is damaged: values.{key} is no text; {MEND}")
    return listed


def _read_json(path: Path, kind: type[Content]) -> Content:
    try:
        return msgspec.json.decode(read_small(path), type=kind)
    except UserError as error:
        raise UserError(f"{path} is missing or damaged: {error}; {MEND}") from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise UserError(f"{path} is missing or damaged: {shortened(str(error))}; {MEND}") from None


def link(source: Path, target: Path) -> None:
    """Give a file another name: as a hard link if possible, else as a copy."""
    try:
        target.hardlink_to(source.resolve())  # a cache's link is resolved to its file
    except OSError:
        shutil.copyfile(source, target)


def file_digest(path: Path) -> str:
    """SHA-256 of a file.

    Raises
    ------
    UserError
        When it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror}; {MEND}") from None


def open_recipe(folder: Path) -> Recipe:
    """Load the recipe of a dataset's folder; its files must be inside the folder."""
    with located(f"{folder}"):
        check_named(folder / RECIPE, folder)
        for sensor in folder.glob(f"{SENSORS}/*/*.toml"):
            check_named(sensor, folder)
        return load_recipe(str(folder / RECIPE))


def check_named(path: Path, folder: Path) -> None:
    """Refuse a recipe, scene or sensor in a dataset that names files outside of it.

    Raises
    ------
    UserError
        For the first such file, and when `path` cannot be read.
    """
    home = os.path.abspath(folder)
    for name in _named_files(read_toml(path, f"file {path}")):
        if not Path(os.path.abspath(path.parent / name)).is_relative_to(home):
            raise UserError(f"{path} names {shortened(name)}, which is outside of the dataset")


def _named_files(values: Any, key: str = "") -> Iterator[str]:
    """Names of files below a key, and of shipped sensors, which have no suffix."""
    if isinstance(values, dict):
        for name, value in values.items():
            last = name.rpartition(".")[2]
            named = last.endswith(("sensor", "calibration", "mesh", "path"))
            yield from _named_files(value, last if named else key)
    elif isinstance(values, list):
        for value in values:
            yield from _named_files(value, key)
    elif key and isinstance(values, str):
        yield values


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
        alike = replace(before, sequences=recipe.sequences)
        if dump_recipe(alike) != dump_recipe(recipe):
            raise UserError(
                f"{folder} holds a dataset of another recipe, see its {RECIPE}: "
                f"{difference(recipe, alike)}"
            )
        if before.sequences > recipe.sequences:
            raise UserError(
                f"{folder} is to have {before.sequences} sequences; it can get more, not fewer"
            )
        _check_versions(folder)
    with disk_errors(folder / MANIFEST):
        (folder / MANIFEST).unlink(missing_ok=True)
    write_whole(path, dump_recipe(portable(recipe, folder)).encode())


def _check_versions(folder: Path) -> None:
    """Refuse an incomplete dataset of other versions; damaged lists are skipped."""
    others: list[dict[str, str]] = []
    for number in numbers_in(folder):
        with suppress(UserError):
            begun = read_files(folder / sequence_name(number))["versions"]
            if begun == made_with():
                return
            others.append(begun)
    if others:
        raise UserError(f"{folder} was begun with other versions: {_changes(others[0])}")


def _changes(begun: dict[str, str]) -> str:
    now = made_with()
    names = [name for name in {**begun, **now} if begun.get(name) != now.get(name)]
    return ", ".join(f"{name} {begun.get(name, '–')}, now {now.get(name, '–')}" for name in names)
