"""The cameras are OpenCV's, and their derivatives and rays are those of their projection."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from chromagrip.render import Camera, FisheyeCamera, PinholeCamera, load_sensor
from chromagrip.render.optics.projection_kernels import angle_to_axis, project_lanes

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
def test_projection_is_opencvs(camera: FisheyeCamera | PinholeCamera) -> None:
    points = scattered(camera, 50)
    (fx, fy), (cx, cy) = camera.focal, camera.centre
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    project = cv2.fisheye.projectPoints if isinstance(camera, FisheyeCamera) else cv2.projectPoints
    zero = np.zeros(3)
    expected, _ = project(points[:, None], zero, zero, matrix, np.array(camera.distortion))
    # OpenCV divides by z first; points far off the axis lose digits there.
    np.testing.assert_allclose(camera.project(points), expected[:, 0], atol=1e-9)


@CAMERAS
def test_jacobian_is_the_derivative_of_the_projection(camera: Camera) -> None:
    points = scattered(camera, 40)
    jacobian = camera.jacobian(points)
    assert jacobian.shape == (40, 2, 3)
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


@CAMERAS
def test_rays_of_points_lead_to_them(camera: Camera) -> None:
    points = scattered(camera, 30)
    along = points / np.linalg.norm(points, axis=1, keepdims=True)
    np.testing.assert_allclose(camera.rays(camera.project(points)), along, atol=1e-12)


@pytest.mark.parametrize("camera", [FISHEYE, PLAIN[0]], ids=["distorted", "plain"])
def test_a_point_at_the_camera_s_height_is_seen_at_ninety_degrees(camera: FisheyeCamera) -> None:
    """z = 0 exactly, as the rim of the dome: no division by it."""
    points = np.array([[8e-3, 0.0, 0.0], [0.0, 0.0, 8e-3]])
    k, right = camera.distortion, np.pi / 2
    bent = right * (1.0 + sum(c * right ** (2 * n) for n, c in enumerate(k, start=1)))
    pixels = camera.project(points)
    np.testing.assert_allclose(pixels[0], [318.2 + camera.focal[0] * bent, 243.7])
    np.testing.assert_allclose(pixels[1], [318.2, 243.7])
    np.testing.assert_allclose(camera.rays(pixels), points / 8e-3, atol=1e-12)
    assert np.isfinite(camera.jacobian(points)).all()


def test_a_pinhole_sees_nothing_behind_it() -> None:
    points = np.array([[1e-3, 0.0, -5e-3], [1e-3, 0.0, 0.0]])
    assert np.isnan(PINHOLE.project(points)).all()
    assert np.isnan(PINHOLE.jacobian(points)).all()


def test_a_fisheye_that_folds_is_refused() -> None:
    with pytest.raises(ValueError, match=r"folds the fisheye's image within 90°"):
        FisheyeCamera(
            width=641,
            height=483,
            focal=(151.3, 151.3),
            centre=(318.2, 243.7),
            distortion=(-0.3, 0.0, 0.0, 0.0),
        )


def test_angles_to_the_axis_are_those_of_atan2() -> None:
    rng = np.random.default_rng(5)
    rho, z = abs(rng.standard_normal(20000)), rng.standard_normal(20000)
    rho[:5], z[:5] = [0.0, 0.0, 1.0, 1.0, 1.0], [1.0, -1.0, 0.0, 1.0, -1.0]
    z[5:2000] *= 1e-9
    rho[2000:4000] *= 1e-9
    for r, up in zip(rho, z, strict=True):
        found = angle_to_axis(r, up)
        assert found == pytest.approx(math.atan2(r, up), rel=5e-16, abs=1e-300)
    assert math.isnan(angle_to_axis(math.nan, 1.0))


def test_points_are_projected_together_as_alone() -> None:
    rng = np.random.default_rng(6)
    points = rng.uniform(-1.0, 1.0, (37, 3)) * 10e-3 + [0.0, 0.0, 3e-3]
    for name in ("thesis", "flat-2019"):
        view = load_sensor(name).view
        for own in (view, replace(view, position=-2e-3, port=6e-3, index=1.41)):
            lanes = points.T.copy()
            project_lanes(*lanes, own.surface, own.camera.lens)
            expected = own.project(points)
            np.testing.assert_array_equal(lanes[:2].T, expected)
