"""Verification of a dataset: its files, its numbers, and their physics."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..extras import need
from ..render import View
from ..scene.scene import load_scene
from .folder import Place, open_recipe, read_files
from .frozen import content_of, frozen_as
from .labels import INTERVALS, READ, columns_of
from .labels.chain_physics import unbalanced_chain, wrong_chain
from .labels.dome_physics import wrong_dome, wrong_motion
from .labels.tables import stacked
from .pictures import Pictures, pictures_in
from .read import check_shared, verified
from .remote import fetched
from .split import drawn_table

Array = NDArray[np.float64]

#: Tolerance of projected centres [px]: rounding to float32.
_PIXEL = 0.002
#: Largest distance of an outline's centroid from its projected centre, by perspective [px].
_PERSPECTIVE = 1.0


def check(
    folder: Place,
    progress: Callable[[int, int], None] = lambda done, total: None,
    *,
    follow_links: bool = False,
) -> int:
    """Verify a dataset's checksums, counts, ranges and physics; returns its number of sequences.

    Of a frozen recipe, pictures and labels must be those that are recorded, but for rounding.

    Parameters
    ----------
    folder: of the dataset, or its address
    progress: called with the number of sequences that are checked, and of all
    follow_links: whether links in the folder may lead out of it, as in caches of hubs

    Raises
    ------
    UserError
        With the first sample that is wrong, and why.
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
        motion = str(one.values.get("motion", "press"))
        for wrong in _wrong(folder / name, motion, bool(recipe.reading)):
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


def _wrong(folder: Path, motion: str, reading: bool) -> Iterator[str]:
    """Yield what is wrong with a sequence of that kind of motion, frame by frame."""
    try:
        scene = load_scene(str(folder / "scene.toml"))
    except UserError as error:
        yield str(error)
        return
    pq = need("pyarrow.parquet", "data")
    frames = pq.read_table(folder / "frames.parquet").to_pydict()
    markers = pq.read_table(folder / "markers.parquet")
    chain, expected = scene.body == "chain", list(columns_of(scene.body, reading).frame)
    if list(frames) != expected:
        yield f"frames.parquet: columns {list(frames)}, expected {expected}"
        return
    count, view = scene.frames, scene.build_sensor().view
    pictures = pictures_in(folder)
    if not (len(frames["frame"]) == markers.num_rows == len(pictures) == count):
        yield (
            f"{len(pictures)} pictures, {len(frames['frame'])} rows of frames and "
            f"{markers.num_rows} of markers; the scene has {count}"
        )
        return
    columns = {name: stacked(markers[name]) for name in markers.column_names[1:]}
    for index in range(count):
        row = {name: values[index] for name, values in frames.items()}
        own = {name: column[index] for name, column in columns.items()}
        for wrong in (
            *(wrong_chain(row, own) if chain else wrong_dome(row, own)),
            *_wrong_places(view, own),
            *_wrong_picture(view, pictures, index),
            *(_wrong_reading(row) if reading else ()),
        ):
            yield f"frame {index}: {wrong}"
    if chain:
        yield from unbalanced_chain(scene, frames, columns)
    else:
        yield from wrong_motion(scene, frames, columns, driven=motion != "move")


def _wrong_places(view: View, own: dict[str, NDArray[Any]]) -> Iterator[str]:
    """Yield image positions that are not the centres' projections, and impossible overlaps."""
    centres = np.stack([own[f"centre_{axis}_mm"] for axis in "xyz"], axis=-1).astype(float) * 1e-3
    projected = view.project(centres)
    for start, limit in (("projected_", _PIXEL), ("", _PERSPECTIVE)):
        pixels = np.stack([own[f"{start}x_px"], own[f"{start}y_px"]], axis=-1)
        off = np.linalg.norm(projected - pixels, axis=-1)
        worst = float(np.max(off, where=own["visible"].astype(bool), initial=0.0))
        if not worst < limit:
            yield f"{start}x_px, {start}y_px are {worst:.2f} px beside a centre's projection"
    overlap = own["overlap"][np.isfinite(own["overlap"])]
    if ((overlap < 0.0) | (overlap > 1.0)).any():
        yield "an overlap is not from 0 to 1"


def _wrong_reading(row: dict[str, Any]) -> Iterator[str]:
    """Yield estimates out of their own intervals, or beside a reason for having none."""
    for columns in INTERVALS.values():
        low, value, high = (row[name] for name in columns)
        if row[f"{READ}no_estimate"] and not np.isnan([low, value, high]).all():
            yield f"{columns[1]} has a value beside a reason for having none"
        if low > value or value > high:  # a NaN is in no order
            yield f"{columns[1]} is out of its interval"


def _wrong_picture(view: View, pictures: Pictures, index: int) -> Iterator[str]:
    try:
        image = pictures[index]
    except UserError as error:
        yield f"the picture cannot be read: {error}"
        return
    if image.shape != (view.height, view.width, 3):
        yield f"the picture has the shape {image.shape}"
