"""Noise of a camera is white and normal, and each frame and seed has its own."""

import numpy as np
import pytest
from scipy.stats import chi2, norm

from chromagrip.render import add_noise
from chromagrip.render.flaws.noise import offset_levels

SHAPE = (201, 303, 3)


def noise(sigma: float, seed: int, index: int) -> np.ndarray:
    image = np.full(SHAPE, 128, dtype=np.uint8)
    add_noise(image, sigma, seed, index)
    return image.astype(float) - 128.0


@pytest.mark.parametrize("sigma", [0.2, 4.0, 50.0])
def test_the_histogram_is_that_of_a_rounded_normal_number(sigma: float) -> None:
    levels, counts = np.unique(offset_levels(sigma), return_counts=True)
    assert (levels == -levels[::-1]).all()
    assert (counts == counts[::-1]).all()
    share = norm.cdf((levels + 0.5) / sigma) - norm.cdf((levels - 0.5) / sigma)
    assert abs(counts - share * counts.sum()).max() <= 1.5
    if sigma > 10.0:  # not the whole of it is between black and white
        return
    values = np.concatenate([noise(sigma, 5, index).ravel() for index in range(2)])
    # Rounding to whole levels adds a variance of 1/12, if a level is not much wider than the noise.
    if sigma >= 1.0:
        assert values.std() == pytest.approx(np.sqrt(sigma**2 + 1 / 12), rel=0.01)
    expected = np.array([share[levels == v].sum() for v in levels]) * values.size
    found = np.array([(values == level).sum() for level in levels])
    often = expected > 20.0
    square = ((found - expected) ** 2 / expected)[often].sum()
    assert square < chi2.ppf(1.0 - 1e-4, often.sum())


def test_no_pixel_tells_of_others_nearby_or_in_other_frames() -> None:
    count = 12
    frames = np.stack([noise(2.0, 3, index) for index in range(count)])
    limit = 5.0 / np.sqrt(frames.size)
    flat = frames.reshape(count, -1) / frames.std()
    # Neighbours, channels, rows, what is a run apart; then the same pixels some frames later.
    for lag in (1, 3, 6, SHAPE[1] * 3, 2047, 2048, 2049):
        assert abs((flat[:, lag:] * flat[:, :-lag]).mean()) < limit, lag
    for later in (1, 2, 7):
        assert abs((flat[later:] * flat[:-later]).mean()) < 2.0 * limit, later
    for seed in (2, 4):
        assert abs((flat[0] * noise(2.0, seed, 0).ravel() / 2.0).mean()) < 2.0 * limit * 2.0
    # The mean of frames is as small as that of independent ones, in each pixel and in all.
    mean = flat.mean(axis=0)
    assert mean.var() * count == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / mean.size))
    assert abs(mean.mean()) < limit
    # So are the sums of blocks of pixels, which a tracker takes.
    blocks = flat[:, : flat.shape[1] // 100 * 100].reshape(count, -1, 100).sum(axis=-1) / 10.0
    assert blocks.var() == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / blocks.size))


def test_bytes_of_a_seed_are_the_same_everywhere() -> None:
    image = np.full((3, 700, 3), 100, dtype=np.uint8)
    add_noise(image, 2.0, 7, 9)
    some = image.reshape(-1)[[0, 1, 2, 2047, 2048, 2049, 6299]]
    assert some.tolist() == [104, 100, 98, 99, 100, 99, 97]


def test_noise_goes_into_another_image_and_does_not_overflow() -> None:
    image = np.arange(np.prod(SHAPE), dtype=np.uint8).reshape(SHAPE)
    clean, out = image.copy(), np.empty_like(image)
    for sigma in (0.0, 3.0):
        add_noise(image, sigma, 4, 1, out=out)
        assert (image == clean).all()
        again = image.copy()
        add_noise(again, sigma, 4, 1)
        assert (out == again).all()
        assert (again != clean).any() == (sigma > 0.0)
        assert abs(out.astype(int) - clean).max() <= 5 * sigma
    with pytest.raises(ValueError, match="contiguous"):
        add_noise(image[:, ::2], 1.0, 0, 0)
