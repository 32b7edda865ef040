import numpy as np
import pytest
from msgspec.structs import replace
from scipy.stats import multivariate_normal, norm

from chromagrip.model import ContactObject, Fingertip, rest_state, step
from chromagrip.render import Membrane, MembraneMap, load_sensor, open_renderer
from chromagrip.render.colour import decode_srgb, encode_srgb
from chromagrip.render.drawing.coverage import covered_by_both, edge_width, togetherness
from chromagrip.render.drawing.painter import Painter, coverage_image
from chromagrip.render.drawing.supersampled import supersampled_image
from chromagrip.render.ground import ground_image
from chromagrip.render.membrane import rest_membrane
from chromagrip.render.outlines import centroids, outlines

SENSOR = load_sensor("thesis")


def coefficients(centres: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Of ellipses, whose second order is nil."""
    out = np.zeros((len(centres), 6, 2))
    out[:, 0] = centres
    out[:, 1:3] = np.swapaxes(shapes, -1, -2)
    return out


def paint(centre: np.ndarray, shape: np.ndarray, blur: float = 0.8) -> np.ndarray:
    ellipse = coefficients(centre[None], shape[None])
    return coverage_image(ellipse, edge_width(blur), False, (37, 41)).astype(float)


@pytest.mark.parametrize("shape", [np.diag([5.0, 5.0]), np.array([[6.0, 1.0], [-0.5, 4.0]])])
@pytest.mark.parametrize("blur", [0.4, 0.8, 1.2])
def test_area_and_centroid_of_an_ellipse(shape: np.ndarray, blur: float) -> None:
    """Blur and pixels conserve area; the centroid is where it was put to 0.005 px."""
    y, x = np.mgrid[:37, :41]
    for centre in np.random.default_rng(0).uniform([17, 16], [23, 20], (8, 2)):
        dark = paint(centre, shape, blur)
        assert dark.sum() == pytest.approx(np.pi * abs(np.linalg.det(shape)), rel=0.004)
        found = np.array([(dark * x).sum(), (dark * y).sum()]) / dark.sum()
        np.testing.assert_allclose(found, centre, atol=0.005)


def test_edge_is_a_blurred_disc() -> None:
    """Against brute force: a finely sampled disc, box-filtered to pixels and blurred."""
    fine, blur, radius = 15, 0.8, 4.7
    centre = np.array([20.3, 18.6])
    y, x = (np.mgrid[: 37 * fine, : 41 * fine] + 0.5) / fine - 0.5
    inside = ((x - centre[0]) ** 2 + (y - centre[1]) ** 2 < radius**2).astype(float)
    covered = inside.reshape(37, fine, 41, fine).mean(axis=(1, 3))
    kernel = np.exp(-0.5 * (np.arange(-6, 7) / blur) ** 2)
    kernel /= kernel.sum()
    for axis in (0, 1):
        covered = np.apply_along_axis(lambda v: np.convolve(v, kernel, "same"), axis, covered)
    painted = paint(centre, radius * np.eye(2), blur)
    assert abs(painted - covered).max() < 0.02


def test_a_picture_is_the_product_of_what_pairs_leave() -> None:
    """Pixel by pixel, without tiles and blocks: pairs anywhere, some cut off, some alone."""
    rng, rest = np.random.default_rng(4), rest_membrane(SENSOR)
    kept: list[int] = []
    for k in rng.permutation(rest.centres.shape[1]):
        gaps = np.linalg.norm(rest.centres[0, kept] - rest.centres[0, k], axis=-1)
        if len(kept) < 40 and gaps.min(initial=1.0) > 5.0 * SENSOR.half_sizes.max():
            kept.append(int(k))
    centres = np.full_like(rest.centres, np.nan)
    moved = rng.uniform(-1.0, 1.0, (2, len(kept), 3)) * SENSOR.half_sizes.max()
    centres[:, kept] = rest.centres[:, kept] + moved
    centres[0, kept[0]] = centres[1, kept[1]] = np.nan
    membrane = Membrane(centres=centres, axes=rest.axes)
    painter = Painter(SENSOR)
    painter.render(rest)  # so that nearly all of it is drawn over
    image = painter.render(membrane)
    magenta, yellow = (1.0 - SENSOR.transmittance).astype(np.float32)
    light = np.ones(image.shape)
    coefficients = np.rint(outlines(membrane, SENSOR.view) * 1024.0) / 1024.0
    width = edge_width(SENSOR.camera.blur_px)
    for k in kept:
        first, second = (
            coverage_image(coefficients[layer, k : k + 1], width, False, image.shape[:2])
            for layer in range(2)
        )
        odds = togetherness(coefficients[0, k], coefficients[1, k])
        on = (first > 0.0) & (second > 0.0)
        both = np.zeros_like(first)
        both[on] = [
            covered_by_both(a, b, np.float32(odds))
            for a, b in zip(first[on], second[on], strict=True)
        ]
        light *= (
            1.0
            - first[..., None] * magenta
            - second[..., None] * yellow
            + both[..., None] * (magenta * yellow)
        )
    expected = np.rint(encode_srgb(ground_image(SENSOR) * light)).astype(int)
    assert (light < 0.9).mean() > 0.005
    assert abs(image - expected).max() <= 1  # the encoding is a table


def test_dyes_multiply() -> None:
    """A marker of both dyes, larger than a tile, is as dark as both transmittances together."""
    big = Membrane(
        centres=np.tile([[0.0, 0.0, 7.5e-3]], (2, 1, 1)),
        axes=np.tile(1e-3 * np.eye(3)[:, :2], (2, 1, 1, 1)),
    )
    image = open_renderer("painter", SENSOR).render(big)
    ground = decode_srgb(np.array([250.0, 249.0, 248.0]))
    expected = encode_srgb(ground * SENSOR.transmittance.prod(axis=0))
    np.testing.assert_allclose(image[239, 319], expected, atol=1)


def test_markers_outside_the_image_are_not_drawn() -> None:
    centres = np.array([[-30.0, 5.0], [15.0, 200.0], [np.nan, 3.0], [40.0, 36.0]])
    ellipses = coefficients(centres, np.tile(4 * np.eye(2), (4, 1, 1)))
    image = coverage_image(ellipses, 0.8, False, (37, 41))
    assert image[10, 10] == 0.0
    assert image[36, 40] > 0.9


def test_a_square_is_a_product_of_two_edges() -> None:
    """Area and centroid of a turned square; its corner is a quarter covered."""
    turn = 6.0 * np.array([[0.8, -0.6], [0.6, 0.8]])
    square = coefficients(np.array([[20.3, 18.1]]), turn[None])
    image = coverage_image(square, edge_width(0.8), True, (37, 41)).astype(float)
    x = np.arange(41)
    assert image.sum() == pytest.approx(144.0, rel=0.002)
    assert (image * x).sum() / image.sum() == pytest.approx(20.3, abs=0.005)
    flat = coefficients(np.array([[20.0, 18.0]]), 6 * np.eye(2)[None])
    corner = coverage_image(flat, edge_width(0.8), True, (37, 41))[24, 26]
    assert corner == pytest.approx(0.25, abs=1e-3)


def pressed(load: float) -> Membrane:
    tip, obj = Fingertip(), ContactObject()
    state = rest_state(tip)
    for k in range(20):
        state = step(tip, obj, state, 5e-3, 2.0, load if k > 5 else 0.0)
    return MembraneMap(SENSOR, tip.nodes)(state.deformation.seen)


def test_redrawing_what_moved_is_redrawing_all_bit_for_bit() -> None:
    """A picture never depends on the ones before it."""
    fast, full = open_renderer("painter", SENSOR), Painter(SENSOR, redraw=True)
    rest, near, far = pressed(0.0), pressed(0.1), pressed(0.8)
    gone = Membrane(
        centres=np.where(np.arange(400)[:, None] % 7, near.centres, np.nan), axes=near.axes
    )
    for membrane in (rest, near, far, far, gone, near, rest):
        assert (fast.render(membrane) == full.render(membrane)).all()


def test_edges_that_go_together_are_blurred_together() -> None:
    """What two blurred edges both cover is a bivariate normal probability."""
    rng = np.random.default_rng(1)
    for cosine in (-0.95, -0.5, 0.0, 0.3, 0.6, 0.9, 0.99):
        # Two circles of radius 5 whose edges cross at that angle.
        apart = 5.0 * np.sqrt(2.0 - 2.0 * cosine)
        outline = coefficients(
            np.array([[0.0, 0.0], [apart, 0.0]]), np.tile(5 * np.eye(2), (2, 1, 1))
        )
        odds = togetherness(outline[0], outline[1])
        distance = rng.uniform(-2.5, 2.5, (200, 2))
        covered = norm.cdf(distance).astype(np.float32)
        both = np.array([covered_by_both(u, v, np.float32(odds)) for u, v in covered])
        exact = multivariate_normal([0, 0], [[1, cosine], [cosine, 1]]).cdf(distance)
        assert abs(both - exact).max() < 0.012
        if abs(cosine) > 0.4:  # where a product is far off
            assert abs(covered.prod(axis=1) - exact).max() > 5 * abs(both - exact).max()


@pytest.mark.parametrize("name", ["dome-2020-printed", "flat-2019"])
def test_pictures_are_those_of_brute_force(name: str) -> None:
    """Discs and squares whose layers lie apart, against 81 samples a pixel, blurred as light is."""
    sensor = load_sensor(name)
    small = replace(sensor.camera, width_px=320, height_px=240)
    if name == "dome-2020-printed":
        small = replace(small, focal_px=(70.0, 70.0))
    sensor = replace(sensor, camera=small)
    rest = rest_membrane(sensor)
    rng = np.random.default_rng(2)
    shift = 0.4e-3 * rng.standard_normal((len(sensor.places), 2))
    centres = rest.centres.copy()
    centres[1] += np.einsum("mki,mi->mk", rest.axes[1] / sensor.half_sizes[1], shift)
    membrane = Membrane(centres=centres, axes=rest.axes)
    off = Painter(sensor).render(membrane).astype(int) - supersampled_image(sensor, membrane)
    assert (abs(off).max(axis=-1) > 3).mean() < 0.02  # what the meshes are held to
    assert abs(off.mean()) < 0.1


def test_outlines_are_what_the_camera_projects() -> None:
    """Against each outline projected point by point: where it lies, its area, its centroid."""
    membrane = pressed(0.8)
    angle = np.linspace(0.0, 2 * np.pi, 720, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    points = membrane.centres[:, :, None] + circle @ np.swapaxes(membrane.axes, -1, -2)
    polygon = SENSOR.view.project(points)
    x, y = np.moveaxis(polygon, -1, 0)
    x1, y1 = np.roll(x, -1, axis=-1), np.roll(y, -1, axis=-1)
    cross = x * y1 - x1 * y
    middle = np.stack([(x + x1) * cross, (y + y1) * cross]).sum(axis=-1) / (3 * cross.sum(axis=-1))
    found = centroids(outlines(membrane, SENSOR.view), square=False)
    np.testing.assert_allclose(found, np.moveaxis(middle, 0, -1), atol=1e-3)
    projected = SENSOR.view.project(membrane.centres)
    assert np.abs(found - projected).max() > 0.01  # which is why the second order is there


def test_colours_are_those_of_the_real_dome() -> None:
    """Median sRGB of a real frame: overlap 209,107,63 · yellow 241,212,89 · magenta 198,86,117."""
    ground = decode_srgb(np.array([250.0, 249.0, 248.0]))
    magenta, yellow = SENSOR.transmittance
    for dye, real in (
        (magenta * yellow, (209, 107, 63)),
        (yellow, (241, 212, 89)),
        (magenta, (198, 86, 117)),
    ):
        assert abs(encode_srgb(ground * dye) - real).max() < 20


def test_rendering_is_repeatable_and_does_not_share_memory() -> None:
    painter = open_renderer("painter", SENSOR)
    membrane = Membrane(
        centres=np.array([[[0, 0, 7.7e-3]], [[1e-4, 0, 7e-3]]]),
        axes=np.tile(0.25e-3 * np.eye(3)[:, :2], (2, 1, 1, 1)),
    )
    first = painter.render(membrane)
    kept = first.copy()
    second = painter.render(membrane)
    assert (first == second).all()
    second[:] = 0
    assert (first == kept).all()
