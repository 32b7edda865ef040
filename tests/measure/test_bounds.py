"""The Cramér–Rao bound of positions and sizes, against analysis and brute force."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from chromagrip.measure.limits.kernels import fisher_information, pair_information
from chromagrip.measure.limits.positions import bounds, position_limits
from chromagrip.render import load_sensor
from chromagrip.render.colour import decode_srgb, encode_srgb
from chromagrip.render.drawing.coverage import edge_width
from chromagrip.render.ground import ground_image
from chromagrip.render.membrane import rest_membrane

SENSOR = load_sensor("thesis")
BLUR = SENSOR.camera.blur_px
GROUND = np.broadcast_to(decode_srgb(np.array([250.0, 249.0, 248.0])), (36, 36, 3)).copy()


def information(kernel: object, shapes: np.ndarray, absorbed: np.ndarray, ground: np.ndarray):
    inverses = np.linalg.inv(np.swapaxes(shapes[:, :, 1:], -1, -2))
    return kernel(shapes, inverses, edge_width(BLUR), absorbed, ground, 1.0)


def discs(centres: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Shapes (2, M, 3, 2) of pairs of discs (M, 2, …)."""
    shapes = np.zeros((2, len(centres), 3, 2))
    shapes[:, :, 0] = np.swapaxes(centres, 0, 1)
    shapes[:, :, 1:] = radii.T[..., None, None] * np.eye(2)
    return shapes


def test_limit_of_one_disc_in_one_channel_is_the_known_one() -> None:
    """σ/A·√(2s/(√π R)), for a disc so faint that its edge keeps its shape in grey levels."""
    absorbed = np.array([[0.0, 0.02, 0.0], [0.0, 0.0, 0.0]])
    contrast = float(encode_srgb(0.5) - encode_srgb(0.5 * 0.98))
    for radius in (5.0, 8.0):
        shapes = discs(np.array([[[20.3, 19.8]] * 2]), np.array([[radius] * 2]))
        shapes[1] = np.nan
        ground = np.full((40, 42, 3), 0.5)
        found = bounds(information(fisher_information, shapes, absorbed, ground), 2.0)
        known = 2.0 / contrast * np.sqrt(2 * edge_width(BLUR) / (np.sqrt(np.pi) * radius))
        assert found[0, 0] == pytest.approx(known, rel=0.03)
        assert np.isnan(found[1]).all()


def brute_levels(centres: np.ndarray, radii: np.ndarray, fine: int, soft: bool) -> np.ndarray:
    """Levels of pairs (M, 2, 2) of discs: pixels sampled fine² times, then blurred."""
    size = len(GROUND)
    y, x = (np.mgrid[: size * fine, : size * fine] + 0.5) / fine - 0.5
    light = np.ones((size * fine, size * fine, 3))
    for pair, sizes in zip(centres, radii, strict=True):
        for (cx, cy), radius, dye in zip(pair, sizes, SENSOR.transmittance, strict=True):
            inside = radius - np.hypot(x - cx, y - cy)
            covered = np.clip(fine * inside + 0.5, 0.0, 1.0) if soft else inside > 0.0
            light *= 1.0 - covered[..., None] * (1.0 - dye)
    light = np.asarray(cv2.GaussianBlur(light, (0, 0), BLUR * fine))
    return encode_srgb(GROUND * light.reshape(size, fine, size, fine, 3).mean(axis=(1, 3)))


def brute_information(
    centres: np.ndarray, radii: np.ndarray, fine: int, soft: bool, step: float
) -> np.ndarray:
    """Of (x, y, log size) of both discs of the first pair, shape (6, 6)."""
    slopes = []
    for layer in (0, 1):
        for axis in range(3):
            levels = []
            for sign in (step, -step):
                moved, grown = centres.copy(), radii.copy()
                if axis < 2:
                    moved[0, layer, axis] += sign
                else:
                    grown[0, layer] *= np.exp(sign)
                levels.append(brute_levels(moved, grown, fine, soft).ravel())
            slopes.append((levels[0] - levels[1]) / (2 * step))
    return np.array(slopes) @ np.array(slopes).T


@pytest.mark.parametrize(
    "apart", [pytest.param((0.0, 0.0), marks=pytest.mark.studies), (7.0, -2.0)]
)
def test_bound_of_a_pair_is_that_of_brute_force(apart: tuple[float, float]) -> None:
    """Also with a neighbour whose blurred edge meets the outer marker's."""
    outer = np.array([15.2, 16.1])
    centres = np.array([[outer, outer + apart], [[5.0, 14.0]] * 2])
    absorbed, places = 1.0 - SENSOR.transmittance, np.ix_([0, 1, 3, 4], [0, 1, 3, 4])
    radii = np.array([[4.8, 5.1]])
    brute = brute_information(centres[:1], radii, 8, True, 0.02)
    found = information(pair_information, discs(centres[:1], radii), absorbed, GROUND)[0]
    np.testing.assert_allclose(*(np.diag(np.linalg.inv(i)) for i in (found, brute)), rtol=0.06)
    radii = np.full((2, 2), 4.8)
    brute = bounds(brute_information(centres, radii, 16, False, 1 / 16)[places][None], 2.0)
    found = bounds(information(fisher_information, discs(centres, radii), absorbed, GROUND), 2.0)
    np.testing.assert_allclose(found[:, 0], brute[:, 0], rtol=0.05)


def test_limit_goes_with_noise_and_contrast() -> None:
    membrane = rest_membrane(SENSOR)
    ground = ground_image(SENSOR).astype(float)
    base = position_limits(SENSOR, membrane, ground, 2.0)
    assert 0.004 < np.median(base) < 0.008  # three channels beat the 0.0065 px of one
    np.testing.assert_allclose(position_limits(SENSOR, membrane, ground, 6.0), 3.0 * base)
    np.testing.assert_allclose(
        position_limits(SENSOR, membrane, ground, 2.0, contrast=0.5), 2.0 * base
    )
    assert (position_limits(SENSOR, membrane, 0.6 * ground, 2.0) > base).all()
    assert (position_limits(SENSOR, membrane, ground, 2.0, defocus=1.0) > base).all()
    alone = membrane.centres.copy()
    alone[1] = np.nan
    lone = position_limits(SENSOR, replace(membrane, centres=alone), ground, 2.0)
    assert np.isnan(lone[1]).all()
    assert (lone[0] < base[0]).all()  # nothing else to tell it from, and more light
