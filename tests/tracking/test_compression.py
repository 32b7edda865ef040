"""What the tracker sees of lossy compression, and what it then says of its errors."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from numpy.typing import NDArray

from chromagrip.measure.worlds.compressed import Codec, h264, jpeg, raw
from chromagrip.measure.worlds.track_scenes import SCENES, Sequence, sequence
from chromagrip.measure.worlds.track_scores import Followed, all_numbers, errors_of, follow
from chromagrip.render import Frame
from chromagrip.tracking.fit.compression import (
    FinePart,
    compression,
    deviations,
    fine_part,
    flat_blocks,
)

Array = NDArray[np.float64]

#: Frames of the motion: the press and the first shear.
FRAMES = 14
CODECS = {
    "raw": raw,
    "crf 12": h264(12),
    "crf 23": h264(23),
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
    return (passed := through(scene, codec)), follow("fit", passed)


def through(scene: Sequence, codec: Codec) -> Sequence:
    count = len(scene.rest)
    frames = codec([*scene.rest, *(shot.frame for shot in scene.shots)])
    pairs = zip(scene.shots, frames[count:], strict=True)
    shots = [replace(shot, frame=frame) for shot, frame in pairs]
    return replace(scene, rest=frames[:count], shots=shots)


def level(name: str) -> float:
    return float(np.median([tracks.compression for tracks in coded(name)[1].tracks]))


@pytest.mark.parametrize("told", [0.7, 1.0, 1.3])
def test_tracks_of_uncompressed_pictures(told: float) -> None:
    scene = clean()
    short = replace(scene, noise=told * scene.noise, shots=scene.shots[-3:])
    followed = follow("fit", short)
    assert [t.compression for t in (followed.rest, *followed.tracks)] == [1.0] * 4


def test_compression_grows_with_the_rate_factor() -> None:
    pytest.importorskip("av")
    assert level("raw") == 1.0
    assert 1.0 < level("crf 12") < level("crf 23") < level("crf 30")
    assert level("jpeg 90") > 1.0
    assert level("444") > 1.0


@pytest.mark.parametrize("name", ["raw", "crf 12", "crf 23", "444", "jpeg 90"])
def test_covariance_covers_the_errors(name: str) -> None:
    """Squared error of a displacement over its variance: 1 in the mean for markers that moved."""
    pytest.importorskip("av")
    scene, followed = coded(name)
    number = all_numbers(followed, scene)
    centre = np.stack([shot.centre for shot in scene.shots])
    moved = np.linalg.norm(centre - scene.centre, axis=-1).max(axis=1) > 1.0
    rest = replace(scene, shots=[replace(scene.shots[0], centre=scene.centre)])
    at_rest = errors_of(replace(followed, tracks=[followed.rest]), number, rest)[1]
    error = errors_of(followed, number, scene)[1] - at_rest
    for layer in range(2):
        variance = np.stack([variances(t, number, layer) for t in followed.tracks])
        variance += variances(followed.rest, number, layer)
        squares = (error[:, layer] ** 2 / variance)[moved]
        assert 0.3 < float(np.sqrt(np.nanmean(squares))) < 1.6


def variances(tracks, number: NDArray[np.intp], layer: int) -> Array:
    """Variances of (x, y) of the markers by their number in the scene, shape (M, 2)."""
    diagonal = np.diagonal(tracks.covariance, axis1=1, axis2=2)[:, 3 * layer : 3 * layer + 2]
    return np.where((number[layer] >= 0)[:, None], diagonal[number[layer]], np.nan)
