"""Verification of a dataset: its files, its numbers, and their physics."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..extras import need
from ..render import View
from ..scene.scene import Body, load_scene
from .folder import FILES, Place, open_recipe, read_files
from .frozen import content_of, frozen_as
from .labels import Columns, columns_of
from .labels.chain_physics import lawful_chain, wrong_chain
from .labels.dome_physics import lawful_dome, wrong_dome
from .labels.laws import Stored, differences, impossible, missing
from .labels.reading import read_again
from .labels.tables import stacked
from .pictures import Pictures, pictures_in
from .read import check_shared, verified
from .recipe import Values
from .remote import fetched
from .sequence import simulated, was_drawn
from .split import drawn_table


def check(
    folder: Place,
    progress: Callable[[int, int], None] = lambda done, total: None,
    *,
    follow_links: bool = False,
) -> int:
    """Verify a dataset's checksums, counts, ranges and physics; returns its number of sequences.

    Pictures and labels of a frozen recipe must equal the recorded ones, except for rounding.

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
    frozen = frozen_as(recipe)
    names = manifest["sequences"]
    drawn_table(folder, list(names))
    for done, (name, one) in enumerate(zip(names, verified(folder), strict=True)):
        if read_files(folder / name)["versions"] != manifest["versions"]:
            raise UserError(f"{folder / name} was made with other versions than the rest")
        if one.number >= recipe.sequences:
            raise UserError(f"{folder / name} is not sequence {one.number} of its recipe")
        if not was_drawn(recipe, one.number, one.values, folder / name):
            raise UserError(
                f"{folder / name / FILES} is damaged: values are not those that the recipe draws"
            )
        for wrong in _wrong(folder / name, one.values, recipe.reading):
            raise UserError(f"{folder / name}, {wrong}")
        if frozen:
            like = frozen.likeness(name, content_of(folder / name))
            if like not in ("same", "rounded"):
                raise UserError(
                    f"{folder / name} has {like} than {frozen.name} was frozen with, so that "
                    "scores on it cannot be compared with those of others"
                )
        progress(done + 1, len(names))
    return len(names)


def _wrong(folder: Path, values: Values, reading: str) -> Iterator[str]:
    """Yield errors in the values of a sequence: file, frame, column, and the broken law.

    Parameters
    ----------
    folder: folder of the sequence
    values: drawn values of the sequence
    reading: reconstructor whose estimates are stored with the labels; empty: no estimates
    """
    try:
        scene = load_scene(str(folder / "scene.toml"))
    except UserError as error:
        yield str(error)
        return
    pq = need("pyarrow.parquet", "data")
    table, markers = (pq.read_table(folder / f"{of}.parquet") for of in ("frames", "markers"))
    columns = columns_of(scene.body, bool(reading))
    if table.column_names != list(columns.frame):
        yield f"frames.parquet: columns {table.column_names}, expected {list(columns.frame)}"
        return
    pictures = pictures_in(folder)
    if not (table.num_rows == markers.num_rows == len(pictures) == scene.frames):
        yield (
            f"{len(pictures)} pictures, {table.num_rows} rows of frames and "
            f"{markers.num_rows} of markers; the scene has {scene.frames}"
        )
        return
    view = scene.build_sensor().view
    for index in range(scene.frames):
        yield from (f"frame {index}: {wrong}" for wrong in _wrong_picture(view, pictures, index))
    stored = Stored(
        scene=scene,
        frames={name: table[name].to_numpy() for name in table.column_names},
        markers={name: stacked(markers[name]) for name in markers.column_names[1:]},
        again=simulated(scene, values),
    )
    if markers["frame"].to_pylist() != list(range(scene.frames)):
        yield "markers.parquet, frame: numbers are not those of the frames"
    driven = values.get("motion") != "move"
    read = read_again(scene, reading, pictures.rest, pictures) if reading else {}
    yield from wrong_values(stored, columns, driven, read)


def wrong_values(
    stored: Stored, columns: Columns, driven: bool, read: dict[str, NDArray[Any]]
) -> Iterator[str]:
    """Yield errors in the columns of a sequence.

    Parameters
    ----------
    stored: stored columns, of the right kinds and lengths
    columns: expected columns
    driven: whether grip and load move the object; otherwise its pose is prescribed
    read: columns estimated again from its pictures; empty: no estimates
    """
    kept = {"frames": stored.frames, "markers": stored.markers}
    of = {"frames": columns.frame, "markers": columns.nodes | columns.markers}
    absent = [f"{name}.parquet, {at}" for name in kept for at in missing(of[name], kept[name])]
    yield from absent
    if absent:  # the laws need all columns
        return
    lawful, wrong = _PHYSICS[stored.scene.body]
    with np.errstate(all="ignore"):
        frames, markers = lawful(stored)
        broken = wrong(stored, driven)
        for name, wrongs in (
            ("markers", differences(columns.nodes, stored.markers, markers)),
            ("frames", differences(columns.frame, stored.frames, frames | read)),
            ("markers", differences(columns.markers, stored.markers, markers)),
            ("frames", impossible(stored.frames)),
            ("markers", broken),
        ):
            yield from (f"{name}.parquet, {one}" for one in wrongs)


#: For each body: function of the columns that follow from others, and checks of its physics.
_PHYSICS: dict[Body, tuple[Callable[[Stored], Any], Callable[[Stored, bool], Iterator[str]]]] = {
    "chain": (lawful_chain, lambda stored, driven: wrong_chain(stored)),
    "dome": (lawful_dome, lambda stored, driven: wrong_dome(stored, driven=driven)),
}


def _wrong_picture(view: View, pictures: Pictures, index: int) -> Iterator[str]:
    try:
        image = pictures[index]
    except UserError as error:
        yield f"the picture cannot be read: {error}"
        return
    if image.shape != (view.height, view.width, 3):
        yield f"the picture has the shape {image.shape}"
