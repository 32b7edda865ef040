"""Worlds of grasps for force estimators: sensors, skins and pictures are what they say."""

import numpy as np
import pytest

from chromagrip.measure.worlds.beyond import finished_pictures as pictures
from chromagrip.measure.worlds.beyond.carried_skin import CarriedSkin, Motion
from chromagrip.measure.worlds.compressed import Codec, h264, h265, jpeg, mjpeg, raw
from chromagrip.measure.worlds.force_scenes import PERIOD, run_of
from chromagrip.measure.worlds.grasps import KNOWN, calibration
from chromagrip.model import (
    ContactObject,
    contact_forces,
    equilibrium,
)
from chromagrip.render import (
    Frame,
    MembraneMap,
    decode_srgb,
    rest_membrane,
)
from chromagrip.thesis import LOADS_N, OBJECTS

KNOWN_SENSOR = calibration()
SENSOR, TIP = KNOWN_SENSOR.sensor, KNOWN_SENSOR.fingertip


# ---- grasps and sensors ----


@pytest.mark.parametrize(
    ("kind", "index", "wanted"),
    [
        ("objects", 14, [0.3]),
        ("conservative", 0, [1 - load / (OBJECTS[0].friction * 5.0) for load in LOADS_N]),
    ],
)
def test_known_grasps_have_the_margins_that_they_say(
    kind: str, index: int, wanted: list[float]
) -> None:
    """Γ = 0.3, or on flat objects, where ΣFn is the grip, 1 − load/(µ·grip)."""
    tip, grasped = calibration().fingertip, KNOWN[kind](index)
    run = run_of(tip, grasped)
    for end, margin in zip(grasped.ends, wanted, strict=True):
        field = contact_forces(tip, grasped.obj, run.state(round(end / PERIOD)))
        assert field.safety_margin(OBJECTS[index].friction) == pytest.approx(margin, abs=0.01)


# ---- the skin of `beyond` ----

NODES = TIP.nodes
ANGLES = np.linspace(-np.pi / 2, np.pi / 2, NODES)
THETA, PHI = SENSOR.places.T
REST = rest_membrane(SENSOR).centres


def skin(**motion: float) -> CarriedSkin:
    return CarriedSkin(SENSOR, NODES, Motion(**motion))


def pressed() -> np.ndarray:
    return equilibrium(TIP, ContactObject(friction=0.7), 3.0, 0.8).deformation.seen


def sheared() -> np.ndarray:
    """A chain whose nodes move along x alone, alike on both sides: 0.1 mm·cos θ."""
    return np.column_stack([1e-4 * np.cos(ANGLES), np.zeros(NODES)])


def test_a_skin_that_moves_as_it_should_is_that_of_the_shared_map() -> None:
    """Two implementations: one through harmonics and kernels, one through points in space."""
    for displacement in (pressed(), np.zeros((NODES, 2))):
        own, shared = skin()(displacement), MembraneMap(SENSOR, NODES)(displacement)
        np.testing.assert_allclose(own.centres, shared.centres, atol=1e-12)
        turn = np.arccos(np.clip((own.normals * shared.normals).sum(axis=-1), -1.0, 1.0))
        assert np.rad2deg(turn).max() < 0.05
        np.testing.assert_allclose(np.linalg.norm(own.axes, axis=-2), 0.25e-3, rtol=1e-9)


def test_shear_and_contraction_are_what_they_say() -> None:
    """Under a pure shear a(θ) along x: (1 + (s−1)·sin²φ)·a along x, −ν·sin φ·cos φ·a along y."""
    a = 1e-4 * np.cos(THETA) * SENSOR.follow[:, None]
    sin, cos = np.sin(PHI), np.cos(PHI)
    moved = skin(shear=0.9, contraction=0.2)(sheared()).centres - REST
    inner = THETA > 1e-9  # φ means nothing on the apex
    for k, wanted in enumerate((1.0 - 0.1 * sin**2, -0.2 * sin * cos, 0.0 * sin)):
        np.testing.assert_allclose(moved[:, inner, k], (wanted * a)[:, inner], atol=1e-8)
    # Off the chain's plane a press moves the skin outwards by a share more.
    more, plane = skin(radial=0.05)(pressed()).centres - skin()(pressed()).centres, abs(sin) < 1e-9
    np.testing.assert_allclose(more[:, plane], 0.0, atol=1e-12)
    assert 2e-6 < np.linalg.norm(more, axis=-1).max() < 0.2e-3


def test_the_load_is_turned_about_the_axis() -> None:
    psi = np.deg2rad(35.0)
    moved = skin(azimuth=psi)(sheared()).centres - REST
    a = 1e-4 * np.cos(THETA) * SENSOR.follow[:, None]
    np.testing.assert_allclose(moved[..., 0], np.cos(psi) * a, atol=1e-8)
    np.testing.assert_allclose(moved[..., 1], np.sin(psi) * a, atol=1e-8)
    # By half a turn the picture is that of the same press, loaded the other way.
    half, loaded = skin(azimuth=np.pi)(pressed()), pressed()[::-1] * [-1.0, 1.0]
    np.testing.assert_allclose(half.centres, skin()(loaded).centres, atol=1e-9)


