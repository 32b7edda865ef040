"""One sequence of a dataset: drawn values, the run of its scene, labelled pictures, its folder."""

import dataclasses
import hashlib
import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..folders import whole_folder
from ..loop.grasp import grasp
from ..loop.poses.moves import moves
from ..loop.sample import Sample, Truth
from ..model import SoftBody
from ..output.png import encode_png
from ..output.processes import one_thread
from ..render import (
    Flaws,
    Membrane,
    Renderer,
    camera_text,
    load_sensor,
    open_renderer,
)
from ..scene.scene import Scene, dump_scene, relative, seen_from
from ..sensing.camera import map_of
from ..sensing.sensor import TactileSensor, body_of
from .folder import CAMERA, FILES, FileList, file_digest, made_with, sequence_name
from .labels import Shot, columns_of
from .labels.frames import labelled
from .labels.reading import with_readings
from .labels.tables import (
    frame_meanings,
    frame_table,
    marker_meanings,
    marker_table,
    table_bytes,
)
from .pictures import REST
from .recipe import Recipe, Values, drawn, pose_of, scene_of

Image = NDArray[np.uint8]

#: Draws of a sequence before it is given up, where the body cannot follow its scene.
_ATTEMPTS = 50


@dataclass(frozen=True, kw_only=True)
class Sequence:
    """A sequence that was run, without its images.

    Attributes
    ----------
    number: number in the dataset
    values: drawn values
    scene: scene with these values
    samples: samples of the run, without images
    """

    number: int
    values: Values
    scene: Scene
    samples: list[Sample]


def sequence(recipe: Recipe, number: int) -> Sequence:
    """Run the sequence of that number; the same recipe and number give the same sequence.

    Raises
    ------
    UserError
        When the body cannot follow any of 50 draws.
    """
    for attempt in range(_ATTEMPTS):
        values = drawn(recipe, number, attempt)
        scene = scene_of(recipe, number, values)
        try:
            with one_thread():
                samples = simulated(scene, values)
        except UserError as error:
            reason = str(error)
            continue
        return Sequence(number=number, values=values, scene=scene, samples=samples)
    raise UserError(f"sequence {number}: {_ATTEMPTS} draws could not be run: {reason}")


def simulated(scene: Scene, values: Values) -> list[Sample]:
    """Frames of a scene with their truth, for the values that were drawn for it.

    Raises
    ------
    UserError
        When the body cannot follow it.
    """
    if values.get("motion") != "move":
        return list(grasp(scene, None))
    contacts = moves(scene, pose_of(values, scene))
    return [
        Sample(
            index=k,
            time=contact.state.time,
            readings=(),
            grip=math.nan,
            truth=Truth(now=contact),
        )
        for k, contact in enumerate(contacts)
    ]


def shots(recipe: Recipe, made: Sequence) -> tuple[Image, Iterator[Shot]]:
    """Picture of the unloaded sensor, and an iterator over the frames."""
    scene, sensor = made.scene, _sensor(made.scene)
    # A run begins where the object just touches.
    still = sensor.camera.expose_rest(made.samples[0].contact.state, 1)[0].image
    frames = labelled(scene, made.samples, sensor, recipe.truth)
    if recipe.reading:
        frames = with_readings(scene, recipe.reading, still, frames)
    return still, frames


def _sensor(scene: Scene) -> TactileSensor:
    """Sensor of a scene; its renderer stays open, for the next scene of the same sensor."""
    # What a map knows of a node does not depend on the frames before, so that sequences share it.
    design = scene.build_sensor()
    carrier = body_of(design, scene.build_body()).carrier
    places = Flaws(design, scene.defects, scene.seed).places
    shared = _map(scene.sensor, carrier) if places is None else None
    renderer = _renderer(scene.renderer, scene.sensor)
    return TactileSensor.of_scene(scene, lambda _: renderer, membrane_map=shared)


@lru_cache(maxsize=1)
def _renderer(name: str, sensor: str) -> Renderer:
    return open_renderer(name, load_sensor(sensor))


@lru_cache(maxsize=1)
def _map(sensor: str, carrier: int | SoftBody) -> Callable[[NDArray[np.float64]], Membrane]:
    """Map of markers that are where they were designed to be."""
    return map_of(load_sensor(sensor), carrier, None)


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
    keep(REST, encode_png(rest))
    rows: list[Shot] = []
    for shot in frames:
        index = int(shot.values["frame"])
        keep(f"frame-{index:03d}.png", encode_png(shot.image))
        if shot.truth:
            path = part / f"truth-{index:03d}.npz"
            np.savez_compressed(path, **shot.truth)  # type: ignore[arg-type]
            digests[path.name] = file_digest(path)
        # Pictures are on the disk; a long sequence must not keep them.
        rows.append(dataclasses.replace(shot, image=np.empty(0, np.uint8), truth={}))
    columns = columns_of(made.scene.body, bool(recipe.reading))
    keep("frames.parquet", table_bytes(frame_table(rows, columns), frame_meanings(columns)))
    keep("markers.parquet", table_bytes(marker_table(rows, columns), marker_meanings(columns)))
    listed: FileList = {
        "number": number,
        "versions": made_with(),
        "values": _plain(made.values, part),
        "files": dict(sorted(digests.items())),
    }
    (part / FILES).write_text(json.dumps(listed, indent=1, ensure_ascii=False) + "\n", "utf-8")


def was_drawn(recipe: Recipe, number: int, values: Values, folder: Path) -> bool:
    """Return True if the values in a sequence's `files.json` are those of one of its draws."""
    draws = (drawn(recipe, number, attempt) for attempt in range(_ATTEMPTS))
    return any(json.loads(json.dumps(_plain(one, folder))) == values for one in draws)


def _plain(values: Values, folder: Path) -> Values:
    """Values for JSON: infinity as text, files relative to the folder."""
    plain: Values = _finite(values)
    if "sensor" in plain:
        plain["sensor"] = seen_from(folder, plain["sensor"])
    if "object.mesh" in plain:
        plain["object.mesh"] = relative(plain["object.mesh"], folder)
    own: Values = plain.get("object", {})
    if own.get("mesh"):
        return plain | {"object": {**own, "mesh": relative(own["mesh"], folder)}}
    return plain


def _finite(value: Any) -> Any:
    """Value with infinity as text, in tables too."""
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    return str(value) if isinstance(value, float) and not np.isfinite(value) else value
