"""Tests of the frames that went through a codec."""

import itertools

import numpy as np
import pytest

from chromagrip.measure.worlds.compressed import Codec, h264, h265, jpeg, mjpeg, raw
from chromagrip.render import Frame

pytest.importorskip("av")


def _frames(height: int, width: int, count: int) -> list[Frame]:
    """Frames of a pattern that moves by a pixel a frame."""
    y, x = np.mgrid[:height, :width].astype(float)
    waves = [np.sin(0.3 * (x + k))[..., None] * [40.0, 60.0, 20.0] for k in range(count)]
    noise = np.random.default_rng(1).normal(0.0, 2.0, (count, height, width, 3))
    levels = [128.0 + wave + y[..., None] / height for wave in waves] + noise
    return [Frame(image=np.rint(v).astype(np.uint8), time=0.1 * k) for k, v in enumerate(levels)]


def _error(codec: Codec, frames: list[Frame]) -> float:
    """RMS difference of the frames from those before [grey levels]."""
    after = codec(frames)
    assert [frame.time for frame in after] == [frame.time for frame in frames]
    pairs = zip(frames, after, strict=True)
    return float(np.sqrt(np.mean([(a.image.astype(float) - b.image) ** 2 for a, b in pairs])))


@pytest.mark.parametrize(
    "codecs",
    [
        [h264(0), h264(12), h264(23), h264(35)],
        [h264(12, "yuv444p"), h264(35, "yuv444p")],
        [h265(12), h265(28)],
        [mjpeg(2), mjpeg(5), mjpeg(15)],
        [jpeg(98), jpeg(80), jpeg(40)],
    ],
)
def test_error_grows_as_quality_falls(codecs: list[Codec]) -> None:
    errors = [_error(codec, _frames(64, 96, 5)) for codec in codecs]
    assert all(a < b for a, b in itertools.pairwise(errors))


def test_no_compression() -> None:
    assert _error(raw, _frames(32, 32, 2)) == 0.0
    # What is left is the rounding of one colour space to the other.
    assert _error(h264(0, "yuv444p"), _frames(32, 32, 3)) < 1.0


def test_odd_size() -> None:
    """The encoder's added row and column are taken away again."""
    frames = _frames(33, 47, 3)
    assert all(frame.image.shape == (33, 47, 3) for frame in h264(10)(frames))
    assert _error(h264(0, "yuv444p"), frames) < 1.0
    assert h264(10)([]) == []
