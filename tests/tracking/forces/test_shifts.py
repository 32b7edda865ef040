"""Shifts of marker pairs are those that the design's own camera would have seen."""

from dataclasses import replace

import numpy as np
import pytest

from chromagrip.render import load_sensor
from chromagrip.tracking import Tracks, nominal_calibration
from chromagrip.tracking.forces.pose import CameraPose, aligned, alignment, seen_by, seen_by_design
from chromagrip.tracking.forces.shifts import MarkerShifts

from .drawn import made

SENSOR = load_sensor("thesis")
CAMERA = SENSOR.view.camera
POSE = CameraPose(roll=0.2, tilt=(0.03, -0.05), shift=(12.0, -7.0), scale=1.07)
LAYERS = [SENSOR.shape.points(SENSOR.places, depth) for depth in SENSOR.depths]
COUNT = len(SENSOR.places)


def tracks(position: np.ndarray, log_size: np.ndarray, covariance: np.ndarray) -> Tracks:
    return replace(made(0.0, position, log_size, np.ones(6)), covariance=covariance)


def covariances(seed: int) -> np.ndarray:
    """Positive definite matrices of pixels and log sizes, each another."""
    factors = np.random.default_rng(seed).standard_normal((COUNT, 6, 6))
    return 1e-4 * factors @ np.swapaxes(factors, 1, 2)


def of_design(press: float) -> Tracks:
    """Tracks of the design's camera; the middle of the skin is pressed in and to the side [m]."""
    share = np.exp(-((SENSOR.places[:, :1] / 0.4) ** 2))
    moved = share * np.array([0.5 * press, 0.2 * press, -press])
    position = np.stack([SENSOR.view.project(points + moved) for points in LAYERS])
    distance = [np.linalg.norm(p + moved, axis=1) / np.linalg.norm(p, axis=1) for p in LAYERS]
    return tracks(position, -np.log(distance), covariances(1))


def of_posed(seen: Tracks, pose: CameraPose) -> Tracks:
    """The same tracks by a camera in a pose, each marker carried by differences around it."""
    position = seen_by(pose, CAMERA, seen.position)
    step = 0.01
    columns = [
        (seen_by(pose, CAMERA, seen.position + h) - position) / step for h in step * np.eye(2)
    ]
    slopes = np.stack(columns, axis=-1)
    carry = np.tile(np.eye(6), (COUNT, 1, 1))
    for layer in range(2):
        carry[:, 3 * layer : 3 * layer + 2, 3 * layer : 3 * layer + 2] = slopes[layer]
    covariance = carry @ seen.covariance @ np.swapaxes(carry, 1, 2)
    size = seen.log_size + 0.5 * np.log(abs(np.linalg.det(slopes)))
    return tracks(position, size, covariance)


@pytest.mark.parametrize(
    "pose",
    [
        CameraPose(roll=np.pi / 3, scale=0.8, shift=(30.0, -40.0)),
        CameraPose(tilt=(0.2, 0.1)),
        POSE,
    ],
)
def test_aligned_tracks_are_those_of_the_designs_camera(pose: CameraPose) -> None:
    seen = of_design(0.3e-3)
    posed = of_posed(seen, pose)
    back = aligned(alignment(pose, CAMERA, posed.position), posed)
    np.testing.assert_allclose(back.position, seen.position, atol=2e-4)
    np.testing.assert_allclose(back.log_size, seen.log_size, atol=2e-4)
    scale = abs(seen.covariance).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(back.covariance / scale, seen.covariance / scale, atol=1e-3)


def test_a_pixel_goes_to_a_posed_camera_and_back_by_hand() -> None:
    """Without a tilt: turned about the axis, scaled and then shifted; and back exactly."""
    pose = CameraPose(roll=0.5, scale=1.2, shift=(30.0, -40.0))
    centre = np.array([CAMERA.lens.centre_x, CAMERA.lens.centre_y])
    cos, sin = np.cos(0.5), np.sin(0.5)
    pixels = centre + np.array([[0.0, 0.0], [50.0, 0.0], [-20.0, 70.0]])
    by_hand = centre + [30.0, -40.0] + 1.2 * (pixels - centre) @ np.array([[cos, sin], [-sin, cos]])
    np.testing.assert_allclose(seen_by(pose, CAMERA, pixels), by_hand, atol=1e-9)
    np.testing.assert_allclose(seen_by_design(pose, CAMERA, by_hand), pixels, atol=1e-9)
    tilted = seen_by(POSE, CAMERA, pixels)
    np.testing.assert_allclose(seen_by_design(POSE, CAMERA, tilted), pixels, atol=1e-9)


