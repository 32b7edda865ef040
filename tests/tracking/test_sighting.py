"""Where the sensor is in a picture, and the colours of its markers, from the picture alone."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from chromagrip.errors import UserError
from chromagrip.render import add_noise, load_sensor, open_renderer
from chromagrip.render.membrane import rest_membrane
from chromagrip.tracking import detect_markers, learn_palette, sight
from chromagrip.tracking.sighting import SightSettings

from ..pictures.drawn_dots import covered, levels, spread

SIZE = WIDTH, HEIGHT = 400, 300
Light = tuple[float, float, float]


def grid(pitch: float, reach: float = 125.0) -> np.ndarray:
    """Places on a disturbed grid in a disc around the middle [px], shape (n, 2)."""
    places = spread(*SIZE, pitch, 3)
    return places[np.linalg.norm(places - np.array(SIZE) / 2, axis=1) < reach - pitch / 2]


def dotted(
    places: np.ndarray,
    radii: np.ndarray | float = 6.0,
    ground: Light = (0.6, 0.6, 0.6),
    marker: Light = (0.1, 0.1, 0.1),
    around: Light | None = None,
) -> np.ndarray:
    """Discs on shaded ground within a disc of 135 px; outside it the surround, if there is one."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    shade = 1.0 - 0.4 * np.hypot(x - 150, y - 100) / 300
    cover = covered(SIZE, places, np.broadcast_to(radii, len(places)), 0.8)[..., None]
    linear = shade[..., None] * (np.array(ground) * (1 - cover) + np.array(marker) * cover)
    if around is not None:
        linear[np.hypot(x - WIDTH / 2, y - HEIGHT / 2) > 135] = around
    return levels(linear)


#: Light of the ground, of the markers and around the field.
COLOURS: list[tuple[Light, Light, Light | None]] = [
    ((0.6, 0.6, 0.6), (0.1, 0.1, 0.1), (0.95, 0.95, 0.95)),
    ((0.04, 0.04, 0.04), (0.5, 0.5, 0.5), (0.0, 0.0, 0.0)),
    # A channel without any light between markers.
    ((0.0, 0.0, 0.08), (0.7, 0.8, 0.9), (0.3, 0.05, 0.05)),
    ((1.0, 0.7, 0.5), (1.0, 0.1, 0.4), None),  # a channel at its highest level
    ((0.5, 0.3, 0.1), (0.05, 0.03, 0.01), (0.3, 0.05, 0.05)),
]


@pytest.mark.parametrize(("ground", "marker", "around"), COLOURS)
def test_markers_of_any_colour_on_any_ground_in_any_surround_are_found(
    ground: Light, marker: Light, around: Light | None
) -> None:
    places = grid(24.0)
    image = dotted(places, ground=ground, marker=marker, around=around)
    seen = sight(image)
    assert seen.bright == (sum(marker) > sum(ground))
    assert seen.pitch == pytest.approx(23.0, rel=0.1)
    assert seen.radius == pytest.approx(6.0, rel=0.15)
    x, y = np.rint(places).astype(int).T
    assert seen.field[y, x].all()
    assert not seen.field[:20, :20].any()
    (found,) = detect_markers(image, learn_palette(image, seen))
    away, number = KDTree(places).query(found.position)
    assert sorted(number) == list(range(len(places)))
    assert np.max(away) < 0.6


@settings(max_examples=6)
@given(
    pitch=st.floats(14.0, 60.0),
    share=st.floats(0.17, 0.28),
    scatter=st.floats(0.0, 0.34),
    seed=st.integers(0, 1000),
)
def test_sizes_may_scatter_by_a_factor_of_two(
    pitch: float, share: float, scatter: float, seed: int
) -> None:
    places = grid(pitch, reach=145.0)
    factors = np.exp(np.random.default_rng(seed).uniform(-scatter, scatter, len(places)))
    seen = sight(dotted(places, np.maximum(pitch * share * factors, 2.5)))
    missed = KDTree(seen.position).query(places)[0] > 0.2 * pitch
    assert missed.sum() <= max(1.0, 0.02 * len(places))
    assert len(seen.position) < 1.02 * len(places)
    x, y = np.rint(places[~missed]).astype(int).T
    assert seen.field[y, x].all()


