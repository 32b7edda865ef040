import numpy as np

from chromagrip.render import load_sensor
from chromagrip.tracking.unmixing import (
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
    rough = rough_ground(image, 25, bright=False)
    plain = plain_pixels(dye_densities(image, rough, unmixing_matrix(DYES)), everywhere, 2)
    assert 0.3 < plain.mean() < 0.75
    ground = estimate_ground(image, plain, 20.0)
    error = ground / truth - 1.0
    assert np.sqrt((error**2).mean()) < 0.005
    assert abs(error.mean()) < 0.002
