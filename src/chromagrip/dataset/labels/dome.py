"""Labels of a sequence of a dome of silicone."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ...loop.sample import Sample
from ...model import DomeState, SoftBody, margin_within
from ...model.dome import SkinField, lattice
from ...output.processes import one_thread
from ...render import Membrane, TruthMap, load_sensor, marker_truth
from ...scene.scene import Scene
from ...sensing.camera import SimulatedCamera, carried
from .columns import columns_of
from .shot import SLIPPING, Shot, common_values, marker_labels

Array = NDArray[np.float64]


def dome_shots(
    scene: Scene,
    samples: Iterable[Sample],
    camera: SimulatedCamera,
    truth: tuple[str, ...],
    clean: bool = False,
) -> Iterator[Shot]:
    """Frames of a run of a dome with their labels; clean ones have no noise."""
    sensor, dome = scene.build_sensor(), scene.build_dome()
    areas = lattice(dome).areas
    unloaded = marker_truth(sensor, camera.membrane(np.zeros((len(areas), 3))))
    pixels = _truth_map(scene.sensor, dome) if truth else None
    with one_thread():
        for sample in samples:
            state = sample.contact.state
            assert isinstance(state, DomeState)
            drive = carried(state)
            membrane = camera.membrane(drive)
            values, nodes = _of_contact(sample, dome, areas)
            take = state, sample.index
            yield Shot(
                image=camera.clean(*take) if clean else camera.expose(*take).image,
                values=values,
                markers=marker_labels(marker_truth(sensor, membrane), unloaded),
                nodes=nodes,
                truth=_images(pixels, truth, membrane, drive, state, areas) if pixels else {},
            )


def _of_contact(
    sample: Sample, dome: SoftBody, areas: Array
) -> tuple[dict[str, float | int | str], dict[str, NDArray[Any]]]:
    """Values of a frame and labels of the nodes."""
    truth, state = sample.contact, sample.contact.state
    assert isinstance(state, DomeState)
    # Near the object its nodes are where they were solved for.
    places = lattice(dome).points + _skin_field(dome)(carried(state))
    places[state.near] = truth.field.position[state.near]
    field = replace(truth.field, position=places)
    assert field.directions is not None
    held = truth.friction * field.normal
    slips = field.contact & (field.friction_sizes >= SLIPPING * held)
    forces = field.normal[:, None] * field.directions + field.friction
    on = np.flatnonzero(forces.any(axis=1))
    force, torque = forces.sum(axis=0), np.cross(places[on], forces[on]).sum(axis=0)
    press, across = -float(force[2]), float(np.hypot(*force[:2]))
    values = common_values(
        sample.index,
        press if np.isnan(sample.applied) else sample.applied,
        across if np.isnan(sample.load) else sample.load,
        truth,
        slips,
        truth.place[0],
        truth.indentation,
    )
    columns = columns_of("dome")
    turn = Rotation.from_matrix(state.rotation).as_rotvec()
    own = (margin_within(field, truth.friction), *force, *1e3 * torque, *1e3 * state.place, *turn)
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
    return values, dict(zip(columns.nodes, nodes, strict=True))


def _images(
    pixels: TruthMap,
    names: tuple[str, ...],
    membrane: Membrane,
    drive: Array,
    state: DomeState,
    areas: Array,
) -> dict[str, NDArray[Any]]:
    """Labels of every pixel: `traction` [Pa], (H, W, 3), and `contact`, (H, W), are a dome's."""
    plain = [name for name in names if name not in ("traction", "contact")]
    images: dict[str, NDArray[Any]] = dict(pixels.images(plain, membrane, drive))
    if len(plain) < len(names):
        traction = pixels.skin_image(drive, state.forces / areas[:, None])
        images |= {"traction": traction, "contact": np.nan_to_num(abs(traction)).max(axis=-1) > 0.0}
    return {name: images[name] for name in names}


@lru_cache(maxsize=1)
def _skin_field(dome: SoftBody) -> SkinField:
    return SkinField(dome)


@lru_cache(maxsize=1)
def _truth_map(sensor: str, dome: SoftBody) -> TruthMap:
    return TruthMap(load_sensor(sensor), dome)
