"""Each defect has the size of its dial, and none changes what another one draws."""

from contextlib import closing
from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest
from msgspec.inspect import StructType, type_info
from scipy.ndimage import label
from scipy.spatial.distance import pdist

from chromagrip.errors import UserError
from chromagrip.model import Fingertip, rest_state
from chromagrip.render import (
    Membrane,
    MembraneMap,
    SensorDesign,
    ground_image,
    load_sensor,
    open_renderer,
)
from chromagrip.render.colour import decode_srgb, encode_srgb
from chromagrip.render.design.dials import Defects
from chromagrip.render.flaws.defects import Flaws
from chromagrip.render.flaws.imaging import (
    Imaging,
    exposure,
    shutter_times,
    through_h264,
    through_jpeg,
    white_balance,
)
from chromagrip.render.membrane import rest_membrane
from chromagrip.scene.scene import load_scene, parse_scene
from chromagrip.sensing.sensor import TactileSensor
from chromagrip.strict_toml import convert

SENSOR = load_sensor("thesis")
REST = rest_membrane(SENSOR)


def sized(width: int, height: int, focal: float) -> SensorDesign:
    size = {"width_px": width, "height_px": height, "focal_px": (focal, focal)}
    return msgspec.structs.replace(SENSOR, camera=msgspec.structs.replace(SENSOR.camera, **size))


#: The thesis' fingertip in an image of half its size, and in one of odd size.
HALF, SMALL = sized(320, 240, 76.4), sized(121, 93, 28.0)
SHAPE = (480, 640, 3)
EVERYTHING = Defects(
    shot_noise_electrons=8000, read_noise_electrons=12, vignette=0.35, uneven_leds=0.15,
    defocus_px=0.7, motion_blur=0.5, white_balance_drift=0.1, drift_frames=20, gain_step=0.08,
    gain_step_frames=10, bayer=True, jpeg_quality=80, h264_crf=23, dust=25, specular=6,
    missing_markers=0.03, worn_markers=0.05, seam_tint=0.7, misalignment_mm=0.12,
    misplacement_mm=0.05, crookedness_mm=0.05, gore_misalignment_mm=0.2, rubbed_markers=0.05,
    seam_width_mm=1.0, seam_wander_mm=0.5, seam_gaps=0.2, glow=0.2, blotches=0.2, grain=0.03,
    threads=3,
)  # fmt: skip


@cache
def picture() -> np.ndarray:
    image = open_renderer("painter", SENSOR).render(REST)
    image.setflags(write=False)
    return image


def grey(level: int, shape: tuple[int, ...] = SHAPE) -> np.ndarray:
    return np.full(shape, level, dtype=np.uint8)


def sent(camera: Imaging, exposures: np.ndarray | list[np.ndarray], index: int) -> np.ndarray:
    """A camera's image, compressed."""
    return camera.compressed(camera.measured(exposures, index))


def imaged(image: np.ndarray, seed: int = 1, index: int = 0, **dials: float) -> np.ndarray:
    return sent(Imaging(SENSOR, Defects(**dials), seed), image, index)


def gain(seed: int = 1, index: int = 0, **dials: float) -> np.ndarray:
    """Factor on the linear light of an even image."""
    return decode_srgb(imaged(grey(200), seed, index, **dials)) / decode_srgb(200.0)


Y, X = np.mgrid[:480, :640]
#: Distance from the middle in radii of the skin's image.
RADIUS = np.hypot(X - 319.5, Y - 239.5) / (152.8 * np.pi / 2)


def test_all_off_costs_nothing() -> None:
    image = picture()
    assert sent(Imaging(SENSOR, Defects(), 3), image, 5) is image
    assert Flaws(SENSOR, Defects(), 3)(REST) is REST
    assert shutter_times(Defects(), 0.02).tolist() == [0.0]
    # Two equal exposures pass the linear chain and change nothing.
    levels = np.tile(np.arange(256, dtype=np.uint8)[:, None], (1, 3))[None]
    assert (sent(Imaging(SENSOR, Defects(), 0), [levels, levels], 0) == levels).all()


