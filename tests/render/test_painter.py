"""How the painter covers pixels: outlines, edges of two layers, pictures that are drawn over."""

import numpy as np
from scipy.stats import multivariate_normal, norm

from chromagrip.render import Membrane, MembraneMap, load_sensor
from chromagrip.render.colour import decode_srgb, encode_srgb
from chromagrip.render.drawing.coverage import covered_by_both, togetherness
from chromagrip.render.drawing.painter import Painter
from chromagrip.render.outlines import centroids, outlines

SENSOR = load_sensor("thesis")


def coefficients(centres: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Of ellipses, whose second order is nil."""
    out = np.zeros((len(centres), 6, 2))
    out[:, 0] = centres
    out[:, 1:3] = np.swapaxes(shapes, -1, -2)
    return out


def dragged(share: float) -> Membrane:
    """The thesis' skin with a dent that is dragged along x."""
    place = np.linspace(-1.0, 1.0, 201)
    dent = share * 0.4e-3 * np.exp(-((place / 0.25) ** 2))
    return MembraneMap(SENSOR, 201)(np.column_stack([0.6 * dent, -dent]))


def test_redrawing_what_moved_is_redrawing_all_bit_for_bit() -> None:
    fast, full = Painter(SENSOR), Painter(SENSOR, redraw=True)
    rest, near, far = (dragged(share) for share in (0.0, 0.1, 1.0))
    gone = Membrane(
        centres=np.where(np.arange(400)[:, None] % 7, near.centres, np.nan), axes=near.axes
    )
    for membrane in (rest, near, far, far, gone, rest):
        assert (fast.render(membrane) == full.render(membrane)).all()


def test_edges_that_go_together_are_blurred_together() -> None:
    """What two blurred edges both cover is a bivariate normal probability."""
    rng = np.random.default_rng(1)
    for cosine in (-0.95, -0.5, 0.0, 0.6, 0.99):
        # Two circles of radius 5 whose edges cross at that angle.
        apart = 5.0 * np.sqrt(2.0 - 2.0 * cosine)
        outline = coefficients(
            np.array([[0.0, 0.0], [apart, 0.0]]), np.tile(5 * np.eye(2), (2, 1, 1))
        )
        odds = np.float32(togetherness(outline[0], outline[1]))
        distance = rng.uniform(-2.5, 2.5, (100, 2))
        covered = norm.cdf(distance).astype(np.float32)
        both = np.array([covered_by_both(u, v, odds) for u, v in covered])
        exact = multivariate_normal([0, 0], [[1, cosine], [cosine, 1]]).cdf(distance)
        assert abs(both - exact).max() < 0.012
        if abs(cosine) > 0.4:  # where a product is far off
            assert abs(covered.prod(axis=1) - exact).max() > 5 * abs(both - exact).max()


def test_outlines_are_what_the_camera_projects() -> None:
    """Against the centroid of each outline that is projected point by point."""
    membrane = dragged(1.0)
    angle = np.linspace(0.0, 2 * np.pi, 360, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    points = membrane.centres[:, :, None] + circle @ np.swapaxes(membrane.axes, -1, -2)
    x, y = np.moveaxis(SENSOR.view.project(points), -1, 0)
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
