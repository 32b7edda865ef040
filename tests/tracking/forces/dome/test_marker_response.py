"""The derivative of the markers' image is that of the image itself."""

import numpy as np
import pytest

from chromagrip.model.dome import lattice
from chromagrip.render import load_sensor
from chromagrip.tracking.forces.dome.marker_response import DomeResponse


@pytest.mark.parametrize("name", ["dome-2020", "thesis"])
def test_small_changes_of_forces_change_the_image_as_the_derivative_says(name: str) -> None:
    sensor = load_sensor(name)
    dome = sensor.dome
    places = np.stack([sensor.places, sensor.places])
    response = DomeResponse(sensor, dome, places)
    nodes = len(lattice(dome).ring)
    random = np.random.default_rng(3)
    forces = np.zeros((2, nodes, 3))
    forces[:, :20] = 1e-3 * random.normal(size=(2, 20, 3))
    along = response.along(forces)
    for change, said in zip(forces, along, strict=True):
        seen = (response(change) - response(-change)) / 2
        assert abs(seen).max() > 1e-4
        assert said == pytest.approx(seen, abs=0.01 * abs(seen).max())
    assert not response.along(np.zeros((3, nodes, 3))).any()
