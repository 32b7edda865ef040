"""Shifts of marker pairs are counted on a sensor whose camera was fitted to the rest frame."""

import numpy as np
import pytest
from msgspec.structs import replace

from chromagrip.render import load_sensor
from chromagrip.tracking import Tracks, nominal_calibration
from chromagrip.tracking.forces.shifts import MarkerShifts

SENSOR = load_sensor("thesis")


def test_places_are_those_of_the_markers_under_the_camera_that_saw_them() -> None:
    """A camera half a pixel off its calibration puts no marker elsewhere on the skin."""
    camera = replace(SENSOR.camera, focal_px=(153.4, 153.4), centre_px=(320.0, 239.2))
    seen_by = replace(SENSOR, camera=camera)
    layers = [SENSOR.shape.points(SENSOR.places, depth) for depth in SENSOR.depths]
    position = np.stack([seen_by.view.project(points) for points in layers])
    markers = position.shape[:2]
    rest = Tracks(
        time=0.0,
        position=position,
        log_size=np.zeros(markers),
        hue=np.zeros(markers[1]),
        visible=np.ones(markers, dtype=bool),
        ambiguous=np.zeros(markers, dtype=bool),
        last_seen=np.zeros(markers),
        covariance=np.tile(1e-4 * np.eye(6), (markers[1], 1, 1)),
    )
    shifts = MarkerShifts(nominal_calibration(SENSOR), rest, np.inf)
    assert shifts.sensor.camera.centre_px == pytest.approx((320.0, 239.2), abs=0.02)
    points = SENSOR.shape.points(shifts.places[0], SENSOR.depths[0])
    # A hundredth of a pixel; 0.5 px would be 30 µm.
    np.testing.assert_allclose(points, layers[0], atol=2e-6)
