import numpy as np
import pytest

from chromagrip.render import Membrane, load_sensor, open_renderer
from chromagrip.render.colour import decode_srgb, encode_srgb
from chromagrip.render.coverage import edge_table, edge_width, paint_ellipses

SENSOR = load_sensor("thesis")
CLEAR = np.array([0.0, 0.5, 1.0])


def paint(centre: np.ndarray, shape: np.ndarray, blur: float = 0.8) -> np.ndarray:
    image = np.ones((37, 41, 3), dtype=np.float32)
    paint_ellipses(image, centre[None], shape[None], CLEAR, edge_width(blur), edge_table())
    return image


@pytest.mark.parametrize("shape", [np.diag([5.0, 5.0]), np.array([[6.0, 1.0], [-0.5, 4.0]])])
@pytest.mark.parametrize("blur", [0.4, 0.8, 1.2])
def test_area_and_centroid_of_an_ellipse(shape: np.ndarray, blur: float) -> None:
    """Blur and pixels conserve area; the centroid is where it was put to 0.005 px."""
    y, x = np.mgrid[:37, :41]
    for centre in np.random.default_rng(0).uniform([17, 16], [23, 20], (8, 2)):
        dark = 1.0 - paint(centre, shape, blur)[:, :, 0].astype(float)
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
    painted = 1.0 - paint(centre, radius * np.eye(2), blur)[:, :, 0]
    assert abs(painted - covered).max() < 0.02


def test_dyes_multiply() -> None:
    image = np.ones((37, 41, 3), dtype=np.float32)
    for dye in SENSOR.transmittance:
        paint_ellipses(image, np.array([[20.0, 18.0]]), 6 * np.eye(2)[None], dye, 0.8, edge_table())
    np.testing.assert_allclose(image[18, 20], SENSOR.transmittance.prod(axis=0), rtol=1e-5)


def test_nothing_outside_the_image_is_touched() -> None:
    image = np.ones((20, 30, 3), dtype=np.float32)
    centres = np.array([[-30.0, 5.0], [15.0, 200.0], [np.nan, 3.0], [29.0, 19.0]])
    shapes = np.tile(4 * np.eye(2), (4, 1, 1))
    paint_ellipses(image, centres, shapes, CLEAR, 0.8, edge_table())
    assert image[10, 10].tolist() == [1.0, 1.0, 1.0]
    assert image[19, 29, 0] < 0.1


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
        normals=np.tile([0.0, 0.0, 1.0], (2, 1, 1)),
        radius=SENSOR.marker_radius,
    )
    first = painter.render(membrane)
    kept = first.copy()
    second = painter.render(membrane)
    assert (first == second).all()
    second[:] = 0
    assert (first == kept).all()