@pytest.mark.parametrize("level", [60, 200])
def test_photon_transfer(level: int) -> None:
    """Variance of linear light is mean / full well, of each frame and specimen by itself."""
    well, mean = 2000.0, decode_srgb(float(level))
    frames = ((1, 0), (1, 1), (2, 0))
    light, *others = (
        decode_srgb(imaged(grey(level), *frame, shot_noise_electrons=well)) for frame in frames
    )
    slope = (1.055 / 2.4) * mean ** (1 / 2.4 - 1)  # of the sRGB curve
    rounding, count = 1 / 12 / (255 * slope) ** 2, light.size
    assert light.mean() == pytest.approx(mean, abs=5 * np.sqrt(mean / well / count) + 2e-4)
    # A variance estimated from n values is off by √(2/n); the curve bends a little.
    assert light.var() == pytest.approx(mean / well + rounding, rel=5 * np.sqrt(2 / count) + 0.02)
    for other in others:
        assert (light - other).var() == pytest.approx(2 * light.var(), rel=0.02)


def test_read_noise_is_the_floor() -> None:
    """With or without light; of the full well that is given."""
    for well, electrons in ((0.0, 100.0), (20000.0, 200.0)):
        dials = {"shot_noise_electrons": well, "read_noise_electrons": electrons}
        shot = decode_srgb(60.0) / well if well else 0.0
        assert decode_srgb(imaged(grey(60), **dials)).std() == pytest.approx(
            np.sqrt(1e-4 + shot), rel=0.02
        )
        # In the dark half of it is cut off: the mean of half a normal distribution is σ/√(2π).
        dark = decode_srgb(imaged(grey(0), **dials))
        assert dark.mean() == pytest.approx(0.01 / np.sqrt(2 * np.pi), rel=0.02)


def test_vignette_takes_its_share_at_the_corner() -> None:
    factor = gain(vignette=0.4)
    # Half-way to the corner it takes a quarter of it.
    for place, share in (((239, 319), 1.0), ((120, 160), 0.9), ((0, 0), 0.6)):
        assert factor[place] == pytest.approx(share, abs=0.006)


def test_uneven_leds_deviate_by_no_more_and_are_fair() -> None:
    light = gain(uneven_leds=0.2)[..., 0]
    skin = light[RADIUS < 1.0]
    assert abs(skin - 1.0).max() == pytest.approx(0.2, abs=0.01)
    assert skin.mean() == pytest.approx(1.0, abs=0.003)
    # Smooth: nothing changes fast from pixel to pixel but the rounding to whole levels.
    assert abs(np.diff(light, axis=0)).max() < 0.03
    assert abs(light - gain(seed=2, uneven_leds=0.2)[..., 0]).max() > 0.1


def test_defocus_adds_in_squares() -> None:
    """The derivative of an edge is the blur: variances add."""

    def variance(image: np.ndarray) -> float:
        line = np.diff(decode_srgb(image)[200:280, :, 1].mean(axis=0))
        x = np.arange(len(line))
        mean = (line * x).sum() / line.sum()
        return float((line * (x - mean) ** 2).sum() / line.sum())

    ramp = np.rint(encode_srgb(0.1 + 0.7 * np.clip((X - 310) / 10.0, 0.0, 1.0)))
    edge = np.repeat(ramp[..., None], 3, axis=-1).astype(np.uint8)
    added = variance(imaged(edge, defocus_px=2.5)) - variance(edge)
    assert added == pytest.approx(2.5**2, rel=0.03)


