"""What the tracker sees of lossy compression, and what it then says of its errors."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from chromagrip.measure.worlds.compressed import h264, jpeg, raw
from chromagrip.measure.worlds.track_compressed import compressed, stated_errors
from chromagrip.measure.worlds.track_scenes import SCENES, Sequence, sequence
from chromagrip.measure.worlds.track_scores import Followed, follow
from chromagrip.render import LAYERS, Frame
from chromagrip.tracking.fit.compression import (
    FinePart,
    compression,
    deviations,
    fine_part,
    flat_blocks,
)
from chromagrip.tracking.fit.settings import CompressionSettings

#: Frames of the motion: the press.
FRAMES = 8
CODECS = {
    "raw": raw,
    "crf 12": h264(12),
    "crf 30": h264(30),
    "444": h264(12, "yuv444p"),
    "jpeg 90": jpeg(90),
}


def flat(noise: float, colour: float = 1.0) -> Frame:
    """Picture of one grey with noise, of whose colour a share is left."""
    rng = np.random.default_rng(3)
    levels = rng.normal(0.0, noise, (240, 320, 3))
    mean = levels.mean(axis=2, keepdims=True)
    return Frame(image=np.rint(128.0 + mean + colour * (levels - mean)).astype(np.uint8), time=0.0)


@pytest.mark.parametrize("noise", [0.5, 1.0, 2.0, 8.0])
def test_white_noise_is_measured(noise: float) -> None:
    frame = flat(noise)
    rounded = np.hypot(noise, np.sqrt(1.0 / 12.0))
    # The flattest blocks of a single frame show a little less than the others do.
    assert fine_part(frame.image, flat_blocks([frame])) == pytest.approx([rounded] * 3, rel=0.25)
    other = fine_part(flat(noise).image[::-1], flat_blocks([frame]))
    assert other == pytest.approx([rounded] * 3, rel=0.12)


@pytest.mark.parametrize("noise", [0.0, 0.5, 2.0, 8.0])
@pytest.mark.parametrize("residual", [0.8, 1.0, 1.4])
def test_noise_alone_is_no_compression(noise: float, residual: float) -> None:
    """Also where the model leaves some more than noise."""
    frame = flat(noise)
    seen = fine_part(frame.image, flat_blocks([frame]))
    assert compression(residual * np.hypot(noise, 0.29), seen) == 1.0


def test_large_residuals_beside_white_noise_are_no_compression() -> None:
    """As of a shape that the model does not have."""
    assert compression(20.0, FinePart(2.0, 2.0, 2.0)) == 1.0
    assert compression(np.inf, FinePart(0.0, 0.0, 0.0)) == 1.0
    assert compression(np.nan, FinePart(0.0, 0.0, 0.0)) == 1.0


def test_less_noise_and_larger_residuals_are_more_compression() -> None:
    kept, lost = FinePart(1.5, 0.1, 1.0), FinePart(0.1, 0.1, 1.0)
    assert 1.0 < compression(6.0, kept) < compression(6.0, lost) < compression(9.0, lost)


def test_the_ratio_that_shows_compression_is_a_setting() -> None:
    lost = FinePart(0.1, 0.1, 1.0)
    assert compression(2.0, lost) > 1.0
    assert compression(2.0, lost, CompressionSettings(different=10.0)) == 1.0
    assert compression(2.0, lost, CompressionSettings(least=5.8)) == 2.0 * compression(2.0, lost)


def test_only_what_moved_is_less_certain() -> None:
    factors = deviations(6.0, np.array([0.0, 0.5, 50.0]))
    assert (factors[0] == 1.0).all()
    assert (np.diff(factors, axis=0) > 0.0).all()
    # Error of the inner layer's place over what is stated for a marker that does not move.
    assert factors[2, 3] == pytest.approx(np.sqrt(1.0 + 36.0), rel=1e-3)


@lru_cache(maxsize=1)
def clean() -> Sequence:
    return sequence(SCENES["clean"], FRAMES, limits=False)


@lru_cache(maxsize=8)
def coded(name: str) -> tuple[Sequence, Followed]:
    """The clean scene through a codec, rest and press as one video, and its tracks."""
    scene, codec = clean(), CODECS[name]
    return (passed := compressed(scene, codec)), follow("fit", passed)


def level(name: str) -> float:
    return float(np.median([tracks.compression for tracks in coded(name)[1].tracks]))


@pytest.mark.parametrize("told", [0.7, 1.0, 1.3])
def test_tracks_of_uncompressed_pictures(told: float) -> None:
    scene = clean()
    short = replace(scene, noise=told * scene.noise, shots=scene.shots[-3:])
    followed = follow("fit", short)
    assert [t.compression for t in (followed.rest, *followed.tracks)] == [1.0] * 4


@pytest.mark.stages
def test_compression_grows_with_the_rate_factor() -> None:
    pytest.importorskip("av")
    assert level("raw") == 1.0
    assert 1.0 < level("crf 12") < level("crf 30")
    assert level("jpeg 90") > 1.0
    assert level("444") > 1.0


@pytest.mark.stages
@pytest.mark.parametrize("name", ["raw", "crf 12", "jpeg 90"])
def test_covariance_covers_the_errors(name: str) -> None:
    """Errors of markers that moved are about as large as is stated.

    While the skin moves, videos lag behind, and errors are larger than in the mean of a grasp.
    """
    pytest.importorskip("av")
    scene, followed = coded(name)
    found = stated_errors(followed, scene)
    assert found["seen"] == 100.0
    for layer in LAYERS:
        assert 0.3 < found[f"{layer}_places"] < (1.3 if name == "raw" else 2.5)
