"""A reader reads what a sensor shows, knows when it cannot, and keeps to itself."""

import math

import numpy as np
import pytest

from chromagrip import Pose, Reader, TactileSensor, UserError
from chromagrip.control import GripObservation
from chromagrip.model import Solid
from chromagrip.model.shapes import ball
from chromagrip.render import Frame, load_sensor
from chromagrip.tracking import Tracks, sensor_as_designed

RADIUS = load_sensor("dome-2022").shape.radius
DT = 1.0 / 30.0


@pytest.fixture(scope="module")
def grasp() -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray]:
    """Pictures at rest, of a press with a shear, and the true wrench of each."""
    sensor = TactileSensor("dome-2022", noise=1.0, seed=5)
    sensor.attach(Solid(shape=ball(8e-3), friction=0.6))
    rest = [frame.image for frame in sensor.rest_frames(4)]
    images, wrenches = [], []
    for k in range(1, 13):
        depth, shear = 0.08e-3 * min(k, 8), 0.06e-3 * max(k - 8, 0)
        data = sensor.update(Pose(place=(shear, 0.0, RADIUS + 8e-3 - depth)), dt=DT)
        images.append(data.image)
        wrenches.append(data.wrench)
    sensor.close()
    return rest, images, np.array(wrenches)


def test_it_reads_the_wrench_of_the_picture_within_its_interval(
    grasp: tuple[list[np.ndarray], list[np.ndarray], np.ndarray],
) -> None:
    rest, images, wrenches = grasp
    reader = Reader("dome-2022", rest, noise=1.0)
    readings = [reader.update(image, k * DT) for k, image in enumerate(images)]
    last = readings[-1]
    assert last.ok
    assert last.no_estimate == ""
    np.testing.assert_allclose(last.wrench[:3], wrenches[-1][:3], atol=0.05 * abs(wrenches[-1][2]))
    deviation = np.sqrt(np.diag(last.wrench_covariance))
    assert (abs(last.wrench[:3] - wrenches[-1][:3]) < 4.0 * deviation[:3] + 1e-3).all()
    low, high = last.margin_interval
    assert low <= last.margin <= high
    pulled = abs(last.wrench[0]) / (last.friction * abs(last.wrench[2]))
    assert last.margin == pytest.approx(1.0 - pulled, abs=0.1)
    # The margin to hold is the smaller of Γ and the one with torsion.
    assert isinstance(last.held, GripObservation)
    assert isinstance(last.observation, GripObservation)
    assert last.held.margin == min(last.observation.margin, last.observation.limit_margin)
    # A constant would not do.
    assert abs(readings[1].wrench[2] - last.wrench[2]) > 0.3 * abs(last.wrench[2])


@pytest.mark.loops
def test_one_picture_again_is_one_answer_again_and_copies_go_their_own_way(
    grasp: tuple[list[np.ndarray], list[np.ndarray], np.ndarray],
) -> None:
    rest, images, _ = grasp
    reader = Reader("dome-2022", rest, noise=1.0)
    for k in range(8):
        reader.update(images[k], k * DT)
    other = reader.copied()
    reader.update(images[2], 8 * DT)
    straight = [other.update(images[k], k * DT).margin for k in range(8, 12)]
    again = Reader("dome-2022", rest, noise=1.0)
    every = [again.update(images[k], k * DT).margin for k in range(12)]
    np.testing.assert_array_equal(straight, every[8:])


def test_where_nothing_touches_there_is_no_margin(
    grasp: tuple[list[np.ndarray], list[np.ndarray], np.ndarray],
) -> None:
    rest, _, _ = grasp
    seen = Reader("dome-2022", rest, noise=1.0).update(Frame(image=rest[0], time=0.0))
    assert math.isnan(seen.margin)
    assert abs(seen.wrench[2]) < 0.05
    assert isinstance(seen.tracks, Tracks)


def test_what_is_not_the_sensor_is_a_sentence_or_a_reason(
    grasp: tuple[list[np.ndarray], list[np.ndarray], np.ndarray],
) -> None:
    rest, images, _ = grasp
    reader = Reader("dome-2022", rest, noise=1.0)
    black = reader.update(np.zeros_like(rest[0]), 0.0)
    assert not black.ok
    assert black.no_estimate
    assert math.isnan(black.margin)
    assert math.isnan(black.friction)
    with pytest.raises(UserError, match="time of the picture"):
        reader.update(images[0])
    with pytest.raises(UserError, match="in order of time"):
        reader.update(images[0], -1.0)
    with pytest.raises(UserError, match="type float64"):
        reader.update(images[0] / 255.0, 1.0)
    with pytest.raises(UserError, match=r"noise .* of at least 0"):
        Reader("dome-2022", rest, noise=-1.0)
    with pytest.raises(UserError, match="held_margin = 'none'"):
        Reader("dome-2022", rest, held_margin="none")  # type: ignore[arg-type]
    with pytest.raises(UserError, match="at least one picture"):
        Reader("dome-2022", [])
    with pytest.raises(UserError, match="no calibration 'dome-1999'"):
        Reader("dome-1999", rest)
    with pytest.raises(UserError, match="flat pad"):
        Reader("flat-2019", rest, reconstructor="contact")


def test_a_plug_in_that_gives_other_markers_is_refused(
    grasp: tuple[list[np.ndarray], list[np.ndarray], np.ndarray],
) -> None:
    rest, images, _ = grasp

    class Odd:
        state = None

        def __init__(self, palette: object, noise: float) -> None:
            from chromagrip.tracking import MarkerTracker

            self._own = MarkerTracker(palette, noise)  # type: ignore[arg-type]

        def reset(self, frames: list[Frame]) -> Tracks:
            return self._own.reset(frames)

        def update(self, frame: Frame) -> object:
            return "nothing"

    reader = Reader("dome-2022", rest, tracker=Odd)
    with pytest.raises(UserError, match="Odd gave a str; expected: Tracks"):
        reader.update(images[0], 0.0)


@pytest.mark.loops
def test_a_bias_moves_the_friction_and_its_margin_alike(
    grasp: tuple[list[np.ndarray], list[np.ndarray], np.ndarray],
) -> None:
    rest, images, _ = grasp
    known = sensor_as_designed("dome-2022")
    plain, biased = (Reader(known, rest, noise=1.0, friction_bias=b) for b in (0.0, 0.2))
    for k, image in enumerate(images):
        one, other = plain.update(image, k * DT), biased.update(image, k * DT)
    assert other.friction == pytest.approx(one.friction + 0.2)
    intervals = [reading.observation.friction_interval for reading in (one, other)]
    assert np.subtract(*intervals[::-1]) == pytest.approx(0.2)
    used = 1.0 - one.margin
    assert other.margin == pytest.approx(1.0 - used * one.friction / other.friction)