def test_shifts_are_in_the_pixels_of_the_designs_camera() -> None:
    """A camera that is rolled, tilted, shifted and zoomed shows a press as the design's does."""
    rest, pressed = of_design(0.0), of_design(0.3e-3)
    calibration = nominal_calibration(SENSOR)
    shifts = MarkerShifts(calibration, of_posed(rest, POSE), np.inf)
    assert shifts.sensor is SENSOR
    assert shifts.pose.roll == pytest.approx(POSE.roll, abs=1e-5)
    assert shifts.pose.tilt == pytest.approx(POSE.tilt, abs=1e-5)
    assert shifts.pose.shift == pytest.approx(POSE.shift, abs=5e-3)
    assert shifts.pose.scale == pytest.approx(POSE.scale, abs=1e-5)
    read, certain = shifts(of_posed(pressed, POSE), 0)
    wanted = np.concatenate([pressed.position, pressed.log_size[..., None]], axis=-1)
    wanted -= np.concatenate([rest.position, rest.log_size[..., None]], axis=-1)
    np.testing.assert_allclose(
        read, np.concatenate(list(wanted[:, shifts.pairs]), axis=1), atol=1e-3
    )
    assert certain.all()
    # A hundredth of a pixel; without the pose the rim would be 5 mm off.
    points = SENSOR.shape.points(shifts.places[0], SENSOR.depths[0])
    np.testing.assert_allclose(points, LAYERS[0][shifts.pairs], atol=2e-6)


def test_covariances_are_carried_to_the_designs_pixels() -> None:
    rest = of_design(0.0)
    shifts = MarkerShifts(nominal_calibration(SENSOR), of_posed(rest, POSE), 1.0, POSE)
    wanted = rest.covariance[shifts.pairs]
    scale = abs(wanted).max(axis=(1, 2), keepdims=True)
    frame = replace(rest, covariance=2.0 * rest.covariance)
    found = shifts.covariance(of_posed(frame, POSE))
    np.testing.assert_allclose(found / scale, 2.0 * wanted / scale, atol=2e-3)
    np.testing.assert_allclose(shifts.rest_covariance / scale, wanted / scale, atol=2e-3)
    noise = shifts.noise(of_posed(frame, POSE))
    np.testing.assert_allclose(
        (noise - np.diag(shifts.floor)) / scale, 3.0 * wanted / scale, atol=6e-3
    )


def test_the_marker_that_is_left_of_a_pair_is_read() -> None:
    """What is there is as with both; what is not says nothing, and a pair does not wait for it."""
    rest, pressed = of_posed(of_design(0.0), POSE), of_posed(of_design(0.3e-3), POSE)
    calibration = nominal_calibration(SENSOR)
    both = MarkerShifts(calibration, rest, np.inf, POSE)
    wanted, _ = both(pressed, 0)
    worn = np.zeros((2, COUNT), dtype=bool)
    worn[0, :15] = worn[1, 10:20] = True

    def without(seen: Tracks) -> Tracks:
        gone = worn.repeat(3, axis=0).T
        return replace(
            seen,
            position=np.where(worn[..., None], np.nan, seen.position),
            log_size=np.where(worn, np.nan, seen.log_size),
            covariance=np.where(gone[:, :, None] | gone[:, None], np.nan, seen.covariance),
            visible=seen.visible & ~worn,
        )

    halves = MarkerShifts(calibration, without(rest), np.inf, POSE)
    assert np.array_equal(halves.pairs, np.delete(np.arange(COUNT), range(10, 15)))
    read, certain = halves(without(pressed), 0)
    assert certain.all()
    measured = ~worn.repeat(3, axis=0).T[halves.pairs]
    assert np.array_equal(halves.measured, measured)
    np.testing.assert_allclose(read, np.where(measured, wanted[halves.pairs], 0.0), atol=1e-3)
    covariance = halves.covariance(without(pressed))
    of_both = both.covariance(pressed)[halves.pairs]
    together = measured[:, :, None] & measured[:, None]
    np.testing.assert_allclose(covariance[together], of_both[together])
    assert (np.linalg.eigvalsh(covariance) > 0.0).all()
    assert not covariance[measured[:, :, None] & ~measured[:, None]].any()
    np.testing.assert_allclose(halves.places[0, :10], halves.places[1, :10])
