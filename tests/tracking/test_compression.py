"""What the tracker sees of lossy compression, and what it then says of its errors."""

from functools import cache

import numpy as np
import pytest

from chromagrip.measure.worlds.compressed import h264, jpeg, raw
from chromagrip.measure.worlds.track_compressed import compressed, stated_errors
from chromagrip.measure.worlds.track_scenes import SCENES, Sequence, sequence
from chromagrip.measure.worlds.track_scores import follow
from chromagrip.render import LAYERS, Frame
from chromagrip.tracking.fit.compression import (
    FinePart,
    compression,
    deviations,
    fine_part,
    flat_blocks,
)

#: Frames of the motion: the press.
FRAMES = 8


def flat(noise: float, colour: float = 1.0) -> Frame:
    """Picture of one grey with noise, of whose colour a share is left."""
    rng = np.random.default_rng(3)
    levels = rng.normal(0.0, noise, (240, 320, 3))
    mean = levels.mean(axis=2, keepdims=True)
    return Frame(image=np.rint(128.0 + mean + colour * (levels - mean)).astype(np.uint8), time=0.0)


@pytest.mark.parametrize("noise", [0.5, 8.0])
def test_white_noise_is_measured(noise: float) -> None:
    frame = flat(noise)
    rounded = np.hypot(noise, np.sqrt(1.0 / 12.0))
    # The flattest blocks of a single frame show a little less than the others do.
    assert fine_part(frame.image, flat_blocks([frame])) == pytest.approx([rounded] * 3, rel=0.25)
    other = fine_part(flat(noise).image[::-1], flat_blocks([frame]))
    assert other == pytest.approx([rounded] * 3, rel=0.12)


def test_noise_alone_is_no_compression() -> None:
    """Also where the model leaves some more than noise, or much, as of a shape that it lacks."""
    for noise in (0.0, 0.5, 8.0):
        frame = flat(noise)
        seen = fine_part(frame.image, flat_blocks([frame]))
        for residual in (0.8, 1.4):
            assert compression(residual * np.hypot(noise, 0.29), seen) == 1.0
    assert compression(20.0, FinePart(2.0, 2.0, 2.0)) == 1.0
    assert compression(np.nan, FinePart(0.0, 0.0, 0.0)) == 1.0


def test_less_noise_and_larger_residuals_are_more_compression() -> None:
    kept, lost = FinePart(1.5, 0.1, 1.0), FinePart(0.1, 0.1, 1.0)
    assert 1.0 < compression(6.0, kept) < compression(6.0, lost) < compression(9.0, lost)
    assert compression(2.0, lost) > 1.0


def test_only_what_moved_is_less_certain() -> None:
    factors = deviations(6.0, np.array([0.0, 0.5, 50.0]))
    assert (factors[0] == 1.0).all()
    assert (np.diff(factors, axis=0) > 0.0).all()
    # Error of the inner layer's place over what is stated for a marker that does not move.
    assert factors[2, 3] == pytest.approx(np.sqrt(1.0 + 36.0), rel=1e-3)


@cache
def clean() -> Sequence:
    return sequence(SCENES["clean"], FRAMES, limits=False)


@pytest.mark.stages
def test_compression_grows_with_the_rate_factor_and_the_covariance_covers_the_errors() -> None:
    """Errors of markers that moved are about as large as is stated.

    While the skin moves, videos lag behind, and errors are larger than in the mean of a grasp.
    """
    found = []
    for codec in (raw, h264(12), jpeg(90), h264(30), h264(12, "yuv444p")):
        passed = compressed(clean(), codec)  # rest and press as one video
        followed = follow("fit", passed)
        found.append(float(np.median([tracks.compression for tracks in followed.tracks])))
        errors = stated_errors(followed, passed)
        if len(found) > 3:  # too coarse for every marker
            assert errors["seen"] > 98.0
            continue
        assert errors["seen"] == 100.0
        most = 1.3 if codec is raw else 2.5
        assert all(0.3 < errors[f"{name}_places"] < most for name in LAYERS)
    assert found[0] == 1.0
    assert 1.0 < found[1] < found[3]
    assert min(found[2], found[4]) > 1.0
