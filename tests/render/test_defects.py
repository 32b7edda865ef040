from contextlib import closing
from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromagrip.model import Fingertip, rest_state
from chromagrip.render import Membrane, MembraneMap, SensorDesign, load_sensor, open_renderer
from chromagrip.render.colour import decode_srgb, encode_srgb
from chromagrip.render.design.dials import Defects
from chromagrip.render.design.sensor import Seams
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
from chromagrip.sensing.sensor import TactileSensor
from chromagrip.strict_toml import convert

SENSOR = load_sensor("thesis")
MEMBRANE = MembraneMap(SENSOR, 251)
REST = MEMBRANE(np.zeros((251, 2)))
SHAPE = (480, 640, 3)
MIDDLE = (239.5, 319.5)
EVERYTHING = Defects(
    shot_noise_electrons=8000,
    read_noise_electrons=12,
    vignette=0.35,
    uneven_leds=0.15,
    defocus_px=0.7,
    motion_blur=0.5,
    white_balance_drift=0.1,
    drift_frames=20,
    gain_step=0.08,
    gain_step_frames=10,
    bayer=True,
    jpeg_quality=80,
    h264_crf=23,
    dust=25,
    specular=6,
    missing_markers=0.03,
    worn_markers=0.05,
    seam_tint=0.7,
    misalignment_mm=0.12,
    misplacement_mm=0.05,
    crookedness_mm=0.05,
    gore_misalignment_mm=0.2,
    rubbed_markers=0.05,
    seam_width_mm=1.0,
    seam_wander_mm=0.5,
    seam_gaps=0.2,
    glow=0.2,
    blotches=0.2,
    grain=0.03,
    threads=3,
)


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


def gain(level: int = 200, **dials: float) -> np.ndarray:
    """Factor on the linear light of an even image."""
    return decode_srgb(imaged(grey(level), **dials)) / decode_srgb(float(level))


def deviation(image: np.ndarray, reference: np.ndarray) -> float:
    return float(np.sqrt(((image.astype(float) - reference) ** 2).mean()))


@cache
def skin_radius() -> np.ndarray:
    """Distance from the middle in radii of the skin's image."""
    y, x = np.mgrid[:480, :640]
    return np.hypot(x - MIDDLE[1], y - MIDDLE[0]) / (152.8 * np.pi / 2)


def test_all_off_costs_nothing() -> None:
    image = picture()
    assert sent(Imaging(SENSOR, Defects(), 3), image, 5) is image
    assert Flaws(SENSOR, Defects(), 3)(REST) is REST
    assert shutter_times(Defects(), 0.02).tolist() == [0.0]


def test_the_linear_chain_keeps_every_level() -> None:
    """Two equal exposures pass it and change nothing."""
    levels = np.tile(np.arange(256, dtype=np.uint8)[:, None], (1, 3))[None]
    out = sent(Imaging(SENSOR, Defects(), 0), [levels, levels], 0)
    assert (out == levels).all()


@pytest.mark.parametrize("well", [2000.0, 10000.0])
def test_photon_transfer(well: float) -> None:
    """Variance of linear light is mean / full well."""
    for level in (60, 128, 200):
        mean = decode_srgb(float(level))
        light = decode_srgb(imaged(grey(level), shot_noise_electrons=well))
        slope = (1.055 / 2.4) * mean ** (1 / 2.4 - 1)  # of the sRGB curve
        rounding = 1 / 12 / (255 * slope) ** 2
        count = light.size
        assert light.mean() == pytest.approx(mean, abs=5 * np.sqrt(mean / well / count) + 2e-4)
        # A variance estimated from n values is off by √(2/n); the curve bends a little.
        assert light.var() == pytest.approx(
            mean / well + rounding, rel=5 * np.sqrt(2 / count) + 0.02
        )


def test_read_noise_is_the_floor() -> None:
    """With or without light; of the full well that is given."""
    for well, electrons in ((0.0, 100.0), (20000.0, 200.0)):
        dials = {"shot_noise_electrons": well, "read_noise_electrons": electrons}
        mean = decode_srgb(60.0)
        shot = mean / well if well else 0.0
        light = decode_srgb(imaged(grey(60), **dials))
        assert light.std() == pytest.approx(np.sqrt(1e-4 + shot), rel=0.02)
        # In the dark half of it is cut off: the mean of half a normal distribution is σ/√(2π).
        dark = decode_srgb(imaged(grey(0), **dials))
        assert dark.mean() == pytest.approx(0.01 / np.sqrt(2 * np.pi), rel=0.02)