def test_an_open_shutter_draws_a_marker_out() -> None:
    """A uniform motion by d adds d²/12 along it and nothing across."""
    painter = open_renderer("painter", SENSOR)
    clear = decode_srgb(painter.render(replace(REST, centres=REST.centres * np.nan)))
    only = np.argmin(np.hypot(*REST.centres[0, :, :2].T))
    moved, defects = 12.0, Defects(motion_blur=0.75)  # [px] in a period
    times = shutter_times(defects, 1.0)
    assert -0.75 <= times.min() < times.max() <= 0.0
    moments = []
    for shares in (np.zeros(1), times):
        images = []
        for share in shares:
            centres = np.full_like(REST.centres, np.nan)
            centres[1, only] = [share * moved / 152.8 * 7e-3, 0.0, 7e-3]
            images.append(painter.render(replace(REST, centres=centres)))
        dark = (clear - decode_srgb(sent(Imaging(SENSOR, defects, 0), images, 0)))[..., 2]
        dark = np.where(dark > 0.005, dark, 0.0)
        places = np.stack([X, Y]).reshape(2, -1)
        spread = np.cov(places, aweights=dark.ravel(), ddof=0).diagonal()
        moments.append([*np.average(places, axis=1, weights=dark.ravel()), *spread])
    # It shows where the marker was in the middle of the exposure.
    x, y, along, across = np.diff(moments, axis=0)[0]
    assert (x, y) == pytest.approx((-0.375 * moved, 0.0), abs=0.1)
    assert along == pytest.approx((0.75 * moved) ** 2 / 12, rel=0.04)
    assert across == pytest.approx(0.0, abs=0.15)


def test_white_balance_drifts_slowly_within_its_dial() -> None:
    defects = Defects(white_balance_drift=0.2, drift_frames=50)
    gains = np.array([white_balance(defects, 4, index) for index in range(50 * 100)])
    np.testing.assert_allclose(gains.prod(axis=1), 1.0)
    drift = gains[:, 0] / gains[:, 1] - 1.0
    assert 0.19 < abs(drift).max() <= 0.2
    assert abs(drift.mean()) < 5 * 0.2 / np.sqrt(3 * 100)
    # The steepest way from one end to the other: 1.5 · 2 · dial in drift_frames.
    assert abs(np.diff(drift)).max() < 1.5 * 0.4 / 50
    # It has no kink where one way ends and the next begins.
    assert abs(np.diff(drift)[::50]).max() < 3 * 0.4 / 50**2
    dials = {"white_balance_drift": 0.3, "drift_frames": 7}
    red, blue = white_balance(Defects(**dials), 1, 11)
    np.testing.assert_allclose(gain(index=11, **dials)[100, 100], [red, 1.0, blue], atol=0.006)
    assert abs(red / blue - 1.0) > 0.02


def test_gain_jumps_by_its_dial_as_often_as_stated() -> None:
    defects = Defects(gain_step=0.1, gain_step_frames=25)
    gains = np.array([exposure(defects, 5, index) for index in range(25 * 80)])
    assert np.unique(gains).tolist() == pytest.approx([0.95, 1.05])
    jumps = np.flatnonzero(np.diff(gains))
    assert 78 <= len(jumps) <= 80
    assert np.diff(jumps).std() > 5  # not by the clock: each anywhere in its span
    assert gains.mean() == pytest.approx(1.0, abs=0.01)
    light = gain(index=60, gain_step=0.1, gain_step_frames=25)
    np.testing.assert_allclose(light, exposure(defects, 1, 60), atol=0.006)