@pytest.mark.parametrize(("radius", "staggered"), [(6.0, False), (9.0, True)])
def test_the_ground_between_dense_dots_is_not_taken_for_dots(
    radius: float, staggered: bool
) -> None:
    pitch = 2.5 * radius
    up = pitch * np.sqrt(0.75) if staggered else pitch
    x, y = np.meshgrid(np.arange(0.8, WIDTH / pitch - 1), np.arange(0.8, HEIGHT / up - 1))
    x += 0.5 * staggered * (np.arange(len(x)) % 2)[:, None]
    places = np.stack([pitch * x.ravel(), up * y.ravel()], axis=-1)
    image = dotted(places, radius)
    (dots,) = detect_markers(image, learn_palette(image, sight(image)))
    assert KDTree(places).query(dots.position)[0].max() < 0.4 * radius
    assert (KDTree(dots.position).query(places)[0] < 0.2 * radius).mean() > 0.95


def test_lamps_specks_and_a_label_beside_the_markers_are_none() -> None:
    """Lamps as round as markers, but larger, at the rim; specks; writing."""
    places = grid(24.0, reach=110.0)
    image = dotted(places, ground=(0.03, 0.03, 0.03), marker=(0.4, 0.4, 0.4))
    for angle in np.arange(0.0, 6.2, 1.05):
        at = (round(200 + 135 * np.cos(angle)), round(150 + 135 * np.sin(angle)))
        cv2.circle(image, at, 15, (255, 255, 255), -1, cv2.LINE_AA)
    cv2.putText(image, "No. 17", (5, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (255, 255, 255), 2)
    for x, y in np.random.default_rng(2).integers(20, 280, (15, 2)):
        image[y, x] = 255
    seen = sight(image)
    number = KDTree(places).query(seen.position)[1]
    assert sorted(number) == list(range(len(places)))
    assert not seen.field[:20, :70].any()


def flat(level: int) -> np.ndarray:
    return np.full((HEIGHT, WIDTH, 3), level, np.uint8)


def grainy(blur: float) -> np.ndarray:
    noise = np.random.default_rng(1).integers(0, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    return np.asarray(cv2.GaussianBlur(noise, (0, 0), blur)) if blur else noise


def anywhere() -> np.ndarray:
    """Spots of any size at any place, as leaves or lights are."""
    rng = np.random.default_rng(4)
    image = flat(200)
    for _ in range(40):
        at = (int(rng.integers(0, WIDTH)), int(rng.integers(0, HEIGHT)))
        cv2.circle(image, at, int(np.exp(rng.uniform(1.0, 4.0))), int(rng.integers(0, 180)), -1)
    return image


NOTHING = {
    "grey": flat(128),
    "noise": grainy(0.0),
    "noise of 8 px": grainy(8.0),
    "slope": np.linspace(flat(0)[:, 0], flat(255)[:, 0], WIDTH, axis=1).astype(np.uint8),
    "few": dotted(np.array([[100.0, 100.0], [140.0, 100.0], [100.0, 140.0]])),
    "anywhere": anywhere(),
    # Looked at smaller, it is two pixels wide.
    "strip": np.random.default_rng(5).integers(0, 256, (12_000, 20, 3), np.uint8),
}


@pytest.mark.parametrize("image", NOTHING.values(), ids=NOTHING.keys())
def test_what_does_not_repeat_like_markers_is_refused(image: np.ndarray) -> None:
    with pytest.raises(UserError, match="no regular marker pattern found in the picture"):
        sight(image)


def test_a_picture_without_room_for_markers_is_refused() -> None:
    for shape in [(1, 1, 3), (1, 500, 3), (15, 400, 3)]:
        with pytest.raises(UserError, match="wanted: 16 or more a side"):
            sight(np.zeros(shape, np.uint8))


def test_markers_are_looked_for_where_and_in_what_number_that_is_asked() -> None:
    places = grid(24.0)
    image, half = dotted(places), np.zeros((HEIGHT, WIDTH), dtype=bool)
    half[:, : WIDTH // 2] = True
    seen = sight(image, half)
    assert not seen.field[:, WIDTH // 2 :].any()
    assert seen.position[:, 0].max() < WIDTH / 2 + 1
    with pytest.raises(UserError, match="no regular marker pattern"):
        sight(image, settings=SightSettings(fewest=len(places) + 1))


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ((0.3, 0.8, 0.4), (0.8, 0.3, 0.9)),
        ((0.15, 0.75, 0.8), (0.9, 0.3, 0.25)),  # black together: each shows alone at the edges
    ],
)
def test_dyes_of_two_layers_are_learned(first: Light, second: Light) -> None:
    """Layers that lie aside by a third of a radius to all sides; dyes true to a tenth in light."""
    places = grid(26.0)
    radii, turn = np.full(len(places), 7.0), np.random.default_rng(5).uniform(0, 6.28, len(places))
    aside = 2.5 * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    linear = np.full((HEIGHT, WIDTH, 3), 0.75) * np.linspace(1.0, 0.6, WIDTH)[:, None]
    for at, dye in ((places + aside, first), (places - aside, second)):
        linear *= 1.0 - covered(SIZE, at, radii, 0.8)[..., None] * (1.0 - np.array(dye))
    image = levels(linear)
    palette = learn_palette(image, sight(image))
    assert len(palette.names) == 2
    dyes = np.array([first, second])
    if abs(palette.transmittance[0] - first).sum() > abs(palette.transmittance[1] - first).sum():
        dyes = dyes[::-1]
    np.testing.assert_allclose(palette.transmittance, dyes, atol=0.1)
    assert [len(layer.area) for layer in detect_markers(image, palette)] == [len(places)] * 2


def test_light_of_two_colours_does_not_make_two_dyes() -> None:
    """Dark dots under light that is red on one side and blue on the other, and stray light."""
    places, across = grid(24.0), np.linspace(0.0, 1.0, WIDTH)[None, :, None]
    light = (1.0 - across) * np.array([0.7, 0.4, 0.1]) + across * np.array([0.1, 0.4, 0.7])
    cover = covered(SIZE, places, np.full(len(places), 6.0), 0.8)[..., None]
    image = levels(light * np.array([1.0, 0.5, 0.2]) * (1.0 - 0.9 * cover) + 0.01)
    assert learn_palette(image, sight(image)).names == ("dark",)


@pytest.mark.parametrize(
    ("name", "scale"),
    [("thesis", 1.0), pytest.param("dome-2022", 1.7, marks=pytest.mark.stages), ("flat-2019", 0.6)],
)
def test_our_designs_are_found_without_knowing_them_at_any_size(name: str, scale: float) -> None:
    sensor = load_sensor(name)
    image = open_renderer("painter", sensor).render(rest_membrane(sensor))
    add_noise(image, 2.0, 3, 0)
    way = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_CUBIC
    image = np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=way))
    palette = learn_palette(image, sight(image))
    assert palette.names == ("magenta", "yellow")
    counts = [len(layer.area) for layer in detect_markers(image, palette)]
    # Squares of the pad at 0.6: 85 to 100 of 100, as the noise has it, with this field and with
    # independent normal offsets alike.
    assert min(counts) > 0.9 * len(sensor.places)
    assert max(counts) <= len(sensor.places)
    alone = detect_markers(image, replace(palette, seen=None)) if scale == 1.0 else None
    assert alone is None or abs(len(alone[0].area) - counts[0]) < 5
