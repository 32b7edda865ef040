"""Verification of a dataset: its files, its numbers, and their physics."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..extras import need
from ..model.chain import chain, contact
from ..model.kernels import contact_frames
from ..render import View
from ..scene.scene import Scene, load_scene
from .folder import (
    FILES,
    file_digest,
    open_recipe,
    read_files,
    read_manifest,
    sequence_name,
)
from .read import stacked
from .sequence import FRAME, NODES, STATES

Array = NDArray[np.float64]

#: Tolerance of forces' sums and friction cones, as a share of the largest force …
_SHARE = 1e-4
#: … and at least [N].
_LEAST = 1e-5
#: Tolerance of Γ against its forces: rounding.
_MARGIN = 1e-6
#: Tolerance of projected centres [px]: rounding to float32.
_PIXEL = 0.002
#: Γ may be below 0 by this much in gross slip, where friction is found by iteration.
_OVER = 1e-3
#: Tolerance of the balance of forces, as a share of the largest grip or load.
_BALANCE = 0.05
#: Largest distance of an outline's centroid from its projected centre, by perspective [px].
_PERSPECTIVE = 1.0


def check(folder: Path, progress: Callable[[int, int], None] = lambda done, total: None) -> int:
    """Verify a dataset's checksums, counts, ranges and physics; returns its number of sequences.

    Raises
    ------
    UserError
        With the first sample that is wrong, and why.
    """
    manifest = read_manifest(folder)
    for name, digest in manifest["files"].items():
        if not (folder / name).is_file():
            raise UserError(f"{folder / name} is missing")
        if file_digest(folder / name) != digest:
            raise UserError(f"{folder / name} has changed")
    recipe = open_recipe(folder)
    names = manifest["sequences"]
    for done, (name, digest) in enumerate(names.items()):
        check_files(folder / name, digest)
        listed = read_files(folder / name)
        number = listed["number"]
        if listed["versions"] != manifest["versions"]:
            raise UserError(f"{folder / name} was made with other versions than the rest")
        if sequence_name(number) != name or number >= recipe.sequences:
            raise UserError(f"{folder / name} is not sequence {number} of its recipe")
        for wrong in _wrong(folder / name):
            raise UserError(f"{folder / name}, {wrong}")
        progress(done + 1, len(names))
    return len(names)


def check_files(folder: Path, digest: str) -> None:
    """Verify the files of a sequence whose `files.json` has this checksum.

    Raises
    ------
    UserError
        With the first file that is missing, has changed or does not belong there.
    """
    if not (folder / FILES).is_file():
        raise UserError(f"{folder / FILES} is missing")
    if file_digest(folder / FILES) != digest:
        raise UserError(f"{folder / FILES} has changed")
    listed = read_files(folder)["files"]
    there = {path.name for path in folder.iterdir()} - {FILES}
    for name in sorted(there ^ set(listed)):
        what = "is missing" if name in listed else "does not belong there"
        raise UserError(f"{folder / name} {what}")
    for name, expected in listed.items():
        if file_digest(folder / name) != expected:
            raise UserError(f"{folder / name} has changed")


def _wrong(folder: Path) -> Iterator[str]:
    """Yield what is wrong with a sequence, frame by frame."""
    try:
        scene = load_scene(str(folder / "scene.toml"))
    except UserError as error:
        yield str(error)
        return
    pq = need("pyarrow.parquet", "data")
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
    columns = {name: stacked(markers[name]) for name in markers.column_names[1:]}
    for index in range(count):
        row = {name: values[index] for name, values in frames.items()}
        own = {name: column[index] for name, column in columns.items()}
        for wrong in (
            *_wrong_values(row, own),
            *_wrong_places(view, own),
            *_wrong_picture(view, folder / f"frame-{index:03d}.png"),
        ):
            yield f"frame {index}: {wrong}"
    yield from _unbalanced(scene, frames, columns)


def _unbalanced(
    scene: Scene, frames: dict[str, list[Any]], columns: dict[str, NDArray[Any]]
) -> Iterator[str]:
    """Yield frames in which forces on the fingertip or the object do not balance.

    Grip, load, contact and dampers to ground act on them; there is no inertia. The force of a
    damper follows from the motion between two frames, so that impulses over each interval are
    compared. The object's shape turns contact forces into x and z; of a surface that stays the
    object feels friction alone.
    """
    if scene.frames < 3:
        return
    tip = scene.build_fingertip()
    ch, rest = chain(tip), tip.rest_positions()
    at, on = np.empty((2, scene.frames, 2))
    column = {name: columns[name].astype(float) for name in NODES}
    rigid, moved = 1e-3 * np.array(frames["rigid_part_mm"]), 1e-3 * np.array(frames["object_mm"])
    for k, time in enumerate(frames["time_s"]):
        obj = scene.build_object(time)
        seen = 1e-3 * np.column_stack([column["node_x_mm"][k], column["node_z_mm"][k]])
        ground = seen + np.array([0.0, rigid[k]])
        ct = contact(tip, obj)
        _, normal = contact_frames(ct, ground, moved[k])
        tangent = np.column_stack([-normal[:, 1], normal[:, 0]])
        pressed = column["node_normal_n"][k] @ normal
        rubbed = column["node_friction_n"][k] @ tangent
        on[k, 0] = frames["load_n"][k] - ct.travel * pressed[0] - rubbed[0]
        on[k, 1] = frames["grip_n"][k] + pressed[1] + rubbed[1]
        # The outer nodes are held by the rigid part.
        inner = ch.damping[1:-1] @ (ground - rest)[1:-1, 1]
        at[k] = obj.drag * moved[k], inner + ch.damping_rigid * rigid[k]
    off = abs(np.diff(at, axis=0) / scene.period - (on[1:] + on[:-1]) / 2)
    # The mean of both ends is off by a twelfth of the second difference.
    bend = np.pad(abs(np.diff(on, 2, axis=0)), ((1, 1), (0, 0)), mode="edge")
    off -= np.maximum(bend[1:], bend[:-1]) / 12.0
    off -= _BALANCE * max(*frames["grip_n"], *np.abs(frames["load_n"]))
    # The first interval is left out: the fingertip touches down somewhere within it.
    for k, axis in np.argwhere(off[1:] > 0.0):
        yield f"frame {k + 2}: forces along {'xz'[axis]} do not balance since the frame before"


def _wrong_values(row: dict[str, Any], own: dict[str, NDArray[Any]]) -> Iterator[str]:
    """Yield what is wrong with sums of forces, friction cones and the margin."""
    if row["slip_state"] not in STATES:
        yield f"slip_state is {row['slip_state']!r}"
    normal, friction, mu = (
        own[f"node_{name}"].astype(float) for name in ("normal_n", "friction_n", "mu")
    )
    slack = max(_SHARE * float(abs(normal).max(initial=0.0)), _LEAST)
    if (normal < 0.0).any():
        yield "a node's normal force is negative"
    if (abs(friction) > mu * normal + slack).any():
        yield "friction on a node is more than µ times its normal force"
    slack *= max(len(normal), 1) ** 0.5
    touching = own["node_contact"].astype(bool)
    sums = normal[touching].sum(), abs(friction[touching].sum())
    for name, total in zip(("normal_n", "friction_n"), sums, strict=True):
        if abs(row[name] - total) > slack:
            yield f"{name} is {row[name]:.6g}, the nodes' sum {total:.6g}"
    if row["contact_nodes"] != touching.sum():
        yield f"contact_nodes is {row['contact_nodes']}, {touching.sum()} nodes are in contact"
    held = row["mu"] * row["normal_n"]
    margin = 1.0 - row["friction_n"] / held if row["contact_nodes"] else np.nan
    if not np.isclose(row["margin"], margin, atol=_MARGIN, equal_nan=True):
        yield f"margin is {row['margin']:.6g}, its forces say {margin:.6g}"
    if row["margin"] < -_OVER:
        yield f"margin is {row['margin']:.3g}: friction holds more than it can"
    if not 0.0 <= row["slipped_share"] <= 1.0:
        yield f"slipped_share is {row['slipped_share']}"


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


def _wrong_picture(view: View, path: Path) -> Iterator[str]:
    image = cv2.imread(str(path))
    if image is None:
        yield "the picture cannot be read"
    elif image.shape != (view.height, view.width, 3):
        yield f"the picture has the shape {image.shape}"
