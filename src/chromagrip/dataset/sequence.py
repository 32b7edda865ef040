"""One sequence of a dataset: its values are drawn, its scene is run, its pictures are labelled."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..loop.grasp import grasp
from ..loop.poses.moves import moves
from ..loop.sample import Sample, Truth
from ..model import SoftBody
from ..output.processes import one_thread
from ..render import DomeMap, Flaws, Renderer, add_noise, load_sensor, open_renderer
from ..scene.scene import Scene
from ..sensing.camera import REST_NUMBER
from ..sensing.sensor import TactileSensor
from .labels import Shot
from .labels.frames import labelled
from .labels.reading import with_readings
from .recipe import Recipe, Values, drawn, pose_of, scene_of

Image = NDArray[np.uint8]

#: Draws of a sequence before it is given up, where the body cannot follow its scene.
_ATTEMPTS = 50


@dataclass(frozen=True, kw_only=True)
class Sequence:
    """A sequence that was run, without its images.

    Attributes
    ----------
    number: in the dataset
    values: that were drawn
    scene: with these values
    samples: of the run, without images
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
    """Picture of the unloaded sensor, and an iterator over the frames.

    Without noise where the recipe stores them so; readings are of the noisy pictures all the same.
    """
    scene, sensor = made.scene, _sensor(made.scene)
    clean = recipe.store == "clean"
    # A run begins where the object just touches.
    rest = made.samples[0].contact.state
    frames = labelled(scene, made.samples, sensor, recipe.truth, clean)
    if not clean:
        still = sensor.camera.expose_rest(rest, 1)[0].image
        if recipe.reading:
            frames = with_readings(scene, recipe.reading, still, frames)
        return still, frames
    still = sensor.camera.clean_rest(rest)
    if recipe.reading:
        seen = _noisy(scene, still, REST_NUMBER)
        frames = with_readings(
            scene,
            recipe.reading,
            seen,
            frames,
            lambda shot: _noisy(scene, shot.image, int(shot.values["frame"])),
        )
    return still, frames


def _noisy(scene: Scene, clean: Image, index: int) -> Image:
    """Picture of that number with the camera's noise."""
    image = np.empty_like(clean)
    add_noise(clean, scene.camera.noise_levels, scene.seed, index, out=image)
    return image


def _sensor(scene: Scene) -> TactileSensor:
    """Sensor of a scene; its renderer stays open, for the next scene of the same sensor."""
    # What a map knows of a node does not depend on the frames before, so that sequences share it.
    dome = scene.build_dome() if scene.body == "dome" else None
    places = Flaws(scene.build_sensor(), scene.defects, scene.seed).places
    shared = _dome_map(scene.sensor, dome) if dome and places is None else None
    renderer = _renderer(scene.renderer, scene.sensor)
    return TactileSensor.of_scene(scene, lambda _: renderer, membrane_map=shared)


@lru_cache(maxsize=1)
def _renderer(name: str, sensor: str) -> Renderer:
    return open_renderer(name, load_sensor(sensor))


@lru_cache(maxsize=1)
def _dome_map(sensor: str, dome: SoftBody) -> DomeMap:
    """Map of markers that are where they were designed to be."""
    return DomeMap(load_sensor(sensor), dome)
