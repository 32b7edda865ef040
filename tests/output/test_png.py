"""Pictures that are packed here come back in other people's readers."""

import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from chromagrip.output.png import encode_png
from chromagrip.output.png_kernels import code_lengths


def decoded(data: bytes, grey: bool) -> np.ndarray:
    """The picture as OpenCV, which is libpng, reads it."""
    flag = cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR_RGB
    image = cv2.imdecode(np.frombuffer(data, np.uint8), flag)
    assert image is not None
    return image


def packed(data: bytes) -> bytes:
    """What zlib made of the rows."""
    at = data.index(b"IDAT")
    return data[at + 4 : at + 4 + int.from_bytes(data[at - 4 : at], "big")]


SIDE = st.integers(1, 9)


@settings(max_examples=25)
@given(arrays(np.uint8, st.tuples(SIDE, SIDE) | st.tuples(SIDE, SIDE, st.just(3))))
def test_a_picture_comes_back_as_it_was(image: np.ndarray) -> None:
    data = encode_png(image)
    np.testing.assert_array_equal(decoded(data, image.ndim == 2), image)
    # Adler's checksum is zlib's to verify.
    rows = np.frombuffer(zlib.decompress(packed(data)), np.uint8).reshape(len(image), -1)
    assert (rows[:, 0] == 2).all()


@pytest.mark.parametrize("shape", [(120, 160, 3), (1, 30_000, 3), (3000, 1), (70, 1024)])
def test_large_and_extreme_pictures_come_back(shape: tuple[int, ...]) -> None:
    """Rows longer than a block, bytes that cannot be packed, one value, and two far apart."""
    rng = np.random.default_rng(1)
    for image in (
        np.clip(rng.normal(120.0, 2.0, shape), 0, 255),
        rng.integers(0, 256, shape),
        np.full(shape, 7),
        255 * rng.integers(0, 2, shape),
    ):
        wanted = image.astype(np.uint8)
        np.testing.assert_array_equal(decoded(encode_png(wanted), wanted.ndim == 2), wanted)


def test_noise_takes_no_more_room_than_zlib_gives_it() -> None:
    """Huffman's codes without matches, as zlib makes them at its own leisure; entropy below."""
    image = np.clip(np.random.default_rng(2).normal(120.0, 2.0, (240, 320, 3)), 0, 255)
    data = packed(encode_png(image.astype(np.uint8)))
    rows = zlib.decompress(data)
    packer = zlib.compressobj(9, zlib.DEFLATED, 15, 9, zlib.Z_HUFFMAN_ONLY)
    assert len(data) < 1.01 * len(packer.compress(rows) + packer.flush())
    share = np.bincount(np.frombuffer(rows, np.uint8)) / len(rows)
    entropy = -(share[share > 0] * np.log2(share[share > 0])).sum() / 8.0
    assert entropy * len(rows) < len(data) < 1.02 * entropy * len(rows)


COUNTS = st.lists(st.integers(0, 10**6), min_size=2, max_size=257)
FIBONACCI = [1, 1]
while len(FIBONACCI) < 40:  # each joins all before it, so that codes would be too long
    FIBONACCI.append(FIBONACCI[-1] + FIBONACCI[-2])


@settings(max_examples=25)
@given(COUNTS.filter(lambda counts: np.count_nonzero(counts) > 1) | st.just(FIBONACCI))
def test_codes_are_whole_and_as_short_as_can_be(counts: list[int]) -> None:
    """Kraft's sum is 1; within a bit of the entropy where no code is cut short."""
    lengths = np.zeros(len(counts), dtype=np.int64)
    code_lengths(np.array(counts), lengths)
    used = np.array(counts) > 0
    assert (lengths[~used] == 0).all()
    assert lengths.max() <= 15
    assert (counts != FIBONACCI) or lengths.max() == 15
    assert (0.5 ** lengths[used]).sum() == 1.0
    share = np.array(counts)[used] / sum(counts)
    if lengths.max() < 15:
        assert (share * lengths[used]).sum() <= -(share * np.log2(share)).sum() + 1.0
