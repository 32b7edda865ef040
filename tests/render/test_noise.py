import numpy as np
import pytest

from chromagrip.render import add_noise

SHAPE = (201, 303, 3)


def noise(sigma: float, seed: int, index: int) -> np.ndarray:
    image = np.full(SHAPE, 128, dtype=np.uint8)
    add_noise(image, sigma, seed, index)
    return image.astype(float) - 128.0


@pytest.mark.parametrize("sigma", [1.0, 2.0, 5.0])
def test_noise_is_white_and_of_the_stated_size(sigma: float) -> None:
    values = noise(sigma, 1, 2)
    count = values.size
    assert abs(values.mean()) < 4 * sigma / np.sqrt(count)
    # Rounding to whole levels adds a variance of 1/12.
    assert values.std() == pytest.approx(np.sqrt(sigma**2 + 1 / 12), rel=0.01)
    for axis in (0, 1, 2):
        ahead, behind = np.delete(values, 0, axis), np.delete(values, -1, axis)
        correlation = (ahead * behind).mean() / values.var()
        assert abs(correlation) < 5 / np.sqrt(ahead.size)


def test_frames_and_seeds_do_not_resemble_each_other() -> None:
    base = noise(2.0, 1, 2)
    assert (base == noise(2.0, 1, 2)).all()
    for other in (noise(2.0, 1, 3), noise(2.0, 2, 2), noise(2.0, 2, 1)):
        assert abs((base * other).mean() / base.var()) < 5 / np.sqrt(base.size)


def test_no_noise_and_no_overflow() -> None:
    white = np.full(SHAPE, 255, dtype=np.uint8)
    add_noise(white, 0.0, 0, 0)
    assert (white == 255).all()
    add_noise(white, 3.0, 0, 0)
    assert white.min() > 235
