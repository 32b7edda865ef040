"""Designs of one layer of markers: tracking takes them, everything else refuses them."""

from collections.abc import Callable
from subprocess import CompletedProcess

import numpy as np
import pytest
from scipy.spatial import KDTree

from chromagrip.errors import UserError
from chromagrip.render import Frame, SensorDesign, load_sensor, sensor_names
from chromagrip.render.colour import decode_srgb
from chromagrip.render.ground import inside_rim, pixel_places
from chromagrip.tracking import load_palette, load_tracker

from ..pictures.drawn_dots import covered, levels

Typed = Callable[..., CompletedProcess[str]]


def pictured(sensor: SensorDesign, shift: float) -> tuple[np.ndarray, np.ndarray]:
    """Picture of a design's markers, all moved by as many pixels to the right, and their places."""
    view, layer = sensor.view, sensor.magenta
    places = view.project(sensor.shape.points(sensor.places, sensor.depths[0]))
    places = places + np.array([shift, 0.0])
    middle = sensor.shape.points(np.array([[1e-6, 0.0]]), sensor.depths[0])
    gain = np.sqrt(np.linalg.det(view.jacobian(middle)[0, :, :2]))
    radii = np.full(len(places), gain * sensor.half_sizes[0])
    cover = covered((view.width, view.height), places, radii, 0.9)
    light = decode_srgb(np.array(sensor.ground.apex, dtype=float))
    light = light * (1.0 + cover[..., None] * (np.array(layer.transmittance) - 1.0))
    light[inside_rim(sensor, pixel_places(sensor)) < 0.0] = 0.002
    return levels(light, 1.0, 3), places


@pytest.mark.parametrize("tracker", [pytest.param("fit", marks=pytest.mark.stages), "detect"])
@pytest.mark.parametrize("name", sensor_names(1))
def test_markers_of_a_design_of_one_layer_are_followed(name: str, tracker: str) -> None:
    sensor = load_sensor(name, fewest=1)
    palette = load_palette(name)
    assert palette.names == ("dots",)
    image, places = pictured(sensor, 0.0)
    made = load_tracker(tracker)(palette, 1.0)
    rest = made.reset([Frame(image=image, time=0.0)])
    away, number = KDTree(places).query(rest.position[0])
    assert sorted(number) == list(range(len(places)))
    assert away.max() < 0.1
    tracks = made.update(Frame(image=pictured(sensor, 2.0)[0], time=0.03))
    assert tracks.visible.all()
    moved = tracks.position[0] - rest.position[0]
    np.testing.assert_allclose(moved, np.tile([2.0, 0.0], (len(moved), 1)), atol=0.1)


def test_what_needs_two_layers_refuses_it_in_one_sentence(typed: Typed) -> None:
    with pytest.raises(UserError, match="sensor tactip has one layer of markers"):
        load_sensor("tactip")
    with pytest.raises(UserError, match="one layer of markers"):
        load_sensor("tactip", fewest=1).inner  # noqa: B018
    told = typed("grasp", "--sensor", "tactip")
    assert told.returncode == 2
    assert "has one layer of markers" in told.stderr
    assert told.stderr.count("\n") == 1