def test_noise_of_frames_is_independent() -> None:
    noise = [
        imaged(grey(128), seed, index, shot_noise_electrons=2000.0) - 128.0
        for seed, index in ((1, 0), (1, 1), (2, 0))
    ]
    for i, j in ((0, 1), (0, 2), (1, 2)):
        correlation = (noise[i] * noise[j]).mean() / noise[0].var()
        assert abs(correlation) < 5 / np.sqrt(noise[0].size)


def test_vignette_takes_its_share_at_the_corner() -> None:
    factor = gain(vignette=0.4)
    assert factor[239, 319] == pytest.approx(1.0, abs=0.005)
    assert factor[0, 0] == pytest.approx(0.6, abs=0.005)
    # Half-way to the corner a quarter of it.
    assert factor[120, 160] == pytest.approx(0.9, abs=0.006)


def test_uneven_leds_deviate_by_no_more_and_are_fair() -> None:
    light = gain(uneven_leds=0.2)[..., 0]
    skin = light[skin_radius() < 1.0]
    assert abs(skin - 1.0).max() == pytest.approx(0.2, abs=0.01)
    assert skin.mean() == pytest.approx(1.0, abs=0.003)
    # Smooth: nothing changes fast from pixel to pixel but the rounding to whole levels.
    assert abs(np.diff(light, axis=0)).max() < 0.03
    assert (
        abs(
            gain(uneven_leds=0.2) - sent(Imaging(SENSOR, Defects(uneven_leds=0.2), 2), grey(200), 0)
        ).max()
        > 0.1
    )


@pytest.mark.parametrize("sigma", [1.0, 2.5])
def test_defocus_adds_in_squares(sigma: float) -> None:
    """The derivative of an edge is the blur: variances add."""

    def variance(image: np.ndarray) -> float:
        line = np.diff(decode_srgb(image)[200:280, :, 1].mean(axis=0))
        x = np.arange(len(line))
        mean = (line * x).sum() / line.sum()
        return float((line * (x - mean) ** 2).sum() / line.sum())

    x = np.arange(640)
    ramp = np.clip((x - 310) / 10.0, 0.0, 1.0)
    edge = np.broadcast_to(np.rint(encode_srgb(0.1 + 0.7 * ramp)), (480, 640))
    edge = np.repeat(edge[..., None], 3, axis=-1).astype(np.uint8)
    added = variance(imaged(edge, defocus_px=sigma)) - variance(edge)
    assert added == pytest.approx(sigma**2, rel=0.03)


