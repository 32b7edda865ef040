import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.pictures.any_size import Fitter, _without_border, fitting
from chromagrip.pictures.marker_list import list_markers
from chromagrip.render import add_noise, load_sensor, open_renderer, rest_membrane

SENSOR = load_sensor("thesis")
Image = np.ndarray[Any, np.dtype[np.uint8]]


def rested(name: str, noise: float = 2.0) -> Image:
    sensor = load_sensor(name)
    image = open_renderer("painter", sensor).render(rest_membrane(sensor))
    add_noise(image, noise, 3, 0)
    return image


@pytest.fixture(scope="module")
def rest() -> Image:
    return rested("thesis")


def scaled(image: Image, by: float) -> Image:
    how = cv2.INTER_AREA if by < 1.0 else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(image, None, fx=by, fy=by, interpolation=how), dtype=np.uint8)


def around(image: Image, left: int, top: int, right: int, bottom: int, level: int) -> Image:
    sides = (top, bottom, left, right)
    bordered = cv2.copyMakeBorder(image, *sides, cv2.BORDER_CONSTANT, value=[level] * 3)
    return np.asarray(bordered, dtype=np.uint8)


def test_a_picture_of_the_sensors_size_stays_as_it_is() -> None:
    blank = np.zeros((480, 640, 3), np.uint8)
    fit = fitting(blank, SENSOR)
    assert fit.taken == [0.0, 0.0, 640.0, 480.0]
    assert np.shares_memory(fit(blank), blank)


@pytest.mark.parametrize(
    ("left", "top", "right", "bottom"),
    [
        pytest.param(80, 0, 560, 480, marks=pytest.mark.slow),
        pytest.param(20, 3, 553, 478, marks=pytest.mark.slow),
        pytest.param(80, 0, 464, 480, marks=pytest.mark.slow),
        (120, 40, 520, 440),
    ],
)
def test_a_crop_is_put_back_to_its_pixels(
    rest: Image, left: int, top: int, right: int, bottom: int
) -> None:
    crop = rest[top:bottom, left:right]
    fit = fitting(crop, SENSOR)
    assert (fit.scale, fit.taken) == (1.0, [-left, -top, 640.0, 480.0])
    wanted = np.zeros_like(rest)
    wanted[top:bottom, left:right] = crop
    np.testing.assert_array_equal(fit(crop), wanted)


@pytest.mark.parametrize("level", [0, pytest.param(255, marks=pytest.mark.slow)])
def test_a_border_is_taken_off(rest: Image, level: int) -> None:
    padded = around(rest, 107, 20, 106, 0, level)
    fit = fitting(padded, SENSOR)
    np.testing.assert_array_equal(fit(padded), rest)
    # That of a crop lies in the sensor's picture, where it shows nothing.
    tight = around(rest[:, 90:540], 30, 30, 30, 30, level)
    fit = fitting(tight, SENSOR)
    wanted = rest.copy()
    wanted[:, :90] = wanted[:, 540:] = 0
    np.testing.assert_array_equal(fit(tight), wanted)
    np.testing.assert_array_equal(fit.part(tight), rest[:, 90:540])


