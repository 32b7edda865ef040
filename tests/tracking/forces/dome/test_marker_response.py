"""The derivative of the markers' image is that of the image itself."""

import numpy as np
import pytest

from chromagrip.render import load_sensor
from chromagrip.tracking.forces.dome.marker_response import DomeResponse


@pytest.mark.parametrize("name", ["dome-2020", "thesis"])
def test_small_changes_of_forces_change_the_image_as_the_derivative_says(name: str) -> None:
    sensor = load_sensor(name)
    dome = sensor.dome
    places = np.stack([sensor.places, sensor.places])
    response = DomeResponse(sensor, dome, places)
    nodes = np.arange(5, 25)
    random = np.random.default_rng(3)
    forces = 1e-3 * random.normal(size=(2, len(nodes), 3))
    along = response.along(nodes, forces)
    for change, said in zip(forces, along, strict=True):
        seen = (response(nodes, change) - response(nodes, -change)) / 2
        assert abs(seen).max() > 1e-4
        assert said == pytest.approx(seen, abs=0.01 * abs(seen).max())
    assert not response.along(nodes, np.zeros((3, len(nodes), 3))).any()