def test_bayer_keeps_even_colours_and_loses_detail_of_chroma() -> None:
    even = np.empty(SHAPE, dtype=np.uint8)
    even[:] = (209, 107, 63)
    assert (imaged(even, bayer=True) == even).all()
    left = []
    for width in (1, 8):  # of stripes of equal green
        striped = (X // width) % 2 == 1
        image = np.where(striped[..., None], np.uint8([198, 107, 117]), even)
        blue = imaged(image, bayer=True)[100:300, 100:500, 2].astype(float)
        left.append(np.ptp([blue[striped[100:300, 100:500] == side].mean() for side in (0, 1)]))
    assert left[0] < 0.6 * 54
    assert left[1] > 0.85 * 54


def test_bayer_does_not_shift_the_image() -> None:
    """A ramp of light passes the interpolation unchanged, whichever way it runs."""
    ramp = np.rint(encode_srgb(np.linspace(0.2, 0.8, 640)))
    image = np.repeat(np.broadcast_to(ramp, (640, 640))[..., None], 3, axis=-1).astype(np.uint8)
    for turned in (image, image.swapaxes(0, 1)):
        change = []
        for way in (turned, turned[::-1, ::-1]):
            out = imaged(np.ascontiguousarray(way), bayer=True)[4:-4, 4:-4].astype(float)
            change.append(out - way[4:-4, 4:-4])
            assert abs(change[-1]).max() <= 1.0
        # Ties between levels round up on both; a shift would be up on one and down on the other.
        shift = (change[0] - change[1]).mean(axis=(0, 1)) / 2 / np.gradient(ramp).mean()
        assert abs(shift).max() < 0.06


def test_compression_gets_worse_with_its_dial_and_keeps_order_and_odd_sizes() -> None:
    for dial, values, least in (
        ("jpeg_quality", (95, 80, 10), 3.0),
        ("h264_crf", (10, 23, 40), 5.0),
    ):
        errors = [
            np.sqrt(((imaged(picture(), **{dial: v}).astype(float) - picture()) ** 2).mean())
            for v in values
        ]
        assert errors == sorted(errors)
        assert 0.0 < errors[0] < least < errors[-1]
    images = [grey(level, (45, 63, 3)) for level in (40, 90, 140)]
    for image, out in zip(images, through_h264(images, 20), strict=True):
        assert out.shape == through_jpeg(image, 90).shape == (45, 63, 3)
        assert abs(image.astype(int) - out).max() <= 3


def test_a_cameras_noise_is_compressed_with_the_picture() -> None:
    """Else no pixel would show that anything was lost."""

    def shot(**defects: int) -> np.ndarray:
        sensor = TactileSensor(SENSOR, body="chain", noise=2.0, seed=4, defects=Defects(**defects))
        with closing(sensor.camera) as camera:
            return camera.expose_rest(rest_state(Fingertip()), 1)[0].image

    plain, jpeg, h264 = shot(), shot(jpeg_quality=60), shot(h264_crf=30)
    np.testing.assert_array_equal(jpeg, through_jpeg(plain, 60))
    np.testing.assert_array_equal(h264, through_h264([plain], 30)[0])


def test_dust_darkens_and_only_there() -> None:
    few, many = gain(dust=10)[..., 1], gain(dust=200)[..., 1]
    for light in (few, many):
        assert light.max() <= 1.001
        assert light.min() < 0.9
    assert 0.0005 < (few < 0.98).mean() < (many < 0.98).mean() < 0.3
    assert (few[RADIUS > 1.15] > 0.999).all()


def test_specular_spots_saturate_in_a_ring() -> None:
    image = imaged(grey(90), specular=6)
    white = (image == 255).all(axis=-1)
    labels, count = label(white)
    assert count == 6
    assert np.bincount(labels.ravel())[1:].max() < 0.01 * white.size
    assert image.min() == 90
    assert 0.4 < RADIUS[white].min() < RADIUS[white].max() < 0.85


def test_seams_are_tinted_fourfold_by_their_strength() -> None:
    tints = [1.0 - gain(seam_tint=strength) for strength in (0.3, 0.6)]
    np.testing.assert_allclose(tints[1], 2 * tints[0], atol=0.02)
    seam = tints[1][..., 1] > 0.05
    # Green loses more than red: pink; half-way between seams nothing is lost.
    assert tints[1][seam][:, 1].mean() > tints[1][seam][:, 0].mean()
    around = np.arctan2(Y - 239.5, X - 319.5) / (np.pi / 2)
    ring = seam & (RADIUS > 0.4) & (RADIUS < 0.95)
    assert {int(v) for v in np.rint(around[ring]) % 4} == {0, 1, 2, 3}
    assert abs(around - np.rint(around))[ring].max() < 0.2


def lost(**dials: float) -> np.ndarray:
    """What defects take from an even grey skin before a camera of half the pixels."""
    image = grey(128, (240, 320, 3))
    return image - Imaging(HALF, Defects(**dials), 0).measured(image, 0).astype(float)


def test_broad_seams_wander_and_break() -> None:
    straight = lost(seam_tint=1.0, seam_width_mm=1.0)
    assert (straight[120, 200:220].max(axis=-1) > 5).all()  # along the x axis
    bent = lost(seam_tint=1.0, seam_width_mm=1.0, seam_wander_mm=1.5)[100:140, 200:220, 1] + 1e-9
    middle = (np.arange(100, 140)[:, None] * bent).sum(axis=0) / bent.sum(axis=0)
    assert abs(middle - 119.5).max() > 1.0
    broken = lost(seam_tint=1.0, seam_width_mm=1.0, seam_gaps=0.7)
    assert 0.05 < (broken > 5).sum() / (straight > 5).sum() < 0.7


def test_glow_clouds_grain_and_threads_have_their_size() -> None:
    skin = ground_image(HALF)[..., 1] > 0.3
    glow = -lost(glow=0.3)
    assert glow[100:140, 140:180].mean() > 12.8 > glow[~skin].mean()
    # Of linear light: sRGB's slope is 1/2.2 of it on a logarithmic scale.
    grain = np.log1p(-lost(grain=0.05)[skin] / 128.0)
    assert grain.std() == pytest.approx(0.05 / 2.2, rel=0.15)
    clouds = lost(blotches=0.4)[skin]
    assert clouds.std(axis=0).min() > 3.0
    assert np.corrcoef(clouds[:, 0], clouds[:, 2])[0, 1] < 0.9  # bluish and brownish
    assert 0.002 < (lost(threads=8).max(axis=-1) > 8)[skin].mean() < 0.08


def test_markers_are_missing_or_worn_off() -> None:
    flaws = Flaws(SENSOR, Defects(missing_markers=0.125), 7)
    seen = flaws(REST)
    gone = np.isnan(seen.centres).all(axis=-1)
    assert (gone == flaws.missing).all()
    assert gone.sum(axis=1).tolist() == [50, 50]
    assert (gone[0] != gone[1]).any()
    assert (seen.centres[~gone] == REST.centres[~gone]).all()
    worn, other = (Flaws(SENSOR, Defects(worn_markers=0.125), seed).missing for seed in (7, 8))
    assert (other != worn).any()
    outer = int(np.argmin(SENSOR.depths))
    assert worn.sum(axis=1)[[outer, 1 - outer]].tolist() == [50, 0]
    # A smooth edge has every worn marker nearer than every other; a ragged one nearly.
    theta, edge = SENSOR.places[:, 0], np.sort(SENSOR.places[:, 0])[50]
    assert theta[worn[outer]].max() < 3.0 * edge
    assert worn[outer][theta < edge / 3].all()
    assert 0.5 < worn[outer][theta < edge].mean() < 1.0


def made(sensor: SensorDesign, seed: int, **dials: float) -> Membrane:
    """Resting markers of a specimen."""
    flaws = Flaws(sensor, Defects(**dials), seed)
    return flaws(rest_membrane(sensor, flaws.places))


def test_misalignment_turns_the_yellow_layer() -> None:
    apex = int(np.argmin(np.hypot(*REST.centres[1, :, :2].T)))
    directions = []
    for seed in (0, 1):
        seen = made(SENSOR, seed, misalignment_mm=0.2)
        np.testing.assert_allclose(seen.centres[0], REST.centres[0], atol=1e-15)
        moved = seen.centres[1] - REST.centres[1]
        directions.append(np.arctan2(*moved[apex, :2]))
        assert np.linalg.norm(moved[apex]) == pytest.approx(0.2e-3, rel=0.02)
        # A rigid turn of the layer: it stays on its ball, and distances stay, but for d²/r.
        assert np.linalg.norm(seen.centres[1], axis=-1) == pytest.approx(7e-3)
        before, after = (pdist(c[1]) for c in (REST.centres, seen.centres))
        assert abs(after - before).max() < 2 * 0.2e-3**2 / 7e-3
    assert abs(np.diff(directions)) > 0.1


def test_misalignment_of_a_pad_is_a_shift_and_a_turn() -> None:
    pad = load_sensor("flat-2019")
    rest = rest_membrane(pad).centres[1]
    moved = made(pad, 2, misalignment_mm=0.1).centres[1] - rest
    assert abs(moved[:, 2]).max() < 1e-12
    assert np.hypot(*moved.mean(axis=0)[:2]) == pytest.approx(1e-4, rel=1e-6)
    around = moved - moved.mean(axis=0)
    turn = np.cross(rest * [1.0, 1.0, 0.0], around)[:, 2] / (rest**2)[:, :2].sum(axis=-1)
    np.testing.assert_allclose(turn, turn[0], rtol=1e-4)
    assert 0.0 < abs(turn[0]) * pad.shape.half <= 1e-4


def test_misplacement_scatters_along_the_skin() -> None:
    moved = made(SENSOR, 3, misplacement_mm=0.05).centres - REST.centres
    assert np.linalg.norm(moved + REST.centres, axis=-1) == pytest.approx(
        np.linalg.norm(REST.centres, axis=-1)
    )
    # Two directions along the skin; 1600 numbers.
    assert (moved**2).sum() / 1600 == pytest.approx(0.05e-3**2, rel=5 * np.sqrt(2 / 1600))
    assert abs(np.corrcoef(moved[0].ravel(), moved[1].ravel())[0, 1]) < 0.15
    # Crooked markers stay pairs, but for their places on balls of two sizes.
    moved = made(SENSOR, 3, crookedness_mm=0.05).centres - REST.centres
    assert (moved[0] ** 2).sum() / 800 == pytest.approx(0.05e-3**2, rel=5 * np.sqrt(2 / 800))
    np.testing.assert_allclose(moved[0], moved[1], atol=0.3 * 0.05e-3)


def test_each_gore_is_out_of_register_by_itself() -> None:
    moved = made(SENSOR, 1, gore_misalignment_mm=0.3).centres - REST.centres
    assert abs(moved[0]).max() < 1e-12
    near = SENSOR.places[:, 0] < 0.9  # where a turn of the layer is nearly a shift
    quarter = np.floor(np.mod(SENSOR.places[:, 1], 2 * np.pi) / (np.pi / 2)).astype(int)
    shifts = np.array([moved[1, near & (quarter == q), :2].mean(axis=0) for q in range(4)])
    sizes = np.hypot(*shifts.T)
    assert 0.2e-3 < sizes.max() < 0.42e-3
    assert sizes.min() < 0.1 * sizes.max()
    assert np.ptp(np.arctan2(*shifts.T)) > 0.3


def test_rubbed_markers_lose_a_part_of_their_area_inside_their_outline() -> None:
    rubbed = made(SENSOR, 3, rubbed_markers=0.5)
    areas = [np.linalg.norm(np.cross(*np.moveaxis(m.axes, -1, 0)), axis=-1) for m in (REST, rubbed)]
    left = areas[1] / areas[0]
    assert (left < 0.999).mean() == pytest.approx(0.5, abs=0.06)
    assert 0.35 <= left.min() <= left[left < 0.999].max() <= 0.8
    away = np.linalg.norm(rubbed.centres - REST.centres, axis=-1)
    radius = np.linalg.norm(REST.axes[..., 0], axis=-1)
    assert (away <= radius * (1.0 - left) + 1e-12).all()


def test_flaws_move_with_the_skin() -> None:
    """A marker beside its place goes where the skin there goes: swollen skin moves them apart."""
    flaws = Flaws(SENSOR, Defects(misplacement_mm=0.05, misalignment_mm=0.1), 3)
    angle = np.linspace(-np.pi / 2, np.pi / 2, 251)
    swollen = 0.1 * 8e-3 * np.column_stack([np.sin(angle), np.cos(angle)])
    swollen[[0, -1]] = 0.0  # held
    here, whole = (MembraneMap(SENSOR, 251, p)(swollen).centres for p in (flaws.places, None))
    at_rest = flaws(rest_membrane(SENSOR, flaws.places)).centres - REST.centres
    inner = REST.centres[0, :, 2] > 1e-3  # off the rim, which is held
    for layer, (depth, follow) in enumerate(zip(SENSOR.depths, SENSOR.follow, strict=True)):
        grown = 1.0 + follow * 0.1 * 8e-3 / (8e-3 - depth)
        np.testing.assert_allclose(
            (here - whole)[layer, inner], grown * at_rest[layer, inner], atol=2e-7, rtol=1e-3
        )


def test_no_dial_changes_what_another_draws() -> None:
    both = made(SENSOR, 3, misplacement_mm=0.05, misalignment_mm=0.1).centres
    one = made(SENSOR, 3, misplacement_mm=0.05).centres
    other = made(SENSOR, 3, misalignment_mm=0.1).centres
    # But for what the ball's curvature adds to two small steps on it.
    np.testing.assert_allclose(both, one + other - REST.centres, atol=0.3e-3**2 / 7e-3)
    alone = Flaws(SENSOR, Defects(missing_markers=0.1), 3).missing
    assert (alone == Flaws(SENSOR, EVERYTHING, 3).missing).mean() > 0.85


def test_order_of_calls_does_not_matter() -> None:
    first, second = (Imaging(SMALL, EVERYTHING, 9) for _ in range(2))
    image = open_renderer("painter", SMALL).render(REST)
    exposures = [image] * len(shutter_times(EVERYTHING, 0.02))
    forwards = [sent(first, exposures, index) for index in (0, 50)]
    backwards = [sent(second, exposures, index) for index in (50, 0)][::-1]
    for one, other in zip(forwards, backwards, strict=True):
        assert (one == other).all()
    assert (forwards[0] != forwards[1]).any()
    assert (sent(Imaging(SMALL, EVERYTHING, 8), exposures, 0) != forwards[0]).any()


@pytest.mark.parametrize("end", ["ge", "le"])
def test_dials_at_their_ends_give_an_image(end: str) -> None:
    kinds = type_info(Defects)
    assert isinstance(kinds, StructType)
    limits = {each.name: min(getattr(each.type, end, end == "le"), 51) for each in kinds.fields}
    defects = convert(limits, Defects, "defects")
    flaws = Flaws(SMALL, defects, 2**63)
    with closing(open_renderer("painter", SMALL)) as painter:
        ideal = painter.render(flaws(rest_membrane(SMALL, flaws.places)))
    exposures = [ideal] * len(shutter_times(defects, 0.02))
    result = sent(Imaging(SMALL, defects, 2**63), exposures, 2**32 - 1)
    assert (result.shape, result.dtype) == ((93, 121, 3), np.uint8)


@pytest.mark.stages
def test_the_built_dome_looks_like_the_real_one() -> None:
    """Specimens that no dial was set by; two of fifteen statistics may be an unusual one's."""
    from benchmarks.render.looks import built_dome, likenesses, look_of_built

    for seed in (11, 12):
        alike = likenesses(look_of_built(seed))
        assert sum(alike.values()) >= len(alike) - 2
    assert (abs(built_dome(11).astype(int) - built_dome(12)) > 30).any(axis=-1).mean() > 0.1


def test_a_scene_has_its_sensors_defects_and_its_own() -> None:
    built = load_sensor("dome-2020").defects
    scene = load_scene("thesis", {"sensor": "dome-2020", "defects.threads": 0, "defects.dust": 9})
    assert scene.defects == msgspec.structs.replace(built, threads=0, dust=9)
    assert load_scene("thesis").defects == Defects()
    # Written and read again nothing is added.
    assert parse_scene(msgspec.to_builtins(scene), "again") == scene
    with pytest.raises(UserError, match=r"vignette = 1.5: expected a number"):
        load_scene("thesis", {"defects.vignette": 1.5})


def test_the_rim_hides_what_is_beyond() -> None:
    sensor = load_sensor("dome-2020")
    ground = ground_image(sensor)
    y, x = np.mgrid[: sensor.view.height, : sensor.view.width]
    away = np.hypot(x - 143.5, y - 143.5)
    rim = 126.0 * np.deg2rad(62.0)
    assert ground[away > rim + 2].max() < 0.01
    assert ground[away < rim - 2].min() > 0.1