def test_a_twist_turns_the_contact_by_its_angle_and_the_rim_hardly() -> None:
    angle = np.deg2rad(5.0)
    flat = np.column_stack([np.zeros(NODES), np.minimum(7.5e-3 - 8e-3 * np.cos(ANGLES), 0.0)])
    rest = 8e-3 * np.stack(
        [np.sin(THETA) * np.cos(PHI), np.sin(THETA) * np.sin(PHI), np.cos(THETA)], axis=-1
    )

    def azimuths(motion: CarriedSkin) -> np.ndarray:
        point = rest + (motion(flat).centres[0] - REST[0])  # the outer layer follows wholly
        return np.unwrap(np.arctan2(point[:, 1], point[:, 0]) - PHI, period=2 * np.pi)

    turn = azimuths(skin(twist=angle)) - azimuths(skin())
    turn = (turn + np.pi) % (2 * np.pi) - np.pi
    edge = np.arccos(7.5 / 8.0)
    touching = (edge - 0.01 > THETA) & (THETA > 1e-6)
    assert touching.sum() > 5
    np.testing.assert_allclose(turn[touching], angle, atol=1e-6)
    far = THETA > 1.2
    assert (turn[far] > 0.0).all()
    assert (turn[far] < 0.05 * angle).all()
    untouched = skin(twist=angle)(np.zeros((NODES, 2)))
    np.testing.assert_allclose(untouched.centres, REST, atol=1e-12)


# ---- finished pictures ----


def spot(place: np.ndarray, width: float = 4.0) -> np.ndarray:
    """Black picture with a round, soft spot."""
    y, x = np.mgrid[:480, :640]
    bright = 250.0 * np.exp(-0.5 * ((x - place[0]) ** 2 + (y - place[1]) ** 2) / width**2)
    return np.repeat(np.rint(bright)[..., None], 3, axis=-1).astype(np.uint8)


def centre(image: np.ndarray) -> np.ndarray:
    weight = image[..., 0].astype(float)
    y, x = np.mgrid[:480, :640]
    return np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()


@pytest.mark.parametrize("smooth", [False, True])
def test_a_rolled_picture_is_that_of_a_rolled_camera(smooth: bool) -> None:
    angle = np.deg2rad(7.0)
    for k in (20, 250):
        before = SENSOR.view.project(REST[0, k])
        after = SENSOR.view.project(skin(roll=angle)(np.zeros((NODES, 2))).centres[0, k])
        assert np.linalg.norm(after - before) > 2.0
        found = centre(pictures.rolled(angle, smooth)(spot(before)))
        np.testing.assert_allclose(found, after, atol=0.03)


def test_a_picture_is_enlarged_about_its_middle_and_shifted() -> None:
    place, middle = np.array([420.0, 300.0]), np.array([319.5, 239.5])
    found = centre(pictures.shifted((8.0, -3.0), 1.04)(spot(place)))
    np.testing.assert_allclose(found, middle + 1.04 * (place - middle) + [8.0, -3.0], atol=0.03)


def test_a_tilted_camera_sees_turned_directions() -> None:
    camera, angle = SENSOR.view.camera, np.deg2rad(3.0)
    change = pictures.tilted(camera, angle, 0.0)  # about x
    cos, sin = np.cos(angle), np.sin(angle)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])
    for point in (np.array([0.0, 0.0, 8e-3]), np.array([4e-3, -3e-3, 5e-3])):
        seen = centre(change(spot(camera.project(point))))
        # The camera's axes turn one way, what it sees the other.
        np.testing.assert_allclose(seen, camera.project(point @ about_x), atol=0.1)


def test_dimmer_light_is_dimmer_in_linear_light() -> None:
    levels = np.tile(np.arange(256, dtype=np.uint8)[None, :, None], (2, 1, 3))
    found = decode_srgb(pictures.lit(0.8)(levels).astype(float))
    wanted = 0.8 * decode_srgb(levels.astype(float))
    assert abs(found - wanted).max() < 0.005  # half a level
    light = pictures.gradient(640, 480, 0.2, 0.0)
    assert light.min() >= 0.8
    assert light[:, 0].mean() > light[:, -1].mean() + 0.1


# ---- codecs ----


def test_error_grows_as_quality_falls_and_frames_keep_their_size() -> None:
    """Of a size that is odd: the encoder's added row and column are taken away again.

    In smaller pictures (47 × 33) x265 ends the process.
    """
    pytest.importorskip("av")
    y, x = np.mgrid[:119, :157]
    moving = [128.0 + 60.0 * np.sin(0.3 * (x + k)) + y for k in range(3)]
    images = [np.repeat(np.rint(one)[..., None], 3, axis=-1).astype(np.uint8) for one in moving]
    frames = [Frame(image=image, time=0.1 * k) for k, image in enumerate(images)]

    def error(codec: Codec) -> float:
        pairs = zip(frames, codec(frames), strict=True)
        return max(float(np.square(a.image.astype(float) - b.image).mean()) for a, b in pairs)

    assert error(raw) == 0.0
    for codec, fine, poor in ((h264, 12, 35), (h265, 12, 28), (mjpeg, 2, 15), (jpeg, 98, 40)):
        assert error(codec(fine)) < error(codec(poor))