def test_an_open_shutter_draws_a_marker_out() -> None:
    """A uniform motion by d adds d²/12 along it and nothing across."""
    painter = open_renderer("painter", SENSOR)
    clear = decode_srgb(painter.render(replace(REST, centres=REST.centres * np.nan)))
    only = np.argmin(np.hypot(*REST.centres[0, :, :2].T))
    moved = 12.0  # [px] in a period
    defects = Defects(motion_blur=0.75)
    times = shutter_times(defects, 1.0)
    assert times.min() >= -0.75
    assert times.max() <= 0.0
    step = moved / 152.8 * 7e-3

    def seen(shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        images = []
        for share in shares:
            centres = np.full_like(REST.centres, np.nan)
            centres[1, only] = [share * step, 0.0, 7e-3]
            images.append(painter.render(replace(REST, centres=centres)))
        light = decode_srgb(sent(Imaging(SENSOR, defects, 0), images, 0))
        dark = (clear - light)[..., 2]
        dark = np.where(dark > 0.005, dark, 0.0)
        y, x = np.mgrid[:480, :640]
        weight = dark / dark.sum()
        mean = np.array([(weight * x).sum(), (weight * y).sum()])
        return mean, np.array(
            [(weight * (x - mean[0]) ** 2).sum(), (weight * (y - mean[1]) ** 2).sum()]
        )

    still, own = seen(np.zeros(1))
    place, spread = seen(times)
    assert spread[0] - own[0] == pytest.approx((0.75 * moved) ** 2 / 12, rel=0.04)
    assert spread[1] - own[1] == pytest.approx(0.0, abs=0.15)
    # It shows where the marker was in the middle of the exposure.
    np.testing.assert_allclose(place - still, [-0.375 * moved, 0.0], atol=0.1)


def test_white_balance_drifts_slowly_within_its_dial() -> None:
    defects = Defects(white_balance_drift=0.2, drift_frames=50)
    ratio = []
    for index in range(0, 50 * 400, 10):
        red, blue = white_balance(defects, 4, index)
        assert red * blue == pytest.approx(1.0)
        ratio.append(red / blue)
    drift = np.array(ratio) - 1.0
    assert 0.19 < abs(drift).max() <= 0.2
    assert abs(drift.mean()) < 5 * 0.2 / np.sqrt(3 * 400)
    # The steepest way from one end to the other: 1.5 · 2 · dial in drift_frames.
    assert abs(np.diff(drift)).max() < 1.5 * 0.4 * 10 / 50


def test_white_balance_in_the_image() -> None:
    dials = {"white_balance_drift": 0.3, "drift_frames": 7}
    light = gain(index=11, **dials)[100, 100]
    red, blue = white_balance(Defects(**dials), 1, 11)
    np.testing.assert_allclose(light, [red, 1.0, blue], atol=0.006)
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
    expected = exposure(Defects(gain_step=0.1, gain_step_frames=25), 1, 60)
    np.testing.assert_allclose(light, expected, atol=0.006)


def test_bayer_keeps_even_colours_and_loses_detail_of_chroma() -> None:
    even = np.empty(SHAPE, dtype=np.uint8)
    even[:] = (209, 107, 63)
    assert (imaged(even, bayer=True) == even).all()
    # Stripes of one pixel: of equal green they vanish or alias; of two wide patches they stay.
    x = np.arange(640)

    def stripes(width: int) -> float:
        image = even.copy()
        image[:, (x // width) % 2 == 1] = (198, 107, 117)
        out = imaged(image, bayer=True).astype(float)
        blue, reference = out[100:300, 100:500, 2], image[100:300, 100:500, 2].astype(float)
        centred = reference - reference.mean()
        return float((blue * centred).sum() / (centred**2).sum())

    assert stripes(1) < 0.6
    assert stripes(8) > 0.85
    assert deviation(imaged(picture(), bayer=True), picture()) > 0.5


def test_bayer_does_not_shift_the_image() -> None:
    """A ramp of light passes the interpolation unchanged, whichever way it runs."""
    ramp = np.rint(encode_srgb(np.linspace(0.2, 0.8, 640)))
    image = np.repeat(np.broadcast_to(ramp, (640, 640))[..., None], 3, axis=-1).astype(np.uint8)
    steepness = np.gradient(ramp).mean()
    for turned in (image, image.swapaxes(0, 1)):
        change = []
        for way in (turned, turned[::-1, ::-1]):
            out = imaged(np.ascontiguousarray(way), bayer=True)[4:-4, 4:-4].astype(float)
            change.append(out - way[4:-4, 4:-4])
            assert abs(change[-1]).max() <= 1.0
        # Ties between levels round up on both; a shift would be up on one and down on the other.
        shift = (change[0].mean(axis=(0, 1)) - change[1].mean(axis=(0, 1))) / 2 / steepness
        # What is left is by chance: on which column of a pair the ramp's steps fall.
        assert abs(shift).max() < 0.06


def test_jpeg_gets_better_with_quality() -> None:
    errors = [deviation(imaged(picture(), jpeg_quality=q), picture()) for q in (10, 50, 80, 95)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 3.0 < errors[0]


@pytest.mark.parametrize("lossy", [{"jpeg_quality": 60}, {"h264_crf": 30}])
def test_a_cameras_noise_is_compressed_with_the_picture(lossy: dict[str, int]) -> None:
    """Else no pixel would show that anything was lost."""

    def shot(**defects: int) -> np.ndarray:
        sensor = TactileSensor(SENSOR, body="chain", noise=2.0, seed=4, defects=Defects(**defects))
        with closing(sensor.camera) as camera:
            return camera.expose_rest(rest_state(Fingertip()), 1)[0].image

    plain, sent = shot(), shot(**lossy)
    whole = through_jpeg(plain, 60) if "jpeg_quality" in lossy else through_h264([plain], 30)[0]
    np.testing.assert_array_equal(sent, whole)
    assert (sent != plain).any()


def test_h264_gets_worse_with_crf_and_loses_chroma() -> None:
    errors = [deviation(imaged(picture(), h264_crf=crf), picture()) for crf in (10, 23, 40)]
    assert errors == sorted(errors)

    def chroma(image: np.ndarray) -> np.ndarray:
        return image[..., 0].astype(float) - image[..., 2]

    h264 = imaged(picture(), h264_crf=10)
    jpeg = imaged(picture(), jpeg_quality=95)
    own = chroma(picture())
    assert deviation(chroma(h264), own) > deviation(chroma(jpeg), own)
    assert abs(imaged(grey(128), h264_crf=10).astype(int) - 128).max() <= 2


def test_h264_stream_keeps_order_and_odd_sizes() -> None:
    images = [grey(level, (45, 63, 3)) for level in (40, 90, 140)]
    out = through_h264(images, 20)
    assert [image.shape for image in out] == [(45, 63, 3)] * 3
    for image, level in zip(out, (40, 90, 140), strict=True):
        assert abs(image.astype(int) - level).max() <= 3
    assert through_jpeg(images[0], 90).shape == (45, 63, 3)


def test_dust_darkens_and_only_there() -> None:
    few, many = gain(dust=10)[..., 1], gain(dust=200)[..., 1]
    for light in (few, many):
        assert light.max() <= 1.001
        assert light.min() < 0.9
    assert 0.0005 < (few < 0.98).mean() < (many < 0.98).mean() < 0.3
    assert (few[skin_radius() > 1.15] > 0.999).all()


def test_specular_spots_saturate() -> None:
    image = imaged(grey(90), specular=6)
    white = (image == 255).all(axis=-1)
    # Six round patches around the middle.
    count, sizes = patches(white)
    assert count == 6
    assert sizes.max() < 0.01 * SHAPE[0] * SHAPE[1]
    assert image.min() == 90
    assert (skin_radius()[white] < 0.85).all()
    assert (skin_radius()[white] > 0.4).all()


def patches(mask: np.ndarray) -> tuple[int, np.ndarray]:
    from scipy.ndimage import label

    labels, count = label(mask)
    return count, np.bincount(labels.ravel())[1:]


def test_seams_are_tinted_fourfold_by_their_strength() -> None:
    tints = [1.0 - gain(seam_tint=strength) for strength in (0.3, 0.6)]
    assert tints[1][..., 1].max() > 0.1
    np.testing.assert_allclose(tints[1], 2 * tints[0], atol=0.02)
    # Green loses more than red: pink; half-way between seams nothing is lost.
    seam = tints[1][..., 1] > 0.05
    assert tints[1][seam][:, 1].mean() > tints[1][seam][:, 0].mean()
    y, x = np.mgrid[:480, :640]
    around = np.arctan2(y - MIDDLE[0], x - MIDDLE[1])
    ring = seam & (skin_radius() > 0.4) & (skin_radius() < 0.95)
    assert {int(v) for v in np.rint(around[ring] / (np.pi / 2)) % 4} == {0, 1, 2, 3}
    far = abs(around / (np.pi / 2) - np.rint(around / (np.pi / 2))) > 0.3
    assert not (ring & far).any()
    own = msgspec.structs.replace(
        SENSOR, seams=Seams(count=3, width_mm=0.9, colour=(226, 196, 201))
    )
    three = sent(Imaging(own, Defects(seam_tint=0.6), 1), grey(200), 0)
    assert (three[240, 480:520] < 200).any()
    assert (three[240, 120:160] == 200).all()


@pytest.mark.parametrize("share", [0.0, 0.1, 1.0])
def test_missing_markers(share: float) -> None:
    flaws = Flaws(SENSOR, Defects(missing_markers=share), 7)
    seen = flaws(REST)
    gone = np.isnan(seen.centres).all(axis=-1)
    assert (gone == flaws.missing).all()
    assert gone.sum(axis=1).tolist() == [round(share * 400)] * 2
    assert (seen.centres[~gone] == REST.centres[~gone]).all()
    if 0.0 < share < 1.0:
        assert (gone[0] != gone[1]).any()
    # Nothing is drawn where both are gone, and the others are where they were.
    image = open_renderer("painter", SENSOR).render(seen)
    place = np.rint(SENSOR.view.project(REST.centres[1])).astype(int)
    clear = open_renderer("painter", SENSOR).render(
        replace(REST, centres=np.full_like(REST.centres, np.nan))
    )
    both, neither = gone.all(axis=0), ~gone.any(axis=0)
    at = image[place[:, 1], place[:, 0]].astype(int)
    assert (at[both] == clear[place[both, 1], place[both, 0]]).all()
    assert (at[neither] == picture()[place[neither, 1], place[neither, 0]]).all()


@pytest.mark.parametrize("share", [0.0, 0.125, 1.0])
def test_the_outer_layer_wears_off_where_it_touches(share: float) -> None:
    worn = Flaws(SENSOR, Defects(worn_markers=share), 7).missing
    outer = int(np.argmin(SENSOR.depths))
    assert worn[outer].sum() == round(share * 400)
    assert not worn[1 - outer].any()
    if 0.0 < share < 1.0:
        theta = SENSOR.places[:, 0]
        # A smooth edge has every worn marker nearer than every other; a ragged one nearly.
        edge = np.sort(theta)[worn[outer].sum()]
        assert theta[worn[outer]].max() < 3.0 * edge
        assert worn[outer][theta < edge / 3].all()
        assert 0.5 < worn[outer][theta < edge].mean() < 1.0
        assert (Flaws(SENSOR, Defects(worn_markers=share), 8).missing != worn).any()


def made(sensor: SensorDesign, defects: Defects, seed: int) -> Membrane:
    """Resting markers of a specimen."""
    flaws = Flaws(sensor, defects, seed)
    return flaws(rest_membrane(sensor, flaws.places))


def flaws_of(misplacement: float, misalignment: float) -> Defects:
    return Defects(misplacement_mm=misplacement, misalignment_mm=misalignment)


def yellow_centroid(membrane: Membrane, only: int) -> np.ndarray:
    """Where the image shows one yellow marker [px]."""
    painter = open_renderer("painter", SENSOR)
    centres = np.full_like(membrane.centres, np.nan)
    clear = decode_srgb(painter.render(replace(membrane, centres=centres)))[..., 2]
    centres[1, only] = membrane.centres[1, only]
    dark = clear - decode_srgb(painter.render(replace(membrane, centres=centres)))[..., 2]
    y, x = np.mgrid[:480, :640]
    return np.array([(dark * x).sum(), (dark * y).sum()]) / dark.sum()


def test_misalignment_shifts_yellow_in_the_image() -> None:
    """Near the apex by focal · shift / distance of the layer from the camera."""
    apex = int(np.argmin(np.hypot(*REST.centres[1, :, :2].T)))
    for seed in (0, 1):
        seen = made(SENSOR, Defects(misalignment_mm=0.2), seed)
        np.testing.assert_allclose(seen.centres[0], REST.centres[0], atol=1e-15)
        shift = yellow_centroid(seen, apex) - yellow_centroid(REST, apex)
        assert np.hypot(*shift) == pytest.approx(152.8 * 0.2 / 7.0, rel=0.02)
        # A rigid turn of the layer: it stays on its ball, and distances stay, but for d²/r.
        moved = seen.centres[1] - REST.centres[1]
        assert np.linalg.norm(seen.centres[1], axis=-1) == pytest.approx(7e-3)
        assert np.linalg.norm(moved, axis=-1).max() <= 0.2e-3 * np.sqrt(2) + 1e-12
        before, after = (
            np.linalg.norm(c[1, :, None] - c[1, None], axis=-1)
            for c in (REST.centres, seen.centres)
        )
        assert abs(after - before).max() < 2 * 0.2e-3**2 / 7e-3


def test_misalignment_of_a_pad_is_a_shift_and_a_turn() -> None:
    values = msgspec.to_builtins(SENSOR)
    values["skin"] = {"shape": "pad", "side_mm": 16.0, "thickness_mm": 3.0}
    values["layout"] = {"kind": "grid", "rows": 11, "columns": 11, "pitch_mm": 1.2}
    values["camera"] |= {"position_mm": -12.0}
    values["seams"] = values["silicone"] = None
    pad = convert(values, SensorDesign, "a pad")
    rest = MembraneMap(pad, 11)(np.zeros((11, 2)))
    moved = made(pad, Defects(misalignment_mm=0.1), 2).centres[1] - rest.centres[1]
    assert abs(moved[:, 2]).max() < 1e-12
    assert np.hypot(*moved.mean(axis=0)[:2]) == pytest.approx(1e-4, rel=1e-6)
    around = moved - moved.mean(axis=0)
    turn = np.cross(rest.centres[1], around)[:, 2] / (rest.centres[1] ** 2)[:, :2].sum(axis=-1)
    turn = turn[np.isfinite(turn) & (np.hypot(*rest.centres[1, :, :2].T) > 1e-4)]
    np.testing.assert_allclose(turn, turn[0], rtol=1e-4)
    assert 0.0 < abs(turn[0]) * 8e-3 <= 1e-4


def test_misplacement_scatters_along_the_skin() -> None:
    moved = made(SENSOR, Defects(misplacement_mm=0.05), 3).centres - REST.centres
    assert np.linalg.norm(moved + REST.centres, axis=-1) == pytest.approx(
        np.linalg.norm(REST.centres, axis=-1)
    )
    # Two directions along the skin; 1600 numbers.
    assert (moved**2).sum() / 1600 == pytest.approx(0.05e-3**2, rel=5 * np.sqrt(2 / 1600))
    assert abs(np.corrcoef(moved[0].ravel(), moved[1].ravel())[0, 1]) < 0.15


def test_flaws_move_with_the_skin() -> None:
    """A marker beside its place goes where the skin there goes: swollen skin moves them apart."""
    flaws = Flaws(SENSOR, flaws_of(0.05, 0.1), 3)
    angle = np.linspace(-np.pi / 2, np.pi / 2, 251)
    swollen = 0.1 * 8e-3 * np.column_stack([np.sin(angle), np.cos(angle)])
    swollen[[0, -1]] = 0.0  # held
    here = MembraneMap(SENSOR, 251, flaws.places)(swollen).centres - MEMBRANE(swollen).centres
    at_rest = made(SENSOR, flaws_of(0.05, 0.1), 3).centres - REST.centres
    inner = REST.centres[0, :, 2] > 1e-3  # off the rim, which is held
    for layer, (depth, follow) in enumerate(zip(SENSOR.depths, SENSOR.follow, strict=True)):
        grown = 1.0 + follow * 0.1 * 8e-3 / (8e-3 - depth)
        np.testing.assert_allclose(
            here[layer, inner], grown * at_rest[layer, inner], atol=2e-7, rtol=1e-3
        )


def test_no_dial_changes_what_another_draws() -> None:
    both = made(SENSOR, flaws_of(0.05, 0.1), 3).centres
    one = made(SENSOR, flaws_of(0.05, 0.0), 3).centres
    other = made(SENSOR, flaws_of(0.0, 0.1), 3).centres
    # But for what the ball's curvature adds to two small steps on it.
    np.testing.assert_allclose(both, one + other - REST.centres, atol=0.3e-3**2 / 7e-3)
    alone = Flaws(SENSOR, Defects(missing_markers=0.1), 3).missing
    assert (alone == Flaws(SENSOR, EVERYTHING, 3).missing).mean() > 0.85


def test_order_of_calls_does_not_matter() -> None:
    first, second = (Imaging(SENSOR, EVERYTHING, 9) for _ in range(2))
    exposures = [picture()] * len(shutter_times(EVERYTHING, 0.02))
    forwards = [sent(first, exposures, index) for index in (0, 1, 50)]
    backwards = [sent(second, exposures, index) for index in (50, 1, 0)][::-1]
    for one, other in zip(forwards, backwards, strict=True):
        assert (one == other).all()
    assert (forwards[0] != forwards[1]).any()
    assert (sent(Imaging(SENSOR, EVERYTHING, 8), exposures, 0) != forwards[0]).any()
    last = sent(Imaging(SENSOR, EVERYTHING, 9), exposures, 2**32 - 1)
    assert last.shape == SHAPE
    assert (exposures[0] == picture()).all()


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"vignette": 1.5}, "defects: vignette = 1.5: expected a number <= 1.0"),
        ({"jpeg_quality": 101}, "defects: jpeg_quality = 101: expected a whole number <= 100"),
        ({"drift_frames": 0}, "defects: drift_frames = 0: expected a whole number >= 1"),
        ({"bayer": "yes"}, "defects: bayer = 'yes': expected true or false, got text"),
        ({"dust": -1}, "defects: dust = -1: expected a whole number >= 0"),
    ],
)
def test_an_impossible_dial_is_one_sentence(values: dict[str, object], sentence: str) -> None:
    with pytest.raises(ValueError, match="defects") as caught:
        convert(values, Defects, "defects")
    assert str(caught.value).replace("`", "") == sentence


