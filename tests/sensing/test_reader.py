"""A reader reads what a sensor shows, knows when it cannot, and keeps to itself."""

import math
from typing import Any

import numpy as np
import pytest

from chromagrip import Pose, Reader, TactileSensor, UserError
from chromagrip.model import Solid
from chromagrip.model.shapes import ball
from chromagrip.render import Frame, load_sensor
from chromagrip.tracking import Tracks

RADIUS = load_sensor("dome-2022").shape.radius
DT = 1.0 / 30.0
#: Pictures at rest, of a press with a shear, and the true wrench of each.
Grasp = tuple[list[np.ndarray], list[np.ndarray], np.ndarray]


@pytest.fixture(scope="module")
def opened(grasp: Grasp) -> Reader:
    """A reader that has read no frame; tests copy it."""
    return Reader("dome-2022", grasp[0], noise=1.0)


@pytest.fixture(scope="module")
def grasp() -> Grasp:
    sensor = TactileSensor("dome-2022", noise=1.0, seed=5)
    sensor.attach(Solid(shape=ball(8e-3), friction=0.6))
    rest = [frame.image for frame in sensor.rest_frames(2)]
    images, wrenches = [], []
    for k in range(1, 6):
        depth, shear = 0.2e-3 * min(k, 3), 0.12e-3 * max(k - 3, 0)
        data = sensor.update(Pose(place=(shear, 0.0, RADIUS + 8e-3 - depth)), dt=DT)
        images.append(data.image)
        wrenches.append(data.wrench)
    sensor.close()
    return rest, images, np.array(wrenches)


def test_it_reads_the_wrench_of_the_picture_within_its_interval(
    grasp: Grasp, opened: Reader
) -> None:
    rest, images, wrenches = grasp
    reader = opened.copied()
    untouched = reader.copied().update(Frame(image=rest[0], time=0.0))
    assert math.isnan(untouched.margin)
    assert abs(untouched.wrench[2]) < 0.05
    assert isinstance(untouched.tracks, Tracks)
    readings = [reader.update(image, k * DT) for k, image in enumerate(images)]
    last = readings[-1]
    assert (last.ok, last.no_estimate) == (True, "")
    np.testing.assert_allclose(last.wrench[:3], wrenches[-1][:3], atol=0.05 * abs(wrenches[-1][2]))
    deviation = np.sqrt(np.diag(last.wrench_covariance))
    assert (abs(last.wrench[:3] - wrenches[-1][:3]) < 4.0 * deviation[:3] + 1e-3).all()
    low, high = last.margin_interval
    assert low <= last.margin <= high
    pulled = abs(last.wrench[0]) / (last.friction * abs(last.wrench[2]))
    assert last.margin == pytest.approx(1.0 - pulled, abs=0.1)
    # The margin to hold is the smaller of Γ and the one with torsion.
    assert last.held.margin == min(last.observation.margin, last.observation.limit_margin)
    # A constant would not do.
    assert abs(readings[0].wrench[2] - last.wrench[2]) > 0.3 * abs(last.wrench[2])


def test_what_is_no_reader_is_refused(grasp: Grasp) -> None:
    asked: list[tuple[str, list[np.ndarray], dict[str, Any], str]] = [
        ("dome-2022", grasp[0], {"noise": -1.0}, r"noise .* of at least 0"),
        ("dome-2022", grasp[0], {"held_margin": "none"}, "held_margin = 'none'"),
        ("dome-2022", [], {}, "at least one picture"),
        ("flat-2019", grasp[0], {"reconstructor": "contact"}, "flat pad"),
    ]
    for sensor, rest, options, words in asked:
        with pytest.raises(UserError, match=words):
            Reader(sensor, rest, **options)


def test_what_is_not_the_sensor_is_a_sentence_or_a_reason(grasp: Grasp, opened: Reader) -> None:
    rest, images, _ = grasp
    reader = opened.copied()
    black = reader.update(np.zeros_like(rest[0]), 0.0)
    assert not black.ok
    assert black.no_estimate
    assert np.isnan([black.margin, black.friction]).all()
    for told, words in (
        ((images[0],), "time of the picture"),
        ((images[0], -1.0), "in order of time"),
        ((images[0] / 255.0, 1.0), "type float64"),
    ):
        with pytest.raises(UserError, match=words):
            reader.update(*told)
