"""The camera behind the silicone's surface, against Snell's law and simple optics."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromagrip.render import FisheyeCamera, PinholeCamera, View

FISHEYE = FisheyeCamera(width=640, height=480, focal=(152.8, 152.8), centre=(319.5, 239.5))
PINHOLE = PinholeCamera(width=640, height=480, focal=(900.0, 900.0), centre=(319.5, 239.5))


def dome_view(position: float, index: float = 1.41) -> View:
    return View(camera=FISHEYE, position=position, port=6e-3, flat=False, index=index)


PAD = View(camera=PINHOLE, position=-60e-3, port=-8e-3, flat=True, index=1.41)


def skin_points(count: int = 40) -> np.ndarray:
    rng = np.random.default_rng(3)
    theta, phi = rng.uniform(0.0, 1.2, count), rng.uniform(0.0, 2 * np.pi, count)
    radius = rng.uniform(6.5e-3, 8e-3, count)
    theta[0] = 0.0  # on the axis
    return radius[:, None] * np.column_stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    )


@pytest.mark.parametrize("position", [-2e-3, -0.5e-3, 0.0, 1.5e-3])
def test_traced_rays_meet_the_points_they_show(position: float) -> None:
    view, points = dome_view(position), skin_points()
    start, ray = view.trace(view.project(points))
    off = np.cross(points - start, ray)
    np.testing.assert_allclose(np.linalg.norm(off, axis=-1), 0.0, atol=1e-9)


@settings(max_examples=30)
@given(st.floats(-4e-3, 4e-3), st.floats(1.0, 2.0), st.floats(0.0, 60.0))
def test_rays_bend_by_snells_law(position: float, index: float, angle: float) -> None:
    view = dome_view(position, index)
    pixel = np.array([319.5 + 152.8 * np.deg2rad(angle), 239.5])
    start, inside = view.trace(pixel)
    if not view.bends:
        return
    normal = start / np.linalg.norm(start)
    assert np.linalg.norm(start) == pytest.approx(6e-3, rel=1e-9)
    outside = view.camera.rays(pixel)
    sines = [np.linalg.norm(np.cross(ray, normal)) for ray in (outside, inside)]
    assert sines[0] == pytest.approx(index * sines[1], abs=1e-9)
    # Bent in one plane, and not turned back.
    assert np.linalg.det(np.stack([outside, inside, normal])) == pytest.approx(0.0, abs=1e-9)
    assert (outside @ normal) * (inside @ normal) > 0.0


def test_from_the_sphere_centre_no_ray_is_bent() -> None:
    points = skin_points()
    np.testing.assert_array_equal(dome_view(0.0).project(points), FISHEYE.project(points))


def test_off_the_centre_silicone_matters() -> None:
    points = skin_points()
    bent, straight = dome_view(-1.5e-3).project(points), dome_view(-1.5e-3, 1.0).project(points)
    assert 1.0 < np.linalg.norm(bent - straight, axis=-1).max() < 30.0
    np.testing.assert_allclose(
        straight, FISHEYE.project(points + np.array([0.0, 0.0, 1.5e-3])), atol=1e-9
    )


def test_a_flat_port_brings_things_nearer_by_the_index() -> None:
    """Near the axis a point d behind the surface is seen as if d/n behind it."""
    point = np.array([0.05e-3, -0.02e-3, 0.0])  # 8 mm behind the surface
    apparent = 52e-3 + 8e-3 / 1.41
    expected = 319.5 + 900.0 * point[0] / apparent, 239.5 + 900.0 * point[1] / apparent
    np.testing.assert_allclose(PAD.project(point), expected, atol=1e-4)


@pytest.mark.parametrize("view", [dome_view(-1.5e-3), dome_view(0.0), PAD])
def test_jacobian_is_the_derivative(view: View) -> None:
    points = skin_points() - ([0.0, 0.0, 8e-3] if view.flat else [0.0, 0.0, 0.0])
    points = points[points[:, 2] > -5e-3]
    jacobian = view.jacobian(points)
    for k, nudge in enumerate(1e-6 * np.eye(3)):
        slope = (view.project(points + nudge) - view.project(points - nudge)) / 2e-6
        np.testing.assert_allclose(jacobian[:, :, k], slope, rtol=1e-4, atol=1.0)
