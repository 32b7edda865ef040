"""Variations of the training against a skin that is moved with points in space."""

from collections.abc import Callable
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from chromagrip.calibrate.variations import (
    Variations,
    varied_shifts,
)
from chromagrip.measure.worlds.beyond.carried_skin import CarriedSkin, Motion
from chromagrip.model import ContactObject, Fingertip, equilibrium
from chromagrip.render import (
    Membrane,
    MembraneMap,
    SensorDesign,
    areas,
    centroids,
    load_sensor,
    outlines,
)

SENSOR = load_sensor("thesis")
TIP = Fingertip()
CHAIN = equilibrium(TIP, ContactObject(curvature=60.0, friction=0.8), 2.0, 0.7).deformation.seen
REACH, DECAY = 0.4, 3.0


class Turned(CarriedSkin):
    """A skin whose twist falls off as the training's does."""

    def _turning(self, rest: np.ndarray, displacement: np.ndarray) -> np.ndarray:
        theta = np.arccos(np.clip(rest[:, 2], -1.0, 1.0))
        return (1.0 + (theta / REACH) ** 4) ** (-DECAY / 4.0)


def seen(
    skin: Callable[[np.ndarray], Membrane], chain: np.ndarray, sensor: SensorDesign = SENSOR
) -> np.ndarray:
    """Places and log sizes (P, 6) of the markers."""
    image = outlines(skin(chain), sensor.view)
    sizes = 0.5 * np.log(areas(image, False))[..., None]
    return np.concatenate([*np.concatenate([centroids(image, False), sizes], axis=-1)], axis=-1)


def test_a_twist_turns_the_skin_about_the_axis_where_it_has_moved_to() -> None:
    twist = np.deg2rad(8.0)
    shape = {"twist": twist, "twist_reach": REACH, "twist_decay": DECAY}
    given = {name: np.array([value]) for name, value in shape.items()}
    variations = replace(Variations.none(1), **given)
    found = varied_shifts(SENSOR, SENSOR.places, TIP, CHAIN[None], variations)[0]
    expected = seen(Turned(SENSOR, TIP.nodes, Motion(twist=twist)), CHAIN)
    expected -= seen(CarriedSkin(SENSOR, TIP.nodes, Motion()), np.zeros_like(CHAIN))
    places, sizes = [0, 1, 3, 4], [2, 5]
    np.testing.assert_allclose(found[:, places], expected[:, places], atol=2e-3)
    np.testing.assert_allclose(found[:, sizes], expected[:, sizes], atol=3e-3)
    assert abs(expected[:, places]).max() > 5.0


INK = msgspec.structs.replace(SENSOR.markers, stretch=0.6, swell_mm=1.5)
#: Domes whose markers swell, stretch, or do neither; layers that follow, and that do not.
SENSORS = [load_sensor("dome-2020"), msgspec.structs.replace(SENSOR, markers=INK)]


@pytest.mark.parametrize("sensor", SENSORS, ids=["2020", "ink"])
def test_without_variations_markers_move_as_they_are_drawn(sensor: SensorDesign) -> None:
    """The training's formulas are vectors, the renderer's a kernel of its own."""
    tip = Fingertip.of_radius(sensor.shape.radius, nodes=251, law="split")
    state = equilibrium(tip, ContactObject(curvature=60.0, friction=0.8), 4.0, 1.4)
    chain, drawn = state.deformation.seen, MembraneMap(sensor, tip.nodes)
    expected, rest = (seen(drawn, move, sensor) for move in (chain, np.zeros_like(chain)))
    found = varied_shifts(sensor, sensor.places, tip, chain[None], Variations.none(1))[0]
    np.testing.assert_allclose(found, expected - rest, atol=2e-4)
    assert abs(found[:, [0, 1]]).max() > 1.0
    assert abs(found[:, 2]).max() > 0.02
