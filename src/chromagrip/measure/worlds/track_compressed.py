"""Sequences that went through a codec, and errors of their tracks over what the tracks state."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...render import LAYERS
from ...tracking import Tracks
from .compressed import Codec, h264, h265, jpeg, mjpeg
from .track_scenes import Sequence
from .track_scores import Followed, all_numbers, errors_of, in_order, positions

Array = NDArray[np.float64]

#: Codecs by name; each at good, usual and low qualities.
CODECS: dict[str, Codec] = {
    **{f"h264-crf{crf}": h264(crf) for crf in (0, 12, 20, 28, 35)},
    **{f"h264-444-crf{crf}": h264(crf, "yuv444p") for crf in (12, 23)},
    **{f"h265-crf{crf}": h265(crf) for crf in (12, 23, 35)},
    **{f"mjpeg-q{quantiser}": mjpeg(quantiser) for quantiser in (2, 5, 15)},
    **{f"jpeg-q{quality}": jpeg(quality) for quality in (95, 90, 80, 60)},
}
#: Unit of each score.
UNITS = {
    **{f"{layer}_places": "" for layer in LAYERS},
    "places": "",
    "px": "px",
    "seen": "%",
    "compression": "",
}
#: Markers that moved by more than this since rest count [px].
_MOVED = 1.0


def compressed(scene: Sequence, codec: Codec) -> Sequence:
    """The scene after a codec, its rest frames and the others as one video; truth stays."""
    count = len(scene.rest)
    frames = codec([*scene.rest, *(shot.frame for shot in scene.shots)])
    pairs = zip(scene.shots, frames[count:], strict=True)
    shots = [replace(shot, frame=frame) for shot, frame in pairs]
    return replace(scene, rest=frames[:count], shots=shots)


def stated_errors(followed: Followed, scene: Sequence) -> dict[str, float]:
    """RMS of errors since rest over the stated deviations, of markers that moved.

    `places` of each layer; `px`, their error; `seen`, the share of markers that are reported;
    `compression`, the median of what the tracker says.
    """
    number = all_numbers(followed, scene)
    centre = np.stack([shot.centre for shot in scene.shots])
    moved = np.linalg.norm(centre - scene.centre, axis=-1).max(axis=1) > _MOVED
    start = positions(followed.rest, number) - scene.centre
    _, error, reported = errors_of(followed, number, scene)
    places = error - start
    rest = _variances(followed.rest, number)
    stated = np.stack([_variances(tracks, number) for tracks in followed.tracks]) + rest
    result = {}
    for layer, name in enumerate(LAYERS):
        ratio = places[:, layer] / np.sqrt(stated[:, layer])
        result[f"{name}_places"] = _rms(ratio[moved])
    result["px"] = _rms(np.swapaxes(places, 1, 2)[moved])
    result["seen"] = 100.0 * float(reported.mean())
    result["compression"] = float(np.median([t.compression for t in followed.tracks]))
    return result


def _variances(tracks: Tracks, number: NDArray[np.intp]) -> Array:
    """Variances of (x, y) of the true markers, shape (2, M, 2)."""
    diagonal = np.diagonal(tracks.covariance, axis1=1, axis2=2)
    places = diagonal.reshape(len(diagonal), -1, 3)[..., :2]
    return in_order(np.swapaxes(places, 0, 1), number)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
