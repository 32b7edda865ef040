"""Whether a dataset is what it says: its files, its numbers, and the physics in them."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from .dataset_folder import (
    FILES,
    RECIPE,
    DatasetError,
    file_digest,
    open_recipe,
    read_json,
    read_manifest,
    sequence_name,
)
from .dataset_sequence import FRAME, STATES
from .errors import SceneError
from .render import View
from .scene import load_scene

Array = NDArray[np.float64]

#: Of sums and cones, as a share of the largest force and at least [N]; of Γ; of pixels [px].
_SHARE, _LEAST, _MARGIN, _PIXEL = 1e-4, 1e-5, 1e-6, 0.002
#: By how much Γ may be below 0, where all slips.
_OVER = 1e-3
#: Perspective moves the middle of an outline by at most so much [px].
_PERSPECTIVE = 1.0


def check(folder: Path, progress: Callable[[int, int], None] = lambda done, total: None) -> int:
    """Verify a dataset's checksums, counts, ranges and physics; how many sequences it has.

    Raises
    ------
    DatasetError
        With the first sample that is not right, and what is wrong with it.
    """
    manifest, recipe = read_manifest(folder), open_recipe(folder)
    if file_digest(folder / RECIPE) != manifest["recipe"]:
        raise DatasetError(f"{folder / RECIPE} is not the recipe that it was made from")
    names = manifest["sequences"]
    for done, (name, digest) in enumerate(names.items()):
        if not (folder / name).is_dir():
            raise DatasetError(f"{folder / name} is missing")
        _check_files(folder / name, digest)
        number = read_json(folder / name / FILES)["number"]
        if sequence_name(number) != name or number >= recipe.sequences:
            raise DatasetError(f"{folder / name} is not sequence {number} of its recipe")
        for wrong in _wrong(folder / name):
            raise DatasetError(f"{folder / name}, {wrong}")
        progress(done + 1, len(names))
    return len(names)


def _check_files(folder: Path, digest: str) -> None:
    if file_digest(folder / FILES) != digest:
        raise DatasetError(f"{folder / FILES} has changed")
    listed = read_json(folder / FILES)["files"]
    there = {path.name for path in folder.iterdir()} - {FILES}
    for name in sorted(there ^ set(listed)):
        what = "is missing" if name in listed else "does not belong there"
        raise DatasetError(f"{folder / name} {what}")
    for name, expected in listed.items():
        if file_digest(folder / name) != expected:
            raise DatasetError(f"{folder / name} has changed")


def _wrong(folder: Path) -> Iterator[str]:
    """What is wrong with a sequence, frame by frame."""
    try:
        scene = load_scene(str(folder / "scene.toml"))
    except SceneError as error:
        yield str(error)
        return
    frames = pq.read_table(folder / "frames.parquet").to_pydict()
    markers = pq.read_table(folder / "markers.parquet")
    if list(frames) != list(FRAME):
        yield f"frames.parquet: columns {list(frames)}, expected {list(FRAME)}"
        return
    count, view = scene.frames, scene.build_sensor().view
    pictures = len(list(folder.glob("frame-*.png")))
    if not (len(frames["frame"]) == markers.num_rows == pictures == count):
        yield (
            f"{pictures} pictures, {len(frames['frame'])} rows of frames and {markers.num_rows} of "
            f"markers; the scene has {count}"
        )
        return
    for index in range(count):
        row = {name: values[index] for name, values in frames.items()}
        own = {name: _numbers(markers[name], index) for name in markers.column_names[1:]}
        for wrong in (
            *_wrong_values(row, own),
            *_wrong_places(view, own),
            *_wrong_picture(view, folder / f"frame-{index:03d}.png"),
        ):
            yield f"frame {index}: {wrong}"


def _numbers(column: Any, index: int) -> NDArray[Any]:
    return np.asarray(column[index].values.to_numpy(zero_copy_only=False))


def _wrong_values(row: dict[str, Any], own: dict[str, NDArray[Any]]) -> Iterator[str]:
    """Sums, cones and the margin."""
    if row["slip_state"] not in STATES:
        yield f"slip_state is {row['slip_state']!r}"
    normal, friction, mu = (
        own[f"node_{name}"].astype(float) for name in ("normal_n", "friction_n", "mu")
    )
    slack = max(_SHARE * float(abs(normal).max(initial=0.0)), _LEAST)
    if (normal < 0.0).any():
        yield "a node is pulled at"
    if (abs(friction) > mu * normal + slack).any():
        yield "friction on a node is more than µ times its normal force"
    slack *= max(len(normal), 1) ** 0.5
    for name, total in (("normal_n", normal.sum()), ("friction_n", abs(friction.sum()))):
        if abs(row[name] - total) > slack:
            yield f"{name} is {row[name]:.6g}, the nodes' sum {total:.6g}"
    carrying = int((normal > 0.0).sum())
    if row["contact_nodes"] != carrying:
        yield f"contact_nodes is {row['contact_nodes']}, {carrying} nodes carry something"
    held = row["mu"] * row["normal_n"]
    margin = 1.0 - row["friction_n"] / held if row["contact_nodes"] else np.nan
    if not np.isclose(row["margin"], margin, atol=_MARGIN, equal_nan=True):
        yield f"margin is {row['margin']:.6g}, its forces say {margin:.6g}"
    if row["margin"] < -_OVER:
        yield f"margin is {row['margin']:.3g}: friction holds more than it can"
    if not 0.0 <= row["slipped_share"] <= 1.0:
        yield f"slipped_share is {row['slipped_share']}"


def _wrong_places(view: View, own: dict[str, NDArray[Any]]) -> Iterator[str]:
    """Labels in the image beside the projection of the centres, and overlaps."""
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


def _wrong_picture(view: View, path: Path) -> Iterator[str]:
    image = cv2.imread(str(path))
    if image is None:
        yield "the picture cannot be read"
    elif image.shape != (view.height, view.width, 3):
        yield f"the picture has the shape {image.shape}"
