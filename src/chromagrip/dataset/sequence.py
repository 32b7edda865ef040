"""One sequence of a dataset: its values are drawn, its scene is run, its pictures are labelled."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..loop.camera import SimulatedCamera
from ..loop.grasp import Sample, grasp
from ..model import GROSS_SLIP, ForceField, node_friction, rest_state
from ..output.processes import one_thread
from ..render import (
    MarkerTruth,
    Renderer,
    TruthMap,
    harmonic_map,
    load_sensor,
    marker_truth,
    open_renderer,
)
from ..scene.scene import Scene
from .recipe import Recipe, Values, drawn, scene_of

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Draws of a sequence before it is given up, where the node model cannot follow its scene.
_ATTEMPTS = 50
#: A node slips from this share of the friction that it can hold on.
SLIPPING = 0.98
#: Values of the column `slip_state`.
STATES = ("none", "stick", "incipient", "gross")


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


@dataclass(frozen=True, kw_only=True)
class Shot:
    """A frame with its labels.

    Attributes
    ----------
    image: of the camera, RGB, shape (H, W, 3)
    values: of the frame, by column of FRAME
    markers: by column of MARKERS, the first layer's before the second's, shape (2M,) or (M,)
    nodes: of the chain, by column of NODES, shape (N,)
    truth: labels of every pixel that the recipe has, by name; see `GroundTruth`
    """

    image: Image
    values: dict[str, float | int | str]
    markers: dict[str, NDArray[Any]]
    nodes: dict[str, NDArray[Any]]
    truth: dict[str, NDArray[Any]]


#: Columns of a frame, in order, with their meanings.
FRAME = {
    "frame": "number in the sequence",
    "time_s": "instant",
    "grip_n": "force of the gripper's drive",
    "load_n": "lateral load on the object",
    "normal_n": "ΣFn",
    "friction_n": "ΣFf",
    "mu": "µ of the contact",
    "margin": "Γ; NaN without contact",
    "slip_state": "none (no contact), stick, incipient or gross: slip of more than 0.2 mm so far",
    "slipped_share": "share of the nodes in contact that carry 98 % of what friction holds",
    "lateral_displacement_mm": "of the object over the fingertip, largest so far",
    "object_mm": "position of the object along x",
    "rigid_part_mm": "indentation",
    "contact_nodes": "nodes in contact",
}
#: Columns of the markers of a frame; lists of 2M, layer 0 (magenta) before 1 (yellow), or of M.
MARKERS = {
    "x_px": "centroid of the marker's outline in the image, to the right (2M)",
    "y_px": "the same, down (2M)",
    "projected_x_px": "where the marker's centre is projected to, to the right (2M)",
    "projected_y_px": "the same, down (2M)",
    "visible": "marker is there, faces the camera and lies in the image (2M)",
    "overlap": "share of the magenta marker that yellow covers (M)",
    "centre_x_mm": "centre in the sensor frame (2M)",
    "centre_y_mm": "the same (2M)",
    "centre_z_mm": "the same (2M)",
    "moved_x_mm": "motion of the centre since rest (2M)",
    "moved_y_mm": "the same (2M)",
    "moved_z_mm": "the same (2M)",
    "normal_n": "normal force at the marker's place, of a node's pitch of the chain (2M)",
    "friction_n": "friction there (2M)",
}
#: Columns of the nodes of the chain in a frame; lists of N.
NODES = {
    "node_x_mm": "place of each node in the sensor frame (N)",
    "node_z_mm": "the same (N)",
    "node_contact": "node counts as in contact: of these forces are the sums (N)",
    "node_normal_n": "normal force on each node (N)",
    "node_friction_n": "friction on each node, along the object's tangent (N)",
    "node_mu": "µ of the object at each node (N)",
}


def sequence(recipe: Recipe, number: int) -> Sequence:
    """Run the sequence of that number; the same recipe and number give the same sequence.

    Raises
    ------
    UserError
        When the node model cannot follow any of 50 draws.
    """
    for attempt in range(_ATTEMPTS):
        values = drawn(recipe, number, attempt)
        scene = scene_of(recipe, number, values)
        try:
            with one_thread():
                samples = list(grasp(scene, _camera(scene)))
        except UserError as error:
            reason = str(error)
            continue
        return Sequence(number=number, values=values, scene=scene, samples=samples)
    raise UserError(f"sequence {number}: {_ATTEMPTS} draws could not be run: {reason}")


def shots(recipe: Recipe, made: Sequence) -> tuple[Image, Iterator[Shot]]:
    """Picture of the unloaded sensor, and an iterator over the frames."""
    camera = _camera(made.scene)
    tip = made.scene.build_fingertip()
    rest = camera.expose_rest(rest_state(tip), 1)[0].image
    return rest, _shots(recipe, made, camera)


def _shots(recipe: Recipe, made: Sequence, camera: SimulatedCamera) -> Iterator[Shot]:
    scene = made.scene
    sensor, tip = scene.build_sensor(), scene.build_fingertip()
    unloaded = marker_truth(sensor, camera.membrane(np.zeros((tip.nodes, 2))))
    carry = harmonic_map(sensor.shape, sensor.places, tip.nodes)
    pixels = _truth_map(scene.sensor, tip.nodes) if recipe.truth else None
    with one_thread():
        for sample in made.samples:
            displacement = sample.state.deformation.seen
            membrane = camera.membrane(displacement)
            truth = marker_truth(sensor, membrane)
            obj = scene.build_object(sample.state.time)
            friction = node_friction(tip, obj, sample.state)
            field = sample.field
            on = np.where(field.contact, [field.normal, field.friction], 0.0)
            yield Shot(
                image=camera.expose(sample.state, sample.index).image,
                values=_values(sample, on, friction),
                markers=_markers(truth, unloaded, [carry.scalar(force) for force in on]),
                nodes=_nodes(field, friction),
                truth=pixels.images(recipe.truth, membrane, displacement) if pixels else {},
            )


def _values(sample: Sample, on: Array, friction: Array) -> dict[str, float | int | str]:
    contact = sample.field.contact
    held = friction * on[0]
    slips = contact & (abs(on[1]) >= SLIPPING * held)
    share = float(slips.sum() / contact.sum()) if contact.any() else 0.0
    moved = sample.slip.lateral_displacement
    state = "incipient" if share > 0.0 else "stick"
    state = "gross" if moved > GROSS_SLIP else state if contact.any() else "none"
    values = (
        sample.index,
        sample.state.time,
        sample.applied,
        sample.load,
        sample.field.total_normal,
        sample.field.total_friction,
        sample.friction,
        sample.field.safety_margin(sample.friction),
        state,
        share,
        1e3 * moved,
        1e3 * sample.state.deformation.object_position,
        1e3 * sample.state.deformation.rigid_part,
        int(contact.sum()),
    )
    return dict(zip(FRAME, values, strict=True))


def _nodes(field: ForceField, friction: Array) -> dict[str, NDArray[Any]]:
    places = 1e3 * field.position.T
    columns = (*places, field.contact, field.normal, field.friction, friction)
    return dict(zip(NODES, columns, strict=True))


def _markers(
    truth: MarkerTruth, unloaded: MarkerTruth, forces: list[Array]
) -> dict[str, NDArray[Any]]:
    moved = truth.centres - unloaded.centres
    columns = [
        *np.moveaxis(truth.image_centres, -1, 0),
        *np.moveaxis(truth.pixels, -1, 0),
        truth.visible,
        truth.overlap,
        *np.moveaxis(1e3 * truth.centres, -1, 0),
        *np.moveaxis(1e3 * moved, -1, 0),
        # Both layers lie under the same forces.
        *(np.stack([force, force]) for force in forces),
    ]
    return {name: column.ravel() for name, column in zip(MARKERS, columns, strict=True)}


def _camera(scene: Scene) -> SimulatedCamera:
    """Camera of a scene; its renderer stays open, for the next scene of the same sensor."""
    return SimulatedCamera(
        scene.build_sensor(),
        _renderer(scene.renderer, scene.sensor),
        scene.fingertip.nodes,
        scene.camera.noise_levels,
        scene.seed,
        scene.defects,
    )


@lru_cache(maxsize=1)
def _renderer(name: str, sensor: str) -> Renderer:
    return open_renderer(name, load_sensor(sensor))


@lru_cache(maxsize=1)
def _truth_map(sensor: str, nodes: int) -> TruthMap:
    return TruthMap(load_sensor(sensor), nodes)
