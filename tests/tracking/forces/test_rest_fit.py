"""The pose of a camera comes out of its rest frame, or is refused."""

import math
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest
from msgspec.structs import replace as changed
from scipy.spatial.transform import Rotation

from chromagrip.errors import UserError
from chromagrip.render import Defects, Flaws, SensorDesign, load_sensor, open_renderer
from chromagrip.render.flaws.noise import add_noise
from chromagrip.render.frame import Frame
from chromagrip.render.membrane import rest_membrane
from chromagrip.tracking import MarkerTracker, Palette, Tracks
from chromagrip.tracking.forces.pose import CameraPose, seen_by, turn_matrix
from chromagrip.tracking.forces.rest_fit import rest_pose
from chromagrip.tracking.forces.rest_settings import PoseSettings

from .drawn import made

SENSOR = load_sensor("thesis")
SPECIMEN = Defects(misplacement_mm=0.02, misalignment_mm=0.15)
DEGREE = math.pi / 180
#: The apex, and places 30° from it all around [rad].
PLACES = np.array([[0.0, 0.0], *([0.5, phi] for phi in np.arange(0.0, 6.0, 0.5))])


@lru_cache
def picture(defects: Defects) -> np.ndarray:
    flaws = Flaws(SENSOR, defects, 4)
    return open_renderer("painter", SENSOR).render(flaws(rest_membrane(SENSOR, flaws.places)))


def tracked(image: np.ndarray, noise: float = 2.0) -> Tracks:
    frames = []
    for k in range(2):
        noisy = image.copy()
        add_noise(noisy, noise, 1, k)
        frames.append(Frame(image=noisy, time=0.0))
    return MarkerTracker(Palette.of_sensor(SENSOR), noise).reset(frames)


def warped(
    image: np.ndarray, roll_deg: float, scale: float, shift: tuple[float, float]
) -> np.ndarray:
    """Picture turned from x to y about its middle, zoomed and shifted."""
    cos, sin = scale * math.cos(roll_deg * DEGREE), scale * math.sin(roll_deg * DEGREE)
    turn, middle = np.array([[cos, -sin], [sin, cos]]), np.array([319.5, 239.5])
    offset = middle + shift - turn @ middle
    return cv2.warpAffine(
        image,
        np.column_stack([turn, offset]),
        (640, 480),
        flags=cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=SENSOR.ground.housing,
    )


def projected(
    sensor: SensorDesign, pose: CameraPose, defects: Defects = SPECIMEN, seed: int = 1
) -> Tracks:
    """Markers of a specimen where a camera in that pose sees them, to 0.02 px."""
    flaws = Flaws(sensor, defects, seed)
    places = [sensor.places] * 2 if flaws.places is None else flaws.places
    position = np.stack(
        [
            seen_by(pose, sensor.view.camera, sensor.view.project(sensor.shape.points(p, depth)))
            for p, depth in zip(places, sensor.depths, strict=True)
        ]
    )
    position += 0.02 * np.random.default_rng(seed).standard_normal(position.shape)
    size = np.array([sensor.view.width, sensor.view.height])
    position[~((position > 3.0) & (position < size - 4.0)).all(axis=-1) | flaws.missing] = np.nan
    return with_position(position)


def with_position(position: np.ndarray) -> Tracks:
    tracks = made(0.0, position, np.zeros(position.shape[:2]), np.full(6, 0.01))
    return replace(tracks, visible=np.isfinite(position).all(axis=-1))


def check(found: CameraPose, wanted: CameraPose, degrees: float = 0.1, pixels: float = 0.3) -> None:
    turn = math.remainder(found.roll - wanted.roll, 2 * math.pi)
    assert abs(turn) < degrees * DEGREE
    assert found.tilt == pytest.approx(wanted.tilt, abs=degrees * DEGREE)
    assert found.shift == pytest.approx(wanted.shift, abs=pixels)
    assert found.scale == pytest.approx(wanted.scale, abs=1e-3)


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (1e-9, 0.0), (0.02, -0.05), (-1.0, 2.0)])
def test_a_camera_is_turned_by_the_tilt_and_then_by_the_roll(tilt: tuple[float, float]) -> None:
    turned = Rotation.from_rotvec([0.0, 0.0, 0.7]) * Rotation.from_rotvec([*tilt, 0.0])
    np.testing.assert_allclose(turn_matrix(0.7, tilt), turned.as_matrix(), atol=1e-15)


@pytest.mark.stages
@pytest.mark.parametrize(
    ("roll_deg", "scale", "shift"),
    [(-3.0, 1.0, (4.0, -2.5)), (60.0, 0.9, (-20.0, 15.0))],
)
def test_a_warped_picture_tells_how_it_was_warped(
    roll_deg: float, scale: float, shift: tuple[float, float]
) -> None:
    """Layers that lie 0.15 mm beside each other do not pass for any of it."""
    found = rest_pose(SENSOR, tracked(warped(picture(SPECIMEN), roll_deg, scale, shift)))
    check(found, CameraPose(roll=roll_deg * DEGREE, scale=scale, shift=shift))
    assert not found.ambiguous
    # Markers are off their places by 0.02 mm along each direction, 0.54 px.
    assert found.error < 0.8


def test_a_camera_as_designed_stays() -> None:
    found = rest_pose(SENSOR, tracked(picture(Defects())))
    check(found, CameraPose(), degrees=0.01, pixels=0.03)
    assert not found.notable
    assert found.error < 0.2
    assert found.roll_deviation < 0.01 * DEGREE