@pytest.mark.parametrize("name", ["thesis", "dome-2020"])
@pytest.mark.parametrize("noise", [0.0, 1.0, 2.0])
def test_a_border_is_told_from_dark_housing(name: str, noise: float) -> None:
    """Of crops of any size, also where the housing has too little noise to look like a picture."""
    rng, image = np.random.default_rng(1), rested(name, noise)
    height, width = image.shape[:2]
    for level in (0, 128, 255) * 4:
        left, right, above, below = rng.integers(0, width // 8, 4)
        crop = image[above : height - below, left : width - right]
        high, wide = crop.shape[:2]
        assert _without_border(crop) == (0, 0, wide, high)
        sides = 10 * rng.integers(0, 8, 4) * (rng.random(4) < 0.7)  # some have none
        padded = around(crop, *sides.tolist(), level)
        inner = np.array([sides[0], sides[1], sides[0] + wide, sides[1] + high])
        assert _without_border(padded) == tuple(inner)
        # Blocks of 16 pixels carry the edge of a border into it.
        coded = cv2.imdecode(cv2.imencode(".jpg", padded, [cv2.IMWRITE_JPEG_QUALITY, 85])[1], 1)
        assert (abs(_without_border(coded) - inner) <= 16).all()


@pytest.mark.slow
def test_a_scaled_crop_is_scaled_back(rest: Image) -> None:
    crop = around(scaled(rest, 1.7)[:, 136:952], 10, 30, 0, 40, 255)
    fit = fitting(crop, SENSOR)
    assert fit.scale == pytest.approx(1.0 / 1.7, rel=2e-3)
    assert fit.taken == pytest.approx([-126, 30, 1088, 816], abs=1.0)
    apart = fit(crop)[20:460, 100:540].astype(float) - rest[20:460, 100:540]
    assert np.sqrt((apart**2).mean()) < 5.0
    assert fit.part(crop).shape == (816, 816, 3)


def test_a_turned_picture_is_placed_by_its_axis(rest: Image) -> None:
    turned = np.rot90(rest)
    fit = fitting(turned, SENSOR)
    assert fit.taken == pytest.approx([-80, 80, 640, 480], abs=1.0)


def test_a_small_part_of_a_large_picture_is_found(rest: Image) -> None:
    large = np.full((1200, 2000, 3), 90, np.uint8)
    large[300:780, 1200:1840] = rest
    add_noise(large, 2.0, 4, 0)
    fit = fitting(large, SENSOR)
    assert fit.taken == [1200, 300, 640, 480]
    assert fit.part(large).shape == (480, 640, 3)


def test_a_whole_picture_stays_whole(rest: Image) -> None:
    """A mount's shift, and markers that are not found, change nothing."""
    shifted = np.roll(scaled(rest, 1.3), (9, -12), axis=(0, 1))
    for image in (shifted, np.zeros((624, 832, 3), np.uint8)):
        fit = fitting(image, SENSOR)
        assert fit.whole
        assert fit.taken == pytest.approx([0, 0, 832, 624])
        assert fit(image).shape == (480, 640, 3)


def test_a_part_of_the_whole_shape_is_no_whole_picture(rest: Image) -> None:
    part = scaled(rest, 1.5)[60:660, 80:880]  # 800×600
    fit = fitting(part, SENSOR)
    assert not fit.whole
    assert fit.taken == pytest.approx([-80, -60, 960, 720], abs=1.0)


def test_the_first_picture_tells_the_place_of_all(rest: Image) -> None:
    fitter = Fitter(SENSOR)
    first = fitter(rest[:, 80:560])
    np.testing.assert_array_equal(fitter(rest[:, 80:560] // 2), first // 2)
    blank = np.zeros((10, 10, 3), np.uint8)
    assert np.shares_memory(Fitter(None)(blank), blank)


def refusal(image: Image) -> str:
    with pytest.raises(UserError) as refused:
        fitting(image, SENSOR)
    assert "\n" not in str(refused.value)
    return str(refused.value)


@pytest.mark.parametrize(
    ("by", "said"), [(0.8, "0.80"), pytest.param(2.6, "2.60", marks=pytest.mark.slow)]
)
def test_too_small_and_too_large_a_sensor_is_refused(rest: Image, by: float, said: str) -> None:
    words = f"show the sensor {said} times as large as its camera does in 640×480; allowed: 0.9 to"
    assert words in refusal(around(scaled(rest, by), 70, 60, 80, 60, 0))


@pytest.mark.parametrize("shape", [(480, 500), (288, 384), (1440, 1920)])
def test_pictures_without_markers_are_refused(shape: tuple[int, int]) -> None:
    said = refusal(np.zeros((*shape, 3), np.uint8))
    assert f"{shape[1]}×{shape[0]} pixels, the sensor's camera gives 640×480" in said
    assert "the sensor is not found in them: no regular marker pattern found in the picture" in said


@pytest.mark.slow
def test_half_a_dome_and_another_sensor_are_refused(rest: Image) -> None:
    words = "% of the 388 markers in the picture lie at places of the calibrated sensor"
    assert words in refusal(rest[:, 80:320])
    assert "Is it another sensor" in refusal(rested("flat-2019"))
    assert "Is it another sensor" in refusal(rested("dome-2020"))


@pytest.mark.slow
def test_a_large_picture_is_read_at_the_scale_of_its_markers(tmp_path: Path) -> None:
    """Places, sizes and distances are those of the picture as it is."""
    design = load_sensor("flat-2019")
    image = open_renderer("painter", design).render(rest_membrane(design))
    path = tmp_path / "small.png"
    cv2.imwrite(str(path), image[..., ::-1])
    small = list_markers(path)
    times = math.ceil(math.sqrt(4e6 / (image.shape[0] * image.shape[1])))
    large = cv2.resize(image, None, fx=times, fy=times, interpolation=cv2.INTER_CUBIC)
    path = tmp_path / "large.png"
    cv2.imwrite(str(path), large[..., ::-1])
    found = list_markers(path)
    assert fitting(large, None).scale < 1.0
    assert fitting(image, None).scale == 1.0
    assert found.image.shape == large.shape
    assert len(found.rows) == len(small.rows)
    for one, other in zip(small.layers, found.layers, strict=True):
        expected = times * (one.position + 0.5) - 0.5
        apart = np.linalg.norm(expected[:, None] - other.position, axis=-1).min(axis=1)
        assert apart.max() < 0.2 * times
        assert abs(np.median(other.area) / np.median(one.area) / times**2 - 1.0) < 0.1
