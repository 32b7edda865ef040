from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial import KDTree

from chromagrip.errors import UserError
from chromagrip.render import (
    Defects,
    Flaws,
    Frame,
    Membrane,
    MembraneMap,
    SensorDesign,
    add_noise,
    load_sensor,
    open_renderer,
)
from chromagrip.render.membrane import rest_membrane
from chromagrip.render.outlines import areas, centroids, outlines
from chromagrip.tracking import Markers, Palette, detect_markers, load_palette, read_rest

from ..pictures.drawn_dots import covered, levels, spread

NOISE = 2.0
DARK, PINS = load_palette("dark-dots"), load_palette("bright-pins")


@cache
def sensor(name: str) -> SensorDesign:
    return load_sensor(name)


@cache
def rest(name: str) -> Membrane:
    return rest_membrane(sensor(name))


def shoot(name: str, membrane: Membrane, seed: int = 0) -> np.ndarray:
    image = open_renderer("painter", sensor(name)).render(membrane)
    add_noise(image, NOISE, 17, seed)
    return image


def matched(found: Markers, truth: np.ndarray) -> np.ndarray:
    """Number of the true marker that each one is, all of them and each once."""
    number = np.asarray(KDTree(truth).query(found.position)[1])
    assert sorted(number) == list(range(len(truth)))
    return number


@pytest.mark.parametrize(
    ("name", "rms", "known"),
    [
        ("thesis", 0.02, False),
        ("flat-2019", 0.06, False),
        ("dome-2020-printed", 0.2, True),
    ],
)
def test_every_sensors_markers_are_found_where_and_as_large_as_they_are(
    name: str, rms: float, known: bool
) -> None:
    """Also those on the tinted seams of the dome of 2020, if not as well."""
    palette = Palette.of_sensor(sensor(name)) if known else load_palette()
    square = name == "flat-2019"
    shapes = outlines(rest(name), sensor(name).view)
    truth, true_area = centroids(shapes, square), areas(shapes, square)
    for k, found in enumerate(detect_markers(shoot(name, rest(name)), palette)):
        number = matched(found, truth[k])
        error = found.position - truth[k, number]
        assert np.sqrt((error**2).mean()) < rms
        assert abs(np.median(error, axis=0)).max() < 0.01
        assert np.median(found.area / true_area[k, number]) == pytest.approx(1.0, abs=0.05)


def scattered(pitch: float) -> np.ndarray:
    return spread(320, 240, pitch, 4)


