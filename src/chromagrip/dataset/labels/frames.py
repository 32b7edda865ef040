"""Labels of the frames of a sequence with a chain or a silicone body."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ...loop.sample import Sample
from ...model import Fingertip, SoftBody, margin_within, node_friction
from ...model.dome import SkinField, lattice
from ...output.processes import one_thread
from ...render import TruthMap, harmonic_map, load_sensor, marker_truth
from ...scene.scene import Body, Scene
from ...sensing.contact import of_chain, of_dome
from ...sensing.sensor import TactileSensor
from .columns import columns_of
from .shot import SLIPPING, Shot, common_values, marker_labels

Array = NDArray[np.float64]
Labels = dict[str, NDArray[Any]]
#: Values of a frame, labels of its nodes, and body-specific labels of its markers.
Own = tuple[dict[str, float | int | str], Labels, Labels]


def labelled(
    scene: Scene,
    samples: Iterable[Sample],
    sensor: TactileSensor,
    truth: tuple[str, ...],
) -> Iterator[Shot]:
    """Render the frames of a run with their labels.

    Parameters
    ----------
    scene: scene of the run
    samples: samples of the run, with their truth
    sensor: sensor that takes the pictures
    truth: names of the per-pixel labels to compute
    """
    design, camera = sensor.design, sensor.camera
    own = _OWN[scene.body](scene)
    pixels = _truth_map(scene.sensor, sensor.body.carrier) if truth else None
    unloaded = None
    with one_thread():
        for sample in samples:
            contact = sample.contact
            sensor.show(contact, contact, sample.index)
            drive = contact.state.carried
            if unloaded is None:
                unloaded = marker_truth(design, camera.membrane(np.zeros_like(drive)))
            values, nodes, more = own(sample)
            yield Shot(
                image=sensor.data.image,
                values=values,
                markers=marker_labels(sensor.data.markers, unloaded) | more,
                nodes=nodes,
                truth=_images(pixels, truth, sensor, scene) if pixels else {},
            )


def _of_chain(scene: Scene, tip: Fingertip, carry: Callable[[Array], Array], sample: Sample) -> Own:
    """Labels of a frame of a chain; the forces at both markers of a pair are the same.

    Parameters
    ----------
    carry: map from forces on nodes to forces at markers
    """
    contact, field = sample.contact, sample.contact.field
    _, state, _ = of_chain(contact)
    friction = node_friction(tip, scene.build_object(state.time), state)
    on = np.where(field.contact, [field.normal, field.friction], 0.0)
    slips = field.contact & (abs(on[1]) >= SLIPPING * friction * on[0])
    values = common_values(sample, sample.applied, sample.load, slips)
    nodes = (*1e3 * field.position.T, field.contact, field.normal, field.friction, friction)
    forces = carry(on.T).T
    markers = {
        name: np.tile(force, 2)
        for name, force in zip(("normal_n", "friction_n"), forces, strict=True)
    }
    return values, dict(zip(columns_of("chain").nodes, nodes, strict=True)), markers


def _of_dome(dome: SoftBody, sample: Sample) -> Own:
    """Labels of a frame of a silicone body."""
    contact, areas = sample.contact, lattice(dome).areas
    _, state, _ = of_dome(contact)
    # Near the object, take the solved positions of nodes.
    places = lattice(dome).points + skin_field(dome)(state.carried)
    places[state.near] = contact.field.position[state.near]
    field = replace(contact.field, position=places)
    assert field.directions is not None
    held = contact.friction * field.normal
    slips = field.contact & (field.friction_sizes >= SLIPPING * held)
    forces = field.normal[:, None] * field.directions + field.friction
    on = np.flatnonzero(forces.any(axis=1))
    force, torque = forces.sum(axis=0), np.cross(places[on], forces[on]).sum(axis=0)
    press, across = -float(force[2]), float(np.hypot(*force[:2]))
    values = common_values(
        sample,
        press if np.isnan(sample.applied) else sample.applied,
        across if np.isnan(sample.load) else sample.load,
        slips,
    )
    columns = columns_of("dome")
    turn = Rotation.from_matrix(state.rotation).as_rotvec()
    own = (margin_within(field, contact.friction), *force, *1e3 * torque, *1e3 * state.place, *turn)
    values |= dict(zip(list(columns.frame)[len(values) :], map(float, own), strict=True))
    nodes = (
        *1e3 * field.position.T,
        field.contact,
        slips,
        field.normal,
        *field.directions.T,
        *field.friction.T,
        1e6 * areas,
    )
    return values, dict(zip(columns.nodes, nodes, strict=True)), {}


def _chain_labels(scene: Scene) -> Callable[[Sample], Own]:
    """Make the function that labels a frame of a scene's chain."""
    design, tip = scene.build_sensor(), scene.build_fingertip()
    carry = harmonic_map(design.shape, design.places, tip.nodes).scalar
    return partial(_of_chain, scene, tip, carry)


#: For each body: maker of the function that labels a frame of a scene.
_OWN: dict[Body, Callable[[Scene], Callable[[Sample], Own]]] = {
    "chain": _chain_labels,
    "dome": lambda scene: partial(_of_dome, scene.build_dome()),
}


def _images(
    pixels: TruthMap, names: tuple[str, ...], sensor: TactileSensor, scene: Scene
) -> Labels:
    """Compute per-pixel labels; only a dome has `traction` [Pa], (H, W, 3), and `contact`."""
    drive = sensor.data.contact.state.carried
    plain = [name for name in names if name not in ("traction", "contact")]
    images: Labels = dict(pixels.images(plain, sensor.camera.membrane(drive), drive))
    if len(plain) < len(names):
        _, state, _ = of_dome(sensor.data.contact)
        areas = lattice(scene.build_dome()).areas
        traction = pixels.skin_image(drive, state.forces / areas[:, None])
        images |= {"traction": traction, "contact": np.nan_to_num(abs(traction)).max(axis=-1) > 0.0}
    return {name: images[name] for name in names}


@lru_cache(maxsize=1)
def skin_field(dome: SoftBody) -> SkinField:
    """Map from forces on silicone to displacements of its skin; cached for the next frame."""
    return SkinField(dome)


@lru_cache(maxsize=1)
def _truth_map(sensor: str, body: int | SoftBody) -> TruthMap:
    """Make the per-pixel labeller of a sensor; cached for the next sequence."""
    return TruthMap(load_sensor(sensor), body)
