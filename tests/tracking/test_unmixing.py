import numpy as np
from scipy.special import ndtr

from chromagrip.render import load_sensor
from chromagrip.tracking.unmixing import (
    dye_coverages,
    dye_densities,
    estimate_ground,
    plain_pixels,
    rough_ground,
    unmixing_matrix,
)

DYES = load_sensor("thesis").transmittance


def test_densities_are_blind_to_shading_and_to_the_other_dye() -> None:
    """Half a ramp of light and both dyes over each other: 0 and 1 all the same."""
    ramp = np.linspace(0.3, 1.0, 40)[:, None] * np.array([1.0, 0.97, 0.9])
    pure = np.stack([np.ones(3), DYES[0], DYES[1], DYES[0] * DYES[1]])
    image = ramp[:, None] * pure
    ground = np.broadcast_to(ramp[:, None], image.shape)
    densities = dye_densities(image, ground, unmixing_matrix(DYES))
    np.testing.assert_allclose(densities[0], np.tile([0, 1, 0, 1], (40, 1)), atol=1e-9)
    np.testing.assert_allclose(densities[1], np.tile([0, 0, 1, 1], (40, 1)), atol=1e-9)


def test_ground_is_found_between_the_markers() -> None:
    """A shaded ground under dots of both dyes is recovered under the dots, too."""
    rng = np.random.default_rng(4)
    y, x = np.mgrid[:160, :200]
    light = 0.9 - 0.3 * ((x - 90) / 100) ** 2 - 0.2 * ((y - 85) / 80) ** 2
    truth = light[:, :, None] * np.array([1.0, 0.98, 0.95])
    image = truth.copy()
    for cy in range(10, 160, 20):
        for cx in range(10, 200, 20):
            dot = (x - cx) ** 2 + (y - cy) ** 2 < 25
            image[dot] *= DYES[(cx + cy) // 20 % 2]
    image = image + rng.normal(0, 0.01, image.shape)
    everywhere = np.ones((160, 200), dtype=bool)
    rough, field = rough_ground(image.astype(np.float32), 25, everywhere, bright=False)
    assert field.all()
    plain = plain_pixels(dye_densities(image, rough, unmixing_matrix(DYES)), everywhere, 2)
    assert 0.3 < plain.mean() < 0.75
    ground = estimate_ground(image, plain, 20.0)
    error = ground / truth - 1.0
    assert np.sqrt((error**2).mean()) < 0.005
    assert abs(error.mean()) < 0.002


def blurred_edges(first: float, second: float) -> np.ndarray:
    """Light over the ground's of two layers' edges, blurred by 1 px, which end at x, (40, 60, 3).

    A layer covers what lies left of its edge; both cover what lies left of both.
    """
    x = np.arange(60.0)
    c0, c1, both = (ndtr(at - x) for at in (first, second, min(first, second)))
    light = 1.0 - np.outer(c0, 1 - DYES[0]) - np.outer(c1, 1 - DYES[1])
    light += np.outer(both, (1 - DYES[0]) * (1 - DYES[1]))
    return np.broadcast_to(light, (40, 60, 3)).astype(np.float32)


def test_coverages_are_exact_where_a_lens_blurs_edges() -> None:
    """Edges lie at the half of a coverage, wherever the other layer's edge is."""
    x = np.arange(60.0)
    for second in (30.3, 31.1, 28.2, 45.0, -10.0):
        coverage = dye_coverages(blurred_edges(30.3, second), DYES)
        np.testing.assert_allclose(coverage[0, 20], ndtr(30.3 - x), atol=5e-3)
        np.testing.assert_allclose(coverage[1, 20], ndtr(second - x), atol=5e-3)
    alone = dye_coverages(blurred_edges(30.3, -10.0), DYES[:1])
    np.testing.assert_allclose(alone[0, 20], ndtr(30.3 - x), atol=1e-5)


def test_noise_covers_nothing() -> None:
    """On the mean, neither on the ground nor where both layers are."""
    rng = np.random.default_rng(8)
    for light in (np.ones(3), DYES[0] * DYES[1]):
        noise = rng.normal(0.0, 0.02 * np.sqrt(light), (200, 200, 3))
        coverage = dye_coverages((light + noise).astype(np.float32), DYES)
        np.testing.assert_allclose(coverage.mean(axis=(1, 2)), float(light[0] < 1.0), atol=0.02)
