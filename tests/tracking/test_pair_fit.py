import cv2
import numpy as np
import pytest
from scipy.spatial import KDTree

from chromagrip.render import Frame, Membrane
from chromagrip.render.colour import encode_srgb
from chromagrip.render.drawing import supersampled
from chromagrip.render.drawing.coverage import EDGE_RANGE, edge, edge_slope
from chromagrip.render.drawing.supersampled import (
    polygon_centroids,
    projected_outlines,
    supersampled_image,
)
from chromagrip.tracking import MarkerTracker, Palette
from chromagrip.tracking.fit.kernels.neighbour_kernels import slopes_of, tie_light
from chromagrip.tracking.fit.pair_fit import _slope_matrices

from .middle import PALETTE, PLACES, REST, SENSOR, moved, shoot

BLUR, RADIUS, NOISE = 0.9, 6.0, 2.0


def test_slope_of_the_edge_is_its_derivative() -> None:
    for u in np.linspace(-0.95, 0.95, 21):
        # edge is computed in single precision
        rise = (float(edge(np.float32(u + 1e-2))) - float(edge(np.float32(u - 1e-2)))) / 2e-2
        gauss = EDGE_RANGE / np.sqrt(2 * np.pi) * np.exp(-0.5 * (EDGE_RANGE * u) ** 2)
        assert float(edge_slope(np.float32(u))) == pytest.approx(rise, abs=2e-3)
        assert rise == pytest.approx(gauss, abs=2e-3)
    assert edge_slope(np.float32(1.2)) == 0.0


def dots(transmittance: float, shift: tuple[float, float], ground: float, seed: int) -> Frame:
    """Discs on a lattice, drawn by sampling finely and blurring: no code of ours."""
    # Every cell of the lattice is alike: the disc never leaves it.
    y, x = (np.mgrid[: 22 * 8, : 24 * 8] + 0.5) / 8 - 0.5
    inside = (x - 12 - shift[0]) ** 2 + (y - 11 - shift[1]) ** 2 < RADIUS**2
    cell = cv2.GaussianBlur(np.where(inside, transmittance, 1.0), (0, 0), BLUR * 8)
    light = np.ones((120, 160))
    light[4:114, 3:147] = np.tile(cv2.resize(cell, (24, 22), interpolation=cv2.INTER_AREA), (5, 6))
    levels = encode_srgb(np.repeat(ground * light[..., None], 3, axis=2))
    levels += np.random.default_rng(seed).normal(0.0, NOISE, levels.shape)
    return Frame(image=np.clip(np.rint(levels), 0, 255).astype(np.uint8), time=0.1 * seed)


@pytest.mark.parametrize(("transmittance", "ground"), [(0.6, 0.6), (1.7, 0.35)])
def test_one_dye_reaches_the_limit_of_one_disc(transmittance: float, ground: float) -> None:
    """σ/A·√(2s/(√π·R)) per coordinate and channel; three channels tell √3 more of a grey dot.

    The same edge tells of the logarithm of the radius by √2·R more, when the light is known.
    """
    palette = Palette(names=("dot",), transmittance=np.full((1, 3), transmittance))
    tracker = MarkerTracker(palette, NOISE)
    rest = tracker.reset([dots(transmittance, (0.0, 0.0), ground, seed) for seed in range(8)])
    assert rest.position.shape == (1, 30, 2)
    shift, errors, squares, sizes, size_squares = (0.0, 0.0), [], [], [], []
    for seed in range(8, 20):
        shift = (0.1 * (seed - 8), -0.05 * (seed - 8))
        tracks = tracker.update(dots(transmittance, shift, ground, seed))
        lattice = rest.position[0] / [24, 22] - np.array([15, 15]) / [24, 22]
        truth = np.rint(lattice) * [24, 22] + 15 + shift
        error = tracks.position[0] - truth
        errors.append(error)
        inverse = np.linalg.inv(tracks.covariance[:, :2, :2])
        squares.append(np.einsum("mi,mij,mj->m", error, inverse, error))
        # Tuning the blur to the first frames moves all sizes alike.
        grown = tracks.log_size[0] - rest.log_size[0]
        grown -= grown.mean()
        sizes.append(grown)
        size_squares.append(grown**2 / (tracks.covariance + rest.covariance)[:, 2, 2])
    step = float(encode_srgb(ground) - encode_srgb(ground * transmittance))
    width = np.hypot(BLUR, np.sqrt(1 / 12))
    limit = NOISE / abs(step) * np.sqrt(2 * width / (np.sqrt(np.pi) * RADIUS)) / np.sqrt(3)
    rms = np.sqrt(np.mean(np.square(errors)))
    assert 0.93 * limit < rms < 1.15 * limit
    assert np.mean(squares) / 2 == pytest.approx(1.0, abs=0.15)
    # The rest frames cost 6 %; free gains would cost 40 % more.
    size_limit = limit / (np.sqrt(2) * RADIUS)
    assert 0.97 * size_limit < np.sqrt(np.mean(np.square(sizes))) < 1.25 * size_limit
    assert np.mean(size_squares) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize(("scatter", "gain"), [(0.0, (1.25, 1.4)), (0.02, (0.97, 1.03))])