def test_a_pose_is_told_in_degrees() -> None:
    pose = CameraPose(roll=-1.2 * DEGREE, tilt=(0.3 * DEGREE, -0.4 * DEGREE), scale=0.98)
    assert "rolled by -1.20°" in str(pose)
    assert "tilted by 0.50°" in str(pose)
    assert pose.table()["tilt_deg"] == pytest.approx([0.3, -0.4])
    assert pose.notable
    assert not CameraPose(roll=0.2 * DEGREE, shift=(1.0, 2.0), scale=1.005).notable


def test_a_tilt_is_told_from_a_shift() -> None:
    pose = CameraPose(roll=1.0, tilt=(-0.1, 0.12), shift=(20.0, -10.0), scale=1.05)
    check(rest_pose(SENSOR, projected(SENSOR, pose)), pose)


def test_the_deviations_are_those_of_the_errors() -> None:
    """Over specimens the error over its standard deviation is of order 1."""
    pose = CameraPose(roll=0.02, tilt=(0.01, 0.02), shift=(1.0, 2.0), scale=0.99)
    scores = []
    for seed in range(6):
        found = rest_pose(SENSOR, projected(SENSOR, pose, seed=seed))
        scores.append(
            [
                (found.roll - pose.roll) / found.roll_deviation,
                (found.tilt[0] - pose.tilt[0]) / found.tilt_deviation[0],
                (found.shift[1] - pose.shift[1]) / found.shift_deviation[1],
                (found.scale - pose.scale) / found.scale_deviation,
            ]
        )
    spread = np.sqrt(np.mean(np.square(scores), axis=0))
    assert (spread > 0.4).all()
    assert (spread < 1.8).all()


def test_markers_that_are_missing_do_not_hide_the_pose() -> None:
    pose = CameraPose(roll=2.0, shift=(3.0, -2.0))
    check(rest_pose(SENSOR, projected(SENSOR, pose, Defects(missing_markers=0.3))), pose)


@pytest.mark.parametrize("name", ["dome-2022", "chromatouch-next", "fovea", "flat-2019"])
def test_every_design_tells_a_small_pose(name: str) -> None:
    sensor = load_sensor(name)
    pose = CameraPose(roll=DEGREE, shift=(4.0, -3.0), scale=1.03)
    found = rest_pose(sensor, projected(sensor, pose))
    # Markers of the fovea cover a third of a dome, where a tilt of 0.1° and 0.4 px look alike.
    check(found, pose, degrees=0.2, pixels=0.7)


@pytest.mark.stages
@pytest.mark.parametrize("seed", [0, 1])
def test_the_built_dome_tells_a_pose_by_its_outer_layer(seed: int) -> None:
    """Crooked markers a tenth of a pitch off, and an inner layer of which each gore lies elsewhere.

    88 markers that scatter by 1.7 px a direction tell a shift to some .3 px, a tilt to two degrees.
    """
    sensor = load_sensor("dome-2020")
    pose = CameraPose(roll=20 * DEGREE, shift=(6.0, -4.0), scale=1.04)
    found = rest_pose(sensor, projected(sensor, pose, sensor.defects, seed))
    assert found.roll == pytest.approx(pose.roll, abs=0.8 * DEGREE)
    assert found.scale == pytest.approx(pose.scale, abs=0.02)
    there, here = (
        seen_by(one, sensor.view.camera, sensor.view.project(sensor.shape.points(PLACES, 0.0)))
        for one in (pose, found)
    )
    assert np.linalg.norm(there - here, axis=-1).max() < 1.5


def test_a_symmetric_layout_is_taken_as_it_lies_nearest_to_the_design() -> None:
    sensor = load_sensor("dome-2020-printed")
    found = rest_pose(sensor, projected(sensor, CameraPose(roll=87.0 * DEGREE)))
    check(found, CameraPose(roll=-3.0 * DEGREE), pixels=0.7)
    assert found.ambiguous
    with pytest.raises(UserError, match=r"rolled by 4\d\.\d\d°.* or .*rolled by -4\d\.\d\d°"):
        rest_pose(sensor, projected(sensor, CameraPose(roll=44.0 * DEGREE)))


@pytest.mark.stages
def test_the_edges_of_a_grid_and_the_centre_of_a_calibrated_camera_count() -> None:
    """17 px from column to column: a grid is not taken for itself a pitch further."""
    sensor = load_sensor("flat-2019")
    pose = CameraPose(shift=(17.0, 0.0))
    check(rest_pose(sensor, projected(sensor, pose)), pose)
    camera = changed(SENSOR.camera, focal_px=(150.0, 150.0), centre_px=(325.0, 236.0))
    sensor = changed(SENSOR, camera=camera)
    check(rest_pose(sensor, projected(sensor, CameraPose(roll=0.3))), CameraPose(roll=0.3))


@pytest.mark.stages
def test_what_cannot_be_told_is_refused() -> None:
    """Even a sensor whose layout is the same spiral but for 45 markers on the meridian."""
    with pytest.raises(UserError, match=r"Is it another sensor\?"):
        rest_pose(SENSOR, projected(load_sensor("fovea"), CameraPose(), Defects()))
    with pytest.raises(UserError, match=r"shifted by \(80\.\d, .*allowed: shifts to 72 px"):
        rest_pose(SENSOR, projected(SENSOR, CameraPose(shift=(80.0, 0.0))))
    rest = projected(SENSOR, CameraPose())
    position = rest.position.copy()
    position[1, 12:] = np.nan
    with pytest.raises(UserError, match=r"shows 12 markers of a layer.*at least 20"):
        rest_pose(SENSOR, with_position(position))
    with pytest.raises(UserError, match=r"at least 97 % and at most 0\.\d px"):
        rest_pose(SENSOR, rest, PoseSettings(apart=0.01))
