"""Verification of a dataset: its files, its numbers, and their physics."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..scene.scene import Body
from .folder import FILES, Place, open_recipe, read_files
from .frozen import content_of, frozen_as
from .labels import Columns, columns_of
from .labels.chain_physics import lawful_chain, wrong_chain
from .labels.dome_physics import lawful_dome, wrong_dome
from .labels.laws import Stored, differences, impossible, missing
from .labels.reading import read_again
from .read import Loaded, check_shared, verified
from .remote import fetched
from .sequence import simulated, was_drawn
from .split import drawn_rows


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
    drawn_rows(folder, list(names))
    for done, (name, one) in enumerate(zip(names, verified(folder), strict=True)):
        if read_files(folder / name)["versions"] != manifest["versions"]:
            raise UserError(f"{folder / name} was made with other versions than the rest")
        if one.number >= recipe.sequences:
            raise UserError(f"{folder / name} is not sequence {one.number} of its recipe")
        if not was_drawn(recipe, one.number, one.values, folder / name):
            raise UserError(
                f"{folder / name / FILES} is damaged: values are not those that the recipe draws"
            )
        for wrong in _wrong(one, recipe.reading):
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


def _wrong(one: Loaded, reading: str) -> Iterator[str]:
    """Yield errors in the values of a sequence: file, frame, column, and the broken law.

    Parameters
    ----------
    one: sequence, whose files are whole
    reading: reconstructor whose estimates are stored with the labels; empty: no estimates
    """
    scene, columns = one.scene, columns_of(one.scene.body, bool(reading))
    if list(one.frames) != list(columns.frame):
        yield f"frames.parquet: columns {list(one.frames)}, expected {list(columns.frame)}"
        return
    if len(one.pictures) != scene.frames:
        yield f"{len(one.pictures)} pictures; the scene has {scene.frames} frames"
        return
    for index in range(scene.frames):
        try:
            _ = one.pictures[index]
        except UserError as error:
            yield f"frame {index}: the picture cannot be read: {error}"
    stored = Stored(
        scene=scene,
        frames=one.frames,
        markers=one.markers,
        again=simulated(scene, one.values),
    )
    driven = one.values.get("motion") != "move"
    read = read_again(scene, reading, one.pictures.rest, one.pictures) if reading else {}
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
