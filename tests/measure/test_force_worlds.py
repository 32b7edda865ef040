"""Worlds of grasps for force estimators: sensors, skins and pictures are what they say."""

from contextlib import closing
from itertools import pairwise
from operator import attrgetter

import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.measure.worlds.beyond import finished_pictures as pictures
from chromagrip.measure.worlds.beyond.carried_skin import CarriedSkin, Motion
from chromagrip.measure.worlds.beyond.groups import GROUPS
from chromagrip.measure.worlds.compressed import Codec, h264, h265, jpeg, mjpeg, raw
from chromagrip.measure.worlds.dome.across import dome_states, solid_of
from chromagrip.measure.worlds.force_scenes import PERIOD, Grasp, run_of
from chromagrip.measure.worlds.grasps import KNOWN, WORLDS, calibration
from chromagrip.model import (
    ContactObject,
    Drive,
    contact_forces,
    dome_forces,
    equilibrium,
    rest_state,
)
from chromagrip.render import (
    Defects,
    Frame,
    MembraneMap,
    SensorDesign,
    decode_srgb,
    load_sensor,
    rest_membrane,
)
from chromagrip.sensing.sensor import TactileSensor
from chromagrip.thesis import LOADS_N, OBJECTS
from chromagrip.tracking import load_calibration

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


def test_a_mismatched_sensor_is_off_by_as_much_as_is_said() -> None:
    known = calibration()
    made = [WORLDS["mismatched"](np.random.default_rng([3, k])) for k in range(200)]
    names = ("tissue_stiffness", "membrane_stiffness")
    shares = np.array(
        [[getattr(m.fingertip, n) / getattr(known.fingertip, n) for n in names] for m in made]
    )
    assert shares.min(axis=0) == pytest.approx([0.9, 0.9], abs=0.005)
    assert shares.max(axis=0) == pytest.approx([1.1, 1.1], abs=0.005)
    assert abs(np.corrcoef(shares.T)[0, 1]) < 0.2

    def seen(sensor: SensorDesign) -> tuple[np.ndarray, float]:
        apex, side = (sensor.view.project(np.array(p)) for p in ((0, 0, 8e-3), (4e-3, 0, 4e-3)))
        return apex, (side - apex)[0]

    middle, width = seen(known.sensor)
    there = [seen(m.sensor) for m in made]
    assert 0.45 < abs(np.array([apex - middle for apex, _ in there])).max() <= 0.5
    assert 0.0025 < abs(np.array([far for _, far in there]) / width - 1).max() <= 0.003 + 1e-9
    assert {(m.renderer, m.fingertip.nodes) for m in made} == {("pyrender", 501)}


def test_a_dome_bears_grip_and_load_of_a_chains_grasp() -> None:
    obj = ContactObject(stiffness=500.0, friction=0.6)
    drive = Drive(
        times=np.array([0.0, 0.1, 0.3, 0.6]),
        normal=np.array([0.02, 2.0, 2.0, 2.0]),
        lateral=np.array([0.0, 0.0, 0.4, 0.4]),
    )
    dome = load_sensor("thesis").dome
    states = dome_states(dome, solid_of(obj), Grasp(obj=obj, drive=drive, ends=(0.6,)), 60)
    assert len(states) == 61
    field = dome_forces(dome, states[-1])
    assert field.total_force == pytest.approx([0.4, 0.0, -2.0], abs=0.02)
    assert field.total_friction == pytest.approx(0.4, abs=0.02)
    with pytest.raises(UserError, match="one µ"):
        solid_of(ContactObject(curvature=-20.0))


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


def test_a_camera_takes_another_map_and_changes_its_finished_pictures() -> None:
    frames = []
    for given in ({}, {"picture": lambda image: 255 - image}, {"membrane_map": skin(roll=0.1)}):
        sensor = TactileSensor(SENSOR, body=TIP, noise=2.0, seed=1, defects=Defects(), **given)
        with closing(sensor.camera) as camera:
            frames.append(camera.expose_rest(rest_state(TIP), 1)[0].image.astype(int))
    plain, inverted, other = frames
    np.testing.assert_array_equal(inverted, 255 - plain)
    assert abs(other - plain).max() > 50