def draw(
    places: np.ndarray,
    radius: float = 6.0,
    transmittance: float = 0.15,
    light: float = 0.7,
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0),
    housing: float | None = None,
    shade: float = 0.0,
) -> np.ndarray:
    """Round markers of one dye on shaded skin, in a striped housing beyond 110 px or in none."""
    y, x = np.mgrid[:240, :320]
    cover = covered((320, 240), places, np.full(len(places), radius), 0.9)
    skin = light * (1.0 - shade * np.hypot(x - 100, y - 80) / 270)
    image = (skin * (1 - cover * (1 - transmittance)))[..., None] * np.array(tint)
    if housing is not None:
        outside = np.hypot(x - 160, y - 120) > 110
        image[outside] = (housing * (1.0 + 0.5 * (x // 17 % 2)))[outside, None]
    return levels(image, NOISE, 6)


def within(places: np.ndarray, radius: float) -> np.ndarray:
    return places[np.linalg.norm(places - (160, 120), axis=-1) < radius]


@pytest.mark.parametrize(
    ("palette", "dye", "options"),
    [
        (DARK, 0.15, {"housing": 0.08, "shade": 0.5, "tint": (1.0, 0.7, 0.5)}),
        (DARK, 0.15, {"housing": 0.005}),
        (DARK, 0.6, {"shade": 0.5}),
        (DARK, 0.02, {"housing": 0.08}),
        (PINS, 8.0, {"light": 0.1, "housing": 0.08}),
        (PINS, 3.0, {"light": 0.1, "shade": 0.6}),
        (PINS, 80.0, {"light": 0.01}),
        (DARK, 0.15, {"radius": 2.0}),
        (DARK, 0.15, {"radius": 14.0}),
    ],
)
def test_dots_of_one_dye_are_found_strong_or_weak_and_whatever_is_around(
    palette: Palette, dye: float, options: dict[str, float]
) -> None:
    """No housing is a marker or spoils their size; sizes are true though the dye is another."""
    radius = options.get("radius", 6.0)
    places = scattered(max(12.0, 4.0 * radius))
    if "housing" in options:
        places = within(places, 95.0)
    (found,) = detect_markers(draw(places, transmittance=dye, **options), palette)
    number = matched(found, places)
    assert np.sqrt(((found.position - places[number]) ** 2).mean()) < 0.03
    if radius > 4.0:  # of less, the lens leaves no edge
        assert np.median(found.area) == pytest.approx(np.pi * radius**2, rel=0.05)


def test_markers_that_touch_are_parted() -> None:
    """Squares of 12 px with gaps of 3, out of focus by 1.8 px: above half of the dye it is one."""
    y, x = np.mgrid[:240, :320]
    inside = (x >= 70) & (x < 250) & (y >= 30) & (y < 210)
    square = inside & ((x - 70) % 15 < 12) & ((y - 30) % 15 < 12)
    light = cv2.GaussianBlur(0.7 * np.where(square, 0.15, 1.0), (0, 0), 1.8)
    (found,) = detect_markers(levels(np.repeat(light[..., None], 3, axis=2), NOISE), DARK)
    at = np.arange(12) * 15 + 5.5
    truth = np.stack(np.meshgrid(70 + at, 30 + at), axis=-1).reshape(-1, 2)
    number = matched(found, truth)
    assert np.sqrt(((found.position - truth[number]) ** 2).mean()) < 0.3


def test_slivers_and_what_the_border_cuts_are_no_markers() -> None:
    """Scratches as large as a marker, at any angle; dots whose middle lies on the border."""
    places = within(scattered(24.0), 95.0)
    cut = np.array([[0.0, 40.0], [319.0, 200.0], [40.0, 0.0], [90.0, 239.0]])
    image = draw(np.vstack([places, cut]))
    for k, start in enumerate([(20, 60), (20, 110), (20, 160), (290, 70), (290, 130)]):
        angle = 0.7 * k
        end = (int(start[0] + 30 * np.cos(angle)), int(start[1] + 30 * abs(np.sin(angle))))
        cv2.line(image, start, end, (70, 70, 70), 4, cv2.LINE_AA)
    (found,) = detect_markers(image, DARK)
    matched(found, places)


def test_pictures_without_markers_are_refused() -> None:
    image, bare = draw(scattered(24.0)), draw(np.array([[-99.0, -99.0]]), shade=0.6)
    for picture, palette, words in (
        (0 * image, DARK, "no markers found: nothing in the image .* palette's dark"),
        (bare, PINS, "no markers found: .* palette's pin"),
        (image[..., [1, 1, 1]], load_palette(), "is grey .* magenta and yellow need a colour"),
        (image[:, :, 0], DARK, r"shape \(240, 320\), expected \(height, width, 3\)"),
        (image[:9], DARK, r"shape \(9, 320, 3\), expected 16 pixels or more"),
    ):
        with pytest.raises(UserError, match=words):
            detect_markers(picture, palette)


def resting(name: str, membrane: Membrane) -> list[Frame]:
    return [Frame(image=shoot(name, membrane), time=0.0)]


def test_rest_frames_of_a_loaded_sensor_or_without_a_layer_are_refused() -> None:
    seen = np.load(Path(__file__).parents[2] / "fixtures/path-traced/seen.npz")["013"]
    membrane = MembraneMap(sensor("thesis"), len(seen))(seen.astype(float))
    with pytest.raises(UserError, match=r"looks loaded: around .* px out of register"):
        read_rest(resting("thesis", membrane), load_palette())
    centres = rest("flat-2019").centres.copy()
    centres[0] = np.nan
    membrane = Membrane(centres=centres, axes=rest("flat-2019").axes)
    with pytest.raises(UserError, match="shows 0 magenta, 100 yellow markers; wanted: some"):
        read_rest(resting("flat-2019", membrane), load_palette())


@pytest.mark.parametrize(
    ("name", "defects"),
    [
        ("dome-2020-printed", Defects(misalignment_mm=0.1, misplacement_mm=0.02)),
        ("flat-2019", Defects(misalignment_mm=0.1, missing_markers=0.2, misplacement_mm=0.02)),
    ],
)
def test_a_sensor_as_it_was_made_is_at_rest(name: str, defects: Defects) -> None:
    flaws = Flaws(sensor(name), defects, seed=1)
    membrane = flaws(rest_membrane(sensor(name), flaws.places))
    found = read_rest(resting(name, membrane), Palette.of_sensor(sensor(name)))
    assert np.isfinite(found.position[..., 0]).sum() == (~flaws.missing).sum()
    true_area = areas(outlines(membrane, sensor(name).view), square=name == "flat-2019")
    expected = np.sqrt(np.nanmedian(true_area, axis=1) / np.pi)
    np.testing.assert_allclose(found.radius, expected, rtol=0.03)
