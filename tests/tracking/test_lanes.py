"""Sums of the fit: their order is written down, and no compiler changes it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromagrip.compiled import njit
from chromagrip.tracking.fit.kernels.lanes import LANES
from chromagrip.tracking.fit.kernels.light_kernels import dot, weighted_dot
from chromagrip.tracking.fit.kernels.pixel_kernels import BUFFER, ROOM

ROWS = (23, 14, 17)


def filled(blocks: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A buffer, and what its rows hold: numbers of which every order has another sum."""
    rng = np.random.default_rng(seed)
    size = (len(ROWS), blocks * LANES)
    numbers = (rng.standard_normal(size) * np.exp(rng.uniform(-6.0, 6.0, size))).astype(np.float32)
    buffer = np.full(BUFFER, np.nan, dtype=np.float32)
    for row, values in zip(ROWS, numbers, strict=True):
        buffer[row * ROOM :][: values.size] = values
    return buffer, numbers


def in_order(products: np.ndarray) -> float:
    """Every lane by itself, then halves of the lanes: NumPy adds two rows in no other way."""
    lanes = np.zeros(LANES, dtype=np.float32)
    for part in products.reshape(-1, LANES):
        lanes = lanes + part
    while len(lanes) > 1:
        lanes = lanes[: len(lanes) // 2] + lanes[len(lanes) // 2 :]
    return float(lanes[0])


@settings(max_examples=15)
@given(blocks=st.integers(1, (ROOM - 1) // LANES), seed=st.integers(0, 2**32 - 1))
def test_sums_are_taken_in_the_order_that_is_written_down(blocks: int, seed: int) -> None:
    buffer, (a, b, c) = filled(blocks, seed)
    count = blocks * LANES
    assert dot(buffer, ROWS[0], ROWS[1], count) == in_order(a * b)
    assert weighted_dot(buffer, *ROWS, count) == in_order(a * b * c)


def test_no_kernel_may_be_compiled_to_another_order() -> None:
    with pytest.raises(TypeError, match="no kernel is compiled with fastmath"):
        njit(fastmath=True)