def test_an_unknown_dial_is_named() -> None:
    with pytest.raises(
        ValueError,
        match=r"defects: unknown key dusty \(did you mean dust\?\); allowed here: shot_noise",
    ):
        convert({"dusty": 3}, Defects, "defects")


def small() -> SensorDesign:
    """The thesis' fingertip in an image of odd size."""
    settings = msgspec.structs.replace(
        SENSOR.camera, width_px=121, height_px=93, focal_px=(28.0, 28.0)
    )
    return msgspec.structs.replace(SENSOR, camera=settings)


SMALL = small()
SHARE = st.one_of(st.just(0.0), st.floats(0.0, 1.0))


@settings(max_examples=60, derandomize=True)
@given(
    defects=st.builds(
        Defects,
        shot_noise_electrons=st.one_of(st.just(0.0), st.floats(1.0, 1e6)),
        read_noise_electrons=st.one_of(st.just(0.0), st.floats(0.0, 1e6)),
        vignette=SHARE,
        uneven_leds=SHARE,
        defocus_px=st.one_of(st.just(0.0), st.floats(0.0, 20.0)),
        motion_blur=SHARE,
        white_balance_drift=st.floats(0.0, 0.5),
        drift_frames=st.integers(1, 10**6),
        gain_step=SHARE,
        gain_step_frames=st.integers(1, 10**6),
        bayer=st.booleans(),
        jpeg_quality=st.integers(0, 100),
        h264_crf=st.one_of(st.just(0), st.integers(1, 51)),
        dust=st.integers(0, 30),
        specular=st.integers(0, 10),
        missing_markers=SHARE,
        worn_markers=SHARE,
        seam_tint=SHARE,
        misalignment_mm=st.floats(0.0, 2.0),
        misplacement_mm=st.floats(0.0, 2.0),
        crookedness_mm=st.floats(0.0, 2.0),
        gore_misalignment_mm=st.floats(0.0, 2.0),
        rubbed_markers=SHARE,
        seam_width_mm=st.floats(0.0, 10.0),
        seam_wander_mm=st.floats(0.0, 10.0),
        seam_gaps=SHARE,
        glow=SHARE,
        blotches=st.floats(0.0, 0.5),
        grain=st.floats(0.0, 0.5),
        threads=st.integers(0, 5),
    ),
    seed=st.integers(0, 2**63),
    index=st.integers(0, 2**32 - 1),
)
def test_any_dials_give_an_image_again_and_again(defects: Defects, seed: int, index: int) -> None:
    results = []
    for _ in range(2):
        ideal = open_renderer("painter", SMALL).render(made(SMALL, defects, seed))
        exposures = [ideal] * len(shutter_times(defects, 0.02))
        results.append(sent(Imaging(SMALL, defects, seed), exposures, index))
    assert results[0].shape == (93, 121, 3)
    assert results[0].dtype == np.uint8
    assert (results[0] == results[1]).all()
