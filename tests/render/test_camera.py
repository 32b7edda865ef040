"""Cameras against OpenCV; behind the silicone's surface, against Snell's law and simple optics."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromagrip.calibrate.lens.corners import View as Corners
from chromagrip.calibrate.lens.fit import calibrate_fisheye
from chromagrip.render import Camera, FisheyeCamera, PinholeCamera, View

FISHEYE = FisheyeCamera(
    width=641,
    height=483,
    focal=(151.3, 150.1),
    centre=(318.2, 243.7),
    distortion=(0.04, -0.012, 0.005, -0.0013),
)
PINHOLE = PinholeCamera(
    width=640,
    height=480,
    focal=(520.0, 517.0),
    centre=(322.7, 236.1),
    distortion=(-0.25, 0.09, 0.001, -0.0008, -0.01),
)
PLAIN = [
    FisheyeCamera(width=641, height=483, focal=(151.3, 151.3), centre=(318.2, 243.7)),
    PinholeCamera(width=640, height=480, focal=(520.0, 517.0), centre=(322.7, 236.1)),
]
CAMERAS = pytest.mark.parametrize(
    "camera", [FISHEYE, PINHOLE, *PLAIN], ids=lambda c: type(c).__name__
)


def scattered(camera: Camera, count: int) -> np.ndarray:
    """Points in front of a fingertip's camera; the pinhole's in its narrower view."""
    rng = np.random.default_rng(5)
    wide = isinstance(camera, FisheyeCamera)
    reach = 6e-3 if wide else 4e-3
    near = 1e-3 if wide else 6e-3
    points = rng.uniform([-reach, -reach, near], [reach, reach, 9e-3], (count, 3))
    points[0] = [0.0, 0.0, 7e-3]  # on the axis
    return points


@CAMERAS
def test_projection_and_jacobian_are_opencvs(camera: FisheyeCamera | PinholeCamera) -> None:
    points = scattered(camera, 50)
    (fx, fy), (cx, cy) = camera.focal, camera.centre
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    project = cv2.fisheye.projectPoints if isinstance(camera, FisheyeCamera) else cv2.projectPoints
    zero = np.zeros(3)
    expected, _ = project(points[:, None], zero, zero, matrix, np.array(camera.distortion))
    # OpenCV divides by z first; points far off the axis lose digits there.
    np.testing.assert_allclose(camera.project(points), expected[:, 0], atol=1e-9)
    jacobian = camera.jacobian(points)
    for k, nudge in enumerate(1e-8 * np.eye(3)):
        slope = (camera.project(points + nudge) - camera.project(points - nudge)) / 2e-8
        np.testing.assert_allclose(jacobian[:, :, k], slope, rtol=1e-5, atol=0.1)


@CAMERAS
def test_rays_invert_the_projection(camera: Camera) -> None:
    rng = np.random.default_rng(6)
    pixels = rng.uniform([150, 90], [490, 400], (6, 5, 2))  # within 90° of the fisheye's axis
    rays = camera.rays(pixels)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(camera.project(7e-3 * rays), pixels, atol=1e-9)
    np.testing.assert_allclose(camera.rays(np.array(camera.centre)), [0.0, 0.0, 1.0])
    points = scattered(camera, 30)
    along = points / np.linalg.norm(points, axis=1, keepdims=True)
    np.testing.assert_allclose(camera.rays(camera.project(points)), along, atol=1e-12)


def test_a_point_at_the_camera_s_height_is_seen_at_ninety_degrees() -> None:
    """z = 0 exactly, as the rim of the dome: no division by it."""
    camera = FISHEYE
    points = np.array([[8e-3, 0.0, 0.0], [0.0, 0.0, 8e-3]])
    k, right = camera.distortion, np.pi / 2
    bent = right * (1.0 + sum(c * right ** (2 * n) for n, c in enumerate(k, start=1)))
    pixels = camera.project(points)
    np.testing.assert_allclose(pixels[0], [318.2 + camera.focal[0] * bent, 243.7])
    np.testing.assert_allclose(pixels[1], [318.2, 243.7])
    np.testing.assert_allclose(camera.rays(pixels), points / 8e-3, atol=1e-12)
    assert np.isfinite(camera.jacobian(points)).all()


def test_a_pinhole_sees_nothing_behind_it_and_no_fisheye_folds() -> None:
    points = np.array([[1e-3, 0.0, -5e-3], [1e-3, 0.0, 0.0]])
    assert np.isnan(PINHOLE.project(points)).all()
    assert np.isnan(PINHOLE.jacobian(points)).all()
    with pytest.raises(ValueError, match=r"folds the fisheye's image within 90°"):
        replace(FISHEYE, distortion=(-0.3, 0.0, 0.0, 0.0))


def test_deviations_of_a_fitted_lens_are_those_of_the_whole_problem() -> None:
    """Against σ²·(JᵀJ)⁻¹ of lens and poses together, σ² by all numbers less all parameters."""
    rng = np.random.default_rng(4)
    board = np.column_stack([*map(np.ravel, np.meshgrid(range(4), range(3))), np.zeros(12)])
    board -= [1.5, 1.0, 0.0]
    lens = replace(FISHEYE, distortion=(0.04, -0.01, 0.0, 0.0))
    views = []
    for turn in ([0.5, 0, 0], [-0.5, 0.1, 0], [0, 0.6, 0.2], [0.1, -0.6, 0], [0.3, 0.3, 0.4]):
        shift = [*rng.uniform(-1.5, 1.5, 2), rng.uniform(2.0, 3.0)]
        pixels = lens.project(board @ cv2.Rodrigues(np.array(turn, float))[0].T + shift)
        noisy = pixels + 0.2 * rng.standard_normal((12, 2))
        views.append(Corners(name=str(turn), points=board, pixels=noisy))
    fit = calibrate_fisheye(views, (641, 483), {})
    free = np.count_nonzero(fit.deviations)
    start = np.concatenate([fit.camera.focal, fit.camera.centre, fit.camera.distortion])
    start = np.concatenate([start[:free], *(np.concatenate(pose) for pose in fit.poses)])

    def residuals(values: np.ndarray) -> np.ndarray:
        own = np.concatenate([values[:free], np.zeros(8 - free)])
        matrix = np.array([[own[0], 0.0, own[2]], [0.0, own[1], own[3]], [0.0, 0.0, 1.0]])
        off = []
        for pose, view in zip(values[free:].reshape(-1, 6), views, strict=True):
            seen, _ = cv2.fisheye.projectPoints(board[:, None], pose[:3], pose[3:], matrix, own[4:])
            off.append((seen[:, 0] - view.pixels).ravel())
        return np.concatenate(off)

    steps = 1e-6 * np.eye(len(start))
    slopes = [(residuals(start + h) - residuals(start - h)) / 2e-6 for h in steps]
    jacobian = np.stack(slopes, axis=1)
    variance = (residuals(start) ** 2).sum() / np.subtract(*jacobian.shape)
    deviations = np.sqrt(variance * np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    np.testing.assert_allclose(fit.deviations[:free], deviations[:free], rtol=1e-3)


EVEN = FisheyeCamera(width=640, height=480, focal=(152.8, 152.8), centre=(319.5, 239.5))
STRAIGHT = PinholeCamera(width=640, height=480, focal=(900.0, 900.0), centre=(319.5, 239.5))


def dome_view(position: float, index: float = 1.41) -> View:
    return View(camera=EVEN, position=position, port=6e-3, flat=False, index=index)


PAD = View(camera=STRAIGHT, position=-60e-3, port=-8e-3, flat=True, index=1.41)


def skin_points(count: int = 40) -> np.ndarray:
    rng = np.random.default_rng(3)
    theta, phi = rng.uniform(0.0, 1.2, count), rng.uniform(0.0, 2 * np.pi, count)
    radius = rng.uniform(6.5e-3, 8e-3, count)
    theta[0] = 0.0  # on the axis
    return radius[:, None] * np.column_stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    )


def points_of(view: View) -> np.ndarray:
    """Points of the skin: of a pad its z begins at the skin, and the port is below."""
    points = skin_points() - ([0.0, 0.0, 8e-3] if view.flat else [0.0, 0.0, 0.0])
    return points[points[:, 2] > -5e-3]


VIEWS = pytest.mark.parametrize(
    "view",
    [dome_view(-2e-3), dome_view(0.0), dome_view(1.5e-3), PAD],
    ids=str,
)


@VIEWS
def test_traced_rays_meet_the_points_they_show_and_a_jacobian_is_the_derivative(view: View) -> None:
    points = points_of(view)
    start, ray = view.trace(view.project(points))
    off = np.cross(points - start, ray)
    np.testing.assert_allclose(np.linalg.norm(off, axis=-1), 0.0, atol=1e-9)
    jacobian = view.jacobian(points)
    for k, nudge in enumerate(1e-6 * np.eye(3)):
        slope = (view.project(points + nudge) - view.project(points - nudge)) / 2e-6
        np.testing.assert_allclose(jacobian[:, :, k], slope, rtol=1e-4, atol=1.0)


@settings(max_examples=30)
@given(st.floats(-4e-3, 4e-3), st.floats(1.0, 2.0), st.floats(0.0, 60.0), st.booleans())
def test_rays_bend_by_snells_law(position: float, index: float, angle: float, flat: bool) -> None:
    view = replace(PAD, index=index) if flat else dome_view(position, index)
    pixel = np.array([319.5 + 152.8 * np.deg2rad(angle), 239.5])
    start, inside = view.trace(pixel)
    if not view.bends:
        return
    normal = np.array([0.0, 0.0, 1.0]) if flat else start / np.linalg.norm(start)
    at = start[2] if flat else np.linalg.norm(start)
    assert at == pytest.approx(view.port, rel=1e-9)
    outside = view.camera.rays(pixel)
    sines = [np.linalg.norm(np.cross(ray, normal)) for ray in (outside, inside)]
    assert sines[0] == pytest.approx(index * sines[1], abs=1e-9)
    # Bent in one plane, and not turned back.
    assert np.linalg.det(np.stack([outside, inside, normal])) == pytest.approx(0.0, abs=1e-9)
    assert (outside @ normal) * (inside @ normal) > 0.0


def test_silicone_matters_off_the_centre_of_the_port_alone() -> None:
    points = skin_points()
    np.testing.assert_array_equal(dome_view(0.0).project(points), EVEN.project(points))
    bent, straight = dome_view(-1.5e-3).project(points), dome_view(-1.5e-3, 1.0).project(points)
    assert 1.0 < np.linalg.norm(bent - straight, axis=-1).max() < 30.0
    np.testing.assert_allclose(
        straight, EVEN.project(points + np.array([0.0, 0.0, 1.5e-3])), atol=1e-9
    )


def test_a_flat_port_brings_things_nearer_by_the_index() -> None:
    """Near the axis a point d behind the surface is seen as if d/n behind it."""
    point = np.array([0.05e-3, -0.02e-3, 0.0])  # 8 mm behind the surface
    apparent = 52e-3 + 8e-3 / 1.41
    expected = 319.5 + 900.0 * point[0] / apparent, 239.5 + 900.0 * point[1] / apparent
    np.testing.assert_allclose(PAD.project(point), expected, atol=1e-4)