# ---- groups ----


def test_no_group_tells_its_estimators_what_is_unlike() -> None:
    """It is in specimen, pictures, noise, map or grasp; else the figures were those in range."""
    shipped = load_calibration("thesis")
    spread = {"stiffness-untold": shipped.stiffness_deviation}
    spread |= dict.fromkeys(("stiffness-told", "friction-law-mismatched"), 0.1 / np.sqrt(3.0))
    for group, draw in GROUPS.items():
        for index in range(4):
            case = draw(np.random.default_rng([1, index]), index)
            known, made = case.known, case.specimen
            assert known.stiffness_deviation == pytest.approx(spread.get(group, 0.0))
            assert (known.sensor, known.fingertip) == (shipped.sensor, shipped.fingertip)
        unlike = [
            made.fingertip != shipped.fingertip,
            made.sensor != shipped.sensor,
            made.membrane_map is not None,
            made.renderer != "painter",
            case.pictures is not None,
            case.draw.__name__ != "random_grasp",
        ]
        assert any(unlike), group


def test_specimens_are_off_by_as_much_as_is_said() -> None:
    for group, name, bound in (
        ("layers", "sensor.yellow.follow", 0.10),
        ("layers", "sensor.yellow.depth_mm", 0.15),
        ("poisson", "fingertip.poisson_tissue", 0.2),
        ("stiffness-told", "fingertip.tissue_stiffness", 0.1),
        ("stiffness-untold", "fingertip.membrane_stiffness", 0.1),
    ):
        value = attrgetter(name)
        made = [GROUPS[group](np.random.default_rng([3, k]), k).specimen for k in range(60)]
        off = np.array([value(one) for one in made]) / value(KNOWN_SENSOR) - 1.0
        assert 0.9 * bound < abs(off).max() <= bound + 1e-9
        assert off.min() < 0.0 < off.max()


# ---- codecs ----


def _frames(height: int, width: int, count: int) -> list[Frame]:
    """Frames of a pattern that moves by a pixel a frame."""
    pytest.importorskip("av")
    y, x = np.mgrid[:height, :width].astype(float)
    waves = [np.sin(0.3 * (x + k))[..., None] * [40.0, 60.0, 20.0] for k in range(count)]
    noise = np.random.default_rng(1).normal(0.0, 2.0, (count, height, width, 3))
    levels = [128.0 + wave + y[..., None] / height for wave in waves] + noise
    return [Frame(image=np.rint(v).astype(np.uint8), time=0.1 * k) for k, v in enumerate(levels)]


def _error(codec: Codec, frames: list[Frame]) -> float:
    """RMS difference of the frames from those before [grey levels]."""
    after = codec(frames)
    assert [frame.time for frame in after] == [frame.time for frame in frames]
    pairs = zip(frames, after, strict=True)
    return float(np.sqrt(np.mean([(a.image.astype(float) - b.image) ** 2 for a, b in pairs])))


@pytest.mark.parametrize(
    "codecs",
    [
        [h264(0), h264(12), h264(23), h264(35)],
        [h264(12, "yuv444p"), h264(35, "yuv444p")],
        [h265(12), h265(28)],
        [mjpeg(2), mjpeg(5), mjpeg(15)],
        [jpeg(98), jpeg(80), jpeg(40)],
    ],
)
def test_error_grows_as_quality_falls(codecs: list[Codec]) -> None:
    errors = [_error(codec, _frames(64, 96, 5)) for codec in codecs]
    assert all(a < b for a, b in pairwise(errors))


def test_codecs_without_loss_and_of_odd_sizes() -> None:
    assert _error(raw, _frames(32, 32, 2)) == 0.0
    # The encoder's added row and column are taken away again.
    frames = _frames(33, 47, 3)
    assert all(frame.image.shape == (33, 47, 3) for frame in h264(10)(frames))
    # What is left is the rounding of one colour space to the other.
    assert _error(h264(0, "yuv444p"), frames) < 1.0
    assert h264(10)([]) == []