def test_neighbours_tell_of_the_light_as_far_as_it_is_even(
    scatter: float, gain: tuple[float, float]
) -> None:
    """Gains and sizes of Gaussian noise that go together; of light that scatters, none is told."""
    rng = np.random.default_rng(3)
    count, sd = 4000, 0.002
    ring = np.arange(count)
    near = np.stack([(ring + k) % count for k in (-3, -2, -1, 1, 2, 3)], axis=1)
    one = np.diag([1e-4, 1e-4, 1e-6, 1e-4, 1e-4, 1e-6, sd**2, sd**2, sd**2])
    one[2, 6:] = one[6:, 2] = 0.4 * 1e-3 * sd
    covariance = np.tile(one, (count, 1, 1))
    error = rng.multivariate_normal(np.zeros(9), one, count)
    light = 0.3 + scatter * rng.standard_normal((count, 1)) + error[:, 6:]
    fits = np.zeros((count, 2, 5))
    fits[:, 0, :3], fits[:, 1, :3] = error[:, :3], error[:, 3:6]
    tie_light(light, np.ones(count, dtype=np.bool_), near, covariance, fits)
    before, after = error[:, 2], fits[:, 0, 2]
    assert gain[0] < before.std() / after.std() < gain[1]
    assert np.mean(after**2 / covariance[:, 2, 2]) == pytest.approx(1.0, abs=0.1)
    # What does not go with the light is left alone.
    np.testing.assert_allclose(fits[:, 0, :2], error[:, :2], atol=1e-15)


def test_the_slope_of_the_light_is_that_of_its_logarithm() -> None:
    """Light exp(a·x + b·y) has the slope (a, b) between any neighbours; a dark pair has none."""
    rng = np.random.default_rng(4)
    places = rng.uniform(0.0, 200.0, (40, 2))
    near = np.ascontiguousarray(KDTree(places).query(places, k=7)[1][:, 1:])
    gains = np.exp(places @ [0.004, -0.007])[:, None] * [0.5, 1.0, 1.5]
    gains[near[0, 0], 1] = 0.0
    slopes = np.empty((40, 2))
    slopes_of(gains, near, _slope_matrices(places, near), slopes)
    dark = (near == near[0, 0]).any(axis=1) | (np.arange(40) == near[0, 0])
    assert np.isnan(slopes[dark]).all()
    np.testing.assert_allclose(slopes[~dark], [[0.004, -0.007]] * np.sum(~dark), rtol=1e-9)


