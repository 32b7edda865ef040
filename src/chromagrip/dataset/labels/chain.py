"""Labels of a sequence of the node model."""

from collections.abc import Iterable, Iterator
from functools import lru_cache

import numpy as np

from ...loop.sample import Sample
from ...model import node_friction
from ...output.processes import one_thread
from ...render import TruthMap, harmonic_map, load_sensor, marker_truth
from ...scene.scene import Scene
from ...sensing.camera import SimulatedCamera
from .columns import columns_of
from .shot import SLIPPING, Shot, common_values, marker_labels


def chain_shots(
    scene: Scene,
    samples: Iterable[Sample],
    camera: SimulatedCamera,
    truth: tuple[str, ...],
    clean: bool = False,
) -> Iterator[Shot]:
    """Frames of a run of the node model with their labels; clean ones have no noise."""
    sensor, tip = scene.build_sensor(), scene.build_fingertip()
    unloaded = marker_truth(sensor, camera.membrane(np.zeros((tip.nodes, 2))))
    carry = harmonic_map(sensor.shape, sensor.places, tip.nodes)
    pixels = _truth_map(scene.sensor, tip.nodes) if truth else None
    columns = columns_of("chain")
    with one_thread():
        for sample in samples:
            deformation, field = sample.state.deformation, sample.field
            membrane = camera.membrane(deformation.seen)
            friction = node_friction(tip, scene.build_object(sample.state.time), sample.state)
            on = np.where(field.contact, [field.normal, field.friction], 0.0)
            slips = field.contact & (abs(on[1]) >= SLIPPING * friction * on[0])
            markers = marker_labels(marker_truth(sensor, membrane), unloaded)
            # Both layers lie under the same forces.
            for name, force in zip(("normal_n", "friction_n"), carry.scalar(on.T).T, strict=True):
                markers[name] = np.tile(force, 2)
            nodes = (*1e3 * field.position.T, field.contact, field.normal, field.friction, friction)
            take = sample.state, sample.index
            yield Shot(
                image=camera.clean(*take) if clean else camera.expose(*take).image,
                values=common_values(
                    sample.index,
                    sample.applied,
                    sample.load,
                    sample.contact,
                    slips,
                    deformation.object_position,
                    deformation.rigid_part,
                ),
                markers=markers,
                nodes=dict(zip(columns.nodes, nodes, strict=True)),
                truth=pixels.images(truth, membrane, deformation.seen) if pixels else {},
            )


@lru_cache(maxsize=1)
def _truth_map(sensor: str, nodes: int) -> TruthMap:
    return TruthMap(load_sensor(sensor), nodes)
