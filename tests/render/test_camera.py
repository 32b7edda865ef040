import cv2
import numpy as np

from chromagrip.render import FisheyeCamera

LENS = FisheyeCamera(width=641, height=483, focal=151.3, centre=(318.2, 243.7))


def scattered(count: int) -> np.ndarray:
    rng = np.random.default_rng(5)
    points = rng.uniform([-6e-3, -6e-3, 1e-3], [6e-3, 6e-3, 8e-3], (count, 3))
    points[0] = [0.0, 0.0, 7e-3]  # on the axis
    return points


def test_projection_is_opencvs_equidistant_fisheye() -> None:
    points = scattered(50)
    matrix = np.array([[LENS.focal, 0, LENS.centre[0]], [0, LENS.focal, LENS.centre[1]], [0, 0, 1]])
    zero = np.zeros(3)
    # OpenCV divides by z first; points far off the axis lose digits there.
    expected, _ = cv2.fisheye.projectPoints(points[:, None], zero, zero, matrix, np.zeros(4))
    np.testing.assert_allclose(LENS.project(points), expected[:, 0], atol=1e-9)


def test_jacobian_is_the_derivative_of_the_projection() -> None:
    points = scattered(40)
    jacobian = LENS.jacobian(points)
    for k, nudge in enumerate(1e-8 * np.eye(3)):
        slope = (LENS.project(points + nudge) - LENS.project(points - nudge)) / 2e-8
        np.testing.assert_allclose(jacobian[:, :, k], slope, rtol=1e-4, atol=1.0)


def test_directions_invert_the_projection() -> None:
    rng = np.random.default_rng(6)
    pixels = rng.uniform([100, 50], [540, 430], (30, 2))
    theta, phi = LENS.directions(pixels).T
    points = 7e-3 * np.column_stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    )
    np.testing.assert_allclose(LENS.project(points), pixels, atol=1e-9)


def test_a_point_at_the_camera_s_height_is_seen_at_ninety_degrees() -> None:
    """z = 0 exactly, as the rim of the dome: no division by it."""
    pixel = LENS.project(np.array([[8e-3, 0.0, 0.0], [0.0, 0.0, 8e-3]]))
    np.testing.assert_allclose(pixel[0], [318.2 + 151.3 * np.pi / 2, 243.7])
    np.testing.assert_allclose(pixel[1], [318.2, 243.7])