def size_errors(
    monkeypatch: pytest.MonkeyPatch, membrane: Membrane
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors of log sizes and their stated deviations (2, M), and outlines.

    On pictures that share no code with the fit: both dyes, then the lens.
    """
    monkeypatch.setattr(supersampled, "CORNERS", 90)  # which the true areas have too
    first, last = (supersampled_image(SENSOR, m) for m in (REST, membrane))
    tracker = MarkerTracker(PALETTE, 2.0)
    found = tracker.reset([Frame(image=first, time=0.0)])
    for k in range(3):
        tracks = tracker.update(Frame(image=last, time=0.01 * (k + 1)))
    before, after = (projected_outlines(SENSOR, m) for m in (REST, membrane))
    grown = 0.5 * np.log(polygon_areas(after) / polygon_areas(before))
    distance, number = KDTree(found.position[1]).query(polygon_centroids(before)[1])
    assert distance.max() < 0.1
    stated = np.sqrt(tracks.covariance[number][:, [2, 5], [2, 5]].T)
    return tracks.log_size[:, number] - grown, stated, after


@pytest.mark.stages
def test_sizes_are_right_wherever_the_other_layer_lies(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, count = np.random.default_rng(6), len(PLACES)
    pixels, angle = rng.uniform(0.0, 5.0, count), rng.uniform(0.0, 2.0 * np.pi, count)
    way = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    error, _, _ = size_errors(monkeypatch, moved(5.3e-5 * pixels[:, None] * way, layer=0))
    for low in (0.0, 1.7, 3.4):
        of = (low <= pixels) & (pixels < low + 1.7)
        assert of.sum() > 20
        assert abs(np.median(error[:, of], axis=1)).max() < 1e-3


@pytest.mark.stages
@pytest.mark.parametrize("apart_by", [2.05, 1.6])
def test_sizes_are_right_where_pairs_touch(
    monkeypatch: pytest.MonkeyPatch, apart_by: float
) -> None:
    """Edges of neighbours face each other, and what they absorb adds up.

    Where they lie on each other it is less certain how much, and that is said.
    """
    # Two and two, both layers alike, move together until half a pixel is left, or less.
    flat = REST.centres[0, :, :2]
    move, alone = np.zeros((len(flat), 3)), np.ones(len(flat), dtype=bool)
    for k, near in enumerate(KDTree(flat).query(flat, k=7)[1]):
        free = [other for other in near[1:] if alone[other]]
        if alone[k] and free:
            way = flat[free[0]] - flat[k]
            apart = np.linalg.norm(way)
            move[k, :2] = 0.5 * way / apart * (apart - apart_by * SENSOR.half_sizes[1])
            move[free[0]] = -move[k]
            alone[[k, free[0]]] = False
    error, stated, after = size_errors(monkeypatch, moved(move))
    now = polygon_centroids(after)[1]
    gap = KDTree(now).query(now, k=2)[0][:, 1] - 2.0 * np.sqrt(polygon_areas(after)[1] / np.pi)
    touching = (gap < 1.5) & (PLACES[:, 0] < 0.55)  # not the outermost, which lack neighbours
    assert touching.sum() > 30
    error, stated = error[:, touching], stated[:, touching]
    if apart_by > 2.0:
        assert abs(np.median(error, axis=1)).max() < 1e-3
        assert error.std(axis=1).max() < 2e-3
    # There is no noise but what the tracker counts with: its own errors are all there is.
    assert np.sqrt(((error / stated) ** 2).mean()) < 1.2


def test_a_disc_that_gets_long_and_narrow_keeps_its_size() -> None:
    """The logarithm of its radius is half that of its area, whatever its form."""
    tracker = MarkerTracker(PALETTE, NOISE)
    tracker.reset([shoot(REST, k) for k in range(4)])
    drawn = Membrane(centres=REST.centres, axes=REST.axes * np.array([[1.2], [1.0 / 1.2], [1.0]]))
    tracks = tracker.update(shoot(drawn, 9))
    assert tracks.visible.mean() > 0.95
    np.testing.assert_allclose(np.nanmedian(tracks.log_size, axis=1), 0.0, atol=3e-3)


def polygon_areas(corners: np.ndarray) -> np.ndarray:
    """Areas of polygons, shape (…), from corners (…, K, 2)."""
    x, y = np.moveaxis(corners - corners[..., :1, :], -1, 0)
    return abs((x * np.roll(y, -1, axis=-1) - np.roll(x, -1, axis=-1) * y).sum(axis=-1)) / 2
