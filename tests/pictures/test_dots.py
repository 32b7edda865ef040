"""One layer of dots: with the coloured shade of several lamps beside them, or of several sizes."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from chromagrip.pictures.track import track_source
from chromagrip.render import Frame
from chromagrip.tracking import (
    detect_markers,
    learn_palette,
    load_tracker,
    sight,
)

from .drawn_dots import Array, covered, dotted, levels, save, spread

SIZE = (320, 240)


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


@pytest.mark.parametrize("seed", [0, 7])
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


#: Radii, and the share of the dots that has each.
KINDS = [
    ((4.0, 8.0), (0.5, 0.5)),
    ((3.8, 9.5), (0.1, 0.9)),
    ((3.2, 5.4, 9.0), (0.4, 0.3, 0.3)),
]


def kinds(number: int, bright: bool = False, shift: float = 0.0) -> tuple[np.ndarray, Array, Array]:
    """Picture of dots of several kinds, their places and radii."""
    sizes, shares = KINDS[number]
    pitch = 2.7 * max(sizes)
    places = spread(*SIZE, pitch, number)
    places = places[(abs(places - np.array(SIZE) / 2) < np.array(SIZE) / 2 - 15.0).all(axis=1)]
    rng = np.random.default_rng(number)
    radii = rng.choice(sizes, len(places), p=shares) * rng.uniform(0.97, 1.03, len(places))
    places = places + shift
    if bright:
        return dotted(SIZE, places, radii, (9.0, 10.0, 8.0), (0.05, 0.06, 0.05)), places, radii
    return dotted(SIZE, places, radii), places, radii


@pytest.mark.parametrize(("number", "bright"), [(0, False), (1, False), (2, True)])
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


def followed(image: np.ndarray, folder: Path) -> tuple[int, dict[str, Array]]:
    """Number of markers that are followed, and places of the others by reason."""
    picture = str(save(folder / "dots.png", image))
    summary = track_source(picture, picture, tracker="fit").summary
    lost: dict[str, list[tuple[float, float]]] = {}
    for marker in summary["not_followed"]:
        lost.setdefault(marker["reason"], []).append((marker["x_px"], marker["y_px"]))
    return summary["layers"]["dark"]["markers"], {k: np.array(v) for k, v in lost.items()}


def test_a_dot_that_is_not_followed_has_a_reason(tmp_path: Path) -> None:
    """Torn dots are unlike the others."""
    places = spread(*SIZE, 32.0)
    torn = places[[19, 33]]
    image = dotted(SIZE, places, np.full(len(places), 9.0))
    hole = covered(SIZE, torn + np.array([4.0, 0.0]), np.full(2, 6.0))[..., None]
    count, lost = followed(np.rint(image * (1.0 - hole) + hole * 190.0).astype(np.uint8), tmp_path)
    ((reason, at),) = lost.items()
    assert "unlike the others" in reason
    assert count + len(at) <= len(places)
    assert KDTree(torn).query(at)[0].max() < 5.0


@pytest.mark.parametrize("corner", [(3.0, 2.0), (15.0, 5.0)])
def test_dots_that_the_edge_of_the_picture_cuts_are_named(
    corner: tuple[float, float], tmp_path: Path
) -> None:
    """Each dot is followed, or cut by the edge at rest and named."""
    width, height = SIZE
    rows, cols = np.arange(corner[1], height, 36.0), np.arange(corner[0], width, 36.0)
    places, radius = np.array([(x, y) for y in rows for x in cols]), 6.0
    count, lost = followed(dotted(SIZE, places, np.full(len(places), radius)), tmp_path)
    ((reason, at),) = lost.items()
    assert "cut by the edge" in reason
    inside = np.minimum(places, np.array(SIZE) - 1.0 - places).min(axis=1)
    away = KDTree(at).query(places)[0]
    assert count + len(at) >= (inside > 0.0).sum()
    assert (away[(inside > 0.0) & (inside < 0.5 * radius)] < 0.7 * radius).all()
    assert (away[inside > radius + 4.0] > radius).all()
