"""One factor from a source's pictures to those that are read: to a design's camera, or a whole one.

Markers of large pictures are looked for in few pixels, and measured in as many as they need.
"""

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial import KDTree

from chromagrip.errors import UserError
from chromagrip.pictures.marker_list import list_markers
from chromagrip.pictures.scale import reduction, scale_to
from chromagrip.render import load_sensor, open_renderer, rest_membrane

from .drawn_dots import Array, covered, levels, save, spread

SENSOR = load_sensor("thesis")
SIZE = (1900, 1400)


@cache
def large(pitch: float, radius: float) -> tuple[np.ndarray, Array, Array]:
    """Picture of grey dots on shaded ground, their places and radii."""
    places = spread(*SIZE, pitch)
    radii = radius * np.random.default_rng(1).uniform(0.95, 1.05, len(places))
    light = (0.6 - 0.2 * np.arange(SIZE[0]) / SIZE[0]) * (1.0 - 0.9 * covered(SIZE, places, radii))
    return levels(light)[..., None].repeat(3, axis=2), places, radii


def blank(width: int, height: int) -> np.ndarray:
    return np.zeros((height, width, 3), np.uint8)


@pytest.mark.parametrize("image", [blank(640, 480), blank(10, 10)])
def test_pictures_of_the_right_size_stay_as_they_are(image: np.ndarray) -> None:
    scale = scale_to(SENSOR, image) if image.shape[1] == 640 else reduction(image)
    assert scale.factor == 1.0
    assert np.shares_memory(scale(image), image)


@pytest.mark.parametrize("by", [0.92, 2.48])
def test_a_whole_picture_is_scaled_to_the_design(by: float) -> None:
    """The middles of dots return to their places, which are scaled about the outer edge."""
    design = load_sensor("dome-2020")
    rest = open_renderer("painter", design).render(rest_membrane(design))
    how = cv2.INTER_AREA if by < 1.0 else cv2.INTER_CUBIC
    image = np.asarray(cv2.resize(rest, None, fx=by, fy=by, interpolation=how), np.uint8)
    scale = scale_to(design, image)
    assert scale.factor == pytest.approx(1.0 / by, rel=2e-3)
    back = scale(image)
    assert back.shape == rest.shape
    assert np.sqrt(np.mean((back.astype(float) - rest) ** 2)) < 4.0
    places = np.array([[0.0, 0.0], [100.0, 50.0]])
    np.testing.assert_allclose(scale.original(places), by * (places + 0.5) - 0.5, atol=0.2)


@pytest.mark.parametrize(
    ("width", "height", "words"),
    [
        (480, 640, "crop=480:360:LEFT:TOP"),
        (800, 480, "crop=640:480:LEFT:TOP"),
        (512, 384, "allowed: 0.9 to 2.5 times as large, not 0.80: take larger ones"),
        (1664, 1248, "allowed: 0.9 to 2.5 times as large, not 2.60: reduce them to 640×480"),
    ],
)
def test_what_one_factor_does_not_meet_is_refused_with_the_mend(
    width: int, height: int, words: str
) -> None:
    with pytest.raises(UserError) as refused:
        scale_to(SENSOR, blank(width, height))
    said = str(refused.value)
    assert said.startswith(f"the pictures are {width}×{height} pixels, the sensor's camera gives")
    assert words in said
    assert "\n" not in said


@pytest.mark.parametrize(
    ("pitch", "radius", "error"),
    [(200.0, 44.0, 0.1), pytest.param(44.0, 8.5, 0.025, marks=pytest.mark.data)],
)
def test_places_and_sizes_of_large_and_of_many_small_dots_are_those_drawn(
    tmp_path: Path, pitch: float, radius: float, error: float
) -> None:
    image, places, radii = large(pitch, radius)
    found = list_markers(save(tmp_path / "large.png", image))
    (dots,) = found.layers
    away, number = KDTree(places).query(dots.position)
    assert sorted(number) == list(range(len(places)))
    assert np.sqrt(np.mean(away**2)) < error
    assert np.sqrt(dots.area / np.pi) == pytest.approx(radii[number], abs=4.0 * error)
    assert np.prod(reduction(image).size) < 2_500_000
    assert found.image.shape == image.shape
    assert found.palette.seen is not None
    assert found.palette.seen.field.shape == image.shape[:2]


@pytest.mark.data
def test_two_layers_of_small_dots_are_told_apart_in_a_large_picture(tmp_path: Path) -> None:
    """The inner layer lies beside the outer one, by an offset that both layers must show."""
    places, offset = spread(*SIZE, 42.0), np.array([2.0, -1.0])
    radii = np.full(len(places), 7.5)
    light = np.full((SIZE[1], SIZE[0], 3), 0.85)
    for at, dye in ((places, (0.63, 0.14, 0.228)), (places + offset, (0.99, 0.771, 0.127))):
        light *= 1.0 - covered(SIZE, at, radii)[..., None] * (1.0 - np.array(dye))
    found = list_markers(save(tmp_path / "pairs.png", levels(light)))
    assert found.palette.names == ("magenta", "yellow")
    for dots, at in zip(found.layers, (places, places + offset), strict=True):
        away, number = KDTree(at).query(dots.position)
        assert sorted(number) == list(range(len(at)))
        assert np.sqrt(np.mean(away**2)) < 0.2


def test_the_mean_light_of_the_pixels_is_kept_where_a_picture_is_reduced() -> None:
    """Half black and half white pixels have half of the light, which is level 188."""
    scale = reduction(large(200.0, 44.0)[0])
    assert scale.times > 1
    chess = 255 * (np.indices(SIZE[::-1]).sum(axis=0) % 2).astype(np.uint8)
    small = scale(np.repeat(chess[..., None], 3, axis=2))
    assert abs(np.median(small) - 188) <= (1 if scale.times % 2 == 0 else 4)
