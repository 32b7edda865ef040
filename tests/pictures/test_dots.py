"""One layer of dots: with the coloured shade of several lamps beside them, or of several sizes."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial import KDTree

from chromagrip.errors import UserError
from chromagrip.pictures.track import track_source
from chromagrip.render import Frame
from chromagrip.tracking import (
    detect_markers,
    learn_palette,
    load_palette,
    load_tracker,
    read_rest,
    sight,
)

from .drawn_dots import Array, covered, dotted, levels, spread

SIZE, LARGE = (320, 240), (400, 300)


def shaded(places: Array, radius: float, seed: int) -> np.ndarray:
    """Black dots that keep the light of three coloured lamps off the ground, each on its side."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(*(np.arange(side) / side - 0.5 for side in SIZE))
    linear = np.empty((*x.shape, 3))
    turn, depth, aside = rng.uniform([0.0, 0.6, 0.4], [2.0 * np.pi, 0.95, 0.9])
    for lamp in range(3):
        angle = turn + lamp * 2.0 * np.pi / 3.0
        way = np.array([np.cos(angle), np.sin(angle)])
        light = 0.2 + 0.2 * (x * way[0] + y * way[1])
        shade = covered(SIZE, places - aside * radius * way, np.full(len(places), radius), 2.0)
        linear[..., lamp] = light * (1.0 - depth * shade)
    dye = np.array([0.15, 0.2, 0.12]) + rng.uniform(0.0, 0.15, (*x.shape, 1))
    cover = covered(SIZE, places, np.full(len(places), radius))[..., None]
    return levels(linear * (1.0 - cover * (1.0 - dye)), seed=seed)


@pytest.mark.parametrize("seed", [0, 3, 7])
def test_black_dots_with_coloured_shade_beside_them_are_one_layer(seed: int) -> None:
    pitch = 28.0 + 2.0 * seed
    places = spread(*SIZE, pitch, seed)
    image = shaded(places, 0.24 * pitch, seed)
    palette = learn_palette(image, sight(image))
    assert palette.names == ("dark",)
    (dots,) = detect_markers(image, palette)
    away, number = KDTree(places).query(dots.position)
    assert sorted(number) == list(range(len(places)))
    assert away.max() < 0.15 * 0.24 * pitch


def test_a_layer_that_is_not_there_is_refused_with_the_palette_of_one_layer() -> None:
    places = spread(*SIZE, 30.0)
    image = dotted(SIZE, places, np.full(len(places), 7.0), dye=(0.6, 0.14, 0.23))
    with pytest.raises(UserError, match=r"0 yellow markers.*--palette dark-dots"):
        read_rest([Frame(image=image, time=0.0)], load_palette())


#: Radii, and the share of the dots that has each.
KINDS = [
    ((4.0, 8.0), (0.5, 0.5)),
    ((3.8, 9.5), (0.9, 0.1)),
    ((3.8, 9.5), (0.1, 0.9)),
    ((3.2, 5.4, 9.0), (0.4, 0.3, 0.3)),
]


def kinds(number: int, bright: bool = False, shift: float = 0.0) -> tuple[np.ndarray, Array, Array]:
    """Picture of dots of several kinds, their places and radii."""
    sizes, shares = KINDS[number]
    pitch = 2.7 * max(sizes)
    places = spread(*LARGE, pitch, number)
    places = places[(abs(places - np.array(LARGE) / 2) < np.array(LARGE) / 2 - 15.0).all(axis=1)]
    rng = np.random.default_rng(number)
    radii = rng.choice(sizes, len(places), p=shares) * rng.uniform(0.97, 1.03, len(places))
    places = places + shift
    if bright:
        return dotted(LARGE, places, radii, (9.0, 10.0, 8.0), (0.05, 0.06, 0.05)), places, radii
    return dotted(LARGE, places, radii), places, radii


@pytest.mark.parametrize(("number", "bright"), [(0, False), (2, False), (3, True)])
def test_dots_of_two_or_three_sizes_are_all_found_and_followed(number: int, bright: bool) -> None:
    image, places, radii = kinds(number, bright)
    palette = learn_palette(image, sight(image))
    (dots,) = detect_markers(image, palette)
    away, nearest = KDTree(places).query(dots.position)
    assert sorted(nearest) == list(range(len(places)))
    assert away.max() < 0.15
    assert np.sqrt(dots.area / np.pi) == pytest.approx(radii[nearest], abs=0.25)
    tracker = load_tracker("fit")(palette, 1.5)
    rest = tracker.reset([Frame(image=image, time=0.0)])
    nearest = KDTree(places).query(rest.position[0])[1]
    tracks = tracker.update(Frame(image=kinds(number, bright, shift=1.7)[0], time=0.03))
    assert tracks.visible.sum() > 0.98 * len(places)
    assert np.nanmax(abs(tracks.position[0] - places[nearest] - 1.7)) < 0.3


def test_a_dot_that_is_not_followed_has_a_reason(tmp_path: Path) -> None:
    """Torn dots are unlike the others."""
    places = spread(*LARGE, 32.0)
    radii = np.full(len(places), 9.0)
    torn = places[[30, 41]]
    image = dotted(LARGE, places, radii)
    hole = covered(LARGE, torn + np.array([4.0, 0.0]), np.full(2, 6.0))[..., None]
    image = np.rint(image * (1.0 - hole) + hole * 190.0).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "rest.png"), image[..., ::-1])
    cv2.imwrite(str(tmp_path / "next.png"), image[..., ::-1])
    summary = track_source(
        str(tmp_path / "rest.png"), str(tmp_path / "next.png"), tracker="fit"
    ).summary
    lost = summary["not_followed"]
    followed = summary["layers"]["dark"]["markers"]
    assert len(lost) > 0
    assert len(lost) + followed <= len(places)
    for marker in lost:
        place = np.array([marker["x_px"], marker["y_px"]])
        assert np.linalg.norm(torn - place, axis=1).min() < 5.0
        assert "unlike the others" in marker["reason"]


@pytest.mark.parametrize("corner", [(3.0, 2.0), (15.0, 5.0)])
def test_dots_that_the_edge_of_the_picture_cuts_are_named(
    corner: tuple[float, float], tmp_path: Path
) -> None:
    """Each dot is followed, or cut by the edge at rest and named."""
    width, height = LARGE
    rows, cols = np.arange(corner[1], height, 36.0), np.arange(corner[0], width, 36.0)
    places = np.array([(x, y) for y in rows for x in cols])
    radius = 6.0
    for name in ("rest.png", "next.png"):
        image = dotted(LARGE, places, np.full(len(places), radius))
        cv2.imwrite(str(tmp_path / name), image[..., ::-1])
    rest, source = str(tmp_path / "rest.png"), str(tmp_path / "next.png")
    summary = track_source(rest, source, tracker="fit").summary
    inside = np.minimum(places, np.array(LARGE) - 1.0 - places).min(axis=1)
    lost = summary["not_followed"]
    assert all("cut by the edge" in marker["reason"] for marker in lost)
    at = np.array([(marker["x_px"], marker["y_px"]) for marker in lost])
    away = KDTree(at).query(places)[0]
    assert summary["layers"]["dark"]["markers"] + len(lost) >= (inside > 0.0).sum()
    assert (away[(inside > 0.0) & (inside < 0.5 * radius)] < 0.7 * radius).all()
    assert (away[inside > radius + 4.0] > radius).all()
