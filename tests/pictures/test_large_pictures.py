"""Pictures of many pixels: markers are looked for in few, and measured in as many as they need."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial import KDTree

from chromagrip.pictures.any_size import fitting, reduction
from chromagrip.pictures.marker_list import list_markers

from .drawn_dots import covered, dotted, levels, spread

SIZE = (1900, 1400)


@pytest.mark.parametrize(("pitch", "radius", "error"), [(200.0, 44.0, 0.1), (44.0, 8.5, 0.025)])
def test_places_and_sizes_of_large_and_of_many_small_dots_are_those_drawn(
    tmp_path: Path, pitch: float, radius: float, error: float
) -> None:
    places = spread(*SIZE, pitch)
    radii = radius * np.random.default_rng(1).uniform(0.95, 1.05, len(places))
    image = dotted(SIZE, places, radii)
    cv2.imwrite(str(tmp_path / "large.png"), image[..., ::-1])
    found = list_markers(tmp_path / "large.png")
    (dots,) = found.layers
    away, number = KDTree(places).query(dots.position)
    assert sorted(number) == list(range(len(places)))
    assert np.sqrt(np.mean(away**2)) < error
    assert np.sqrt(dots.area / np.pi) == pytest.approx(radii[number], abs=4.0 * error)
    for fit in (fitting(image, None), reduction(image, enough=1_000_000, least_radius=2.5)):
        assert np.prod(fit.size) < 2_500_000
        assert fit.seen is not None
        middles = fit.original(fit.seen.position)
        assert KDTree(places).query(middles)[0].max() < 0.25 * radius
        assert fit.fine()(image).shape[1::-1] == fit.fine().size


def test_two_layers_of_small_dots_are_told_apart_in_a_large_picture(tmp_path: Path) -> None:
    """The inner layer lies beside the outer one, by an offset that both layers must show."""
    places, offset = spread(*SIZE, 42.0), np.array([2.0, -1.0])
    radii = np.full(len(places), 7.5)
    light = np.full((SIZE[1], SIZE[0], 3), 0.85)
    for at, dye in ((places, (0.63, 0.14, 0.228)), (places + offset, (0.99, 0.771, 0.127))):
        light *= 1.0 - covered(SIZE, at, radii)[..., None] * (1.0 - np.array(dye))
    cv2.imwrite(str(tmp_path / "pairs.png"), levels(light)[..., ::-1])
    found = list_markers(tmp_path / "pairs.png")
    assert found.palette.names == ("magenta", "yellow")
    for dots, at in zip(found.layers, (places, places + offset), strict=True):
        away, number = KDTree(at).query(dots.position)
        assert sorted(number) == list(range(len(at)))
        assert np.sqrt(np.mean(away**2)) < 0.2


def test_the_mean_light_of_the_pixels_is_kept_where_a_picture_is_reduced() -> None:
    """Half black and half white pixels have half of the light, which is level 188."""
    places = spread(*SIZE, 200.0)
    fit = fitting(dotted(SIZE, places, np.full(len(places), 44.0)), None)
    assert fit.reduced > 1
    chess = 255 * (np.indices(SIZE[::-1]).sum(axis=0) % 2).astype(np.uint8)
    small = fit(np.repeat(chess[..., None], 3, axis=2))
    assert abs(np.median(small) - 188) <= (1 if fit.reduced % 2 == 0 else 4)
