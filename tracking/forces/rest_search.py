"""Search for likely camera poses of a rest frame, over roll, scale and shift."""

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from .pose import CameraPose
from .rest_match import RestMarkers, spacing
from .rest_settings import SearchSettings

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, kw_only=True)
class _Similarity:
    """Similarity of pixels p as complex numbers: scale·e^(i·roll)·p + shift, about the centre."""

    factor: complex
    shift: complex


def likely_poses(markers: RestMarkers, settings: SearchSettings) -> list[CameraPose]:
    """Poses without a tilt that explain the middle of a rest frame, best first."""
    lens = markers.sensor.view.camera.lens
    centre = complex(lens.centre_x, lens.centre_y)
    # The layer of which more is seen: the outer one may be worn off.
    layer = int(np.argmax([len(one.pixels) for one in markers.layers]))
    design = _complex(markers.designed(layer)) - centre
    design = design[np.argsort(abs(design))]
    seen = _complex(markers.layers[layer].pixels) - centre
    inside = markers.inside(_pixels(design + centre))
    ratio = spacing(_pixels(seen)) / spacing(_pixels(design[inside]))
    voters = design if markers.lattice else design[: settings.voters]
    tree = scipy.spatial.KDTree(_pixels(seen))
    found: list[tuple[int, _Similarity]] = []
    for start in _voted(markers, voters, seen, ratio, settings):
        refined, hits = _refined(start, markers.pitch, voters, seen, tree, settings)
        if not any(_alike(refined, other, markers.pitch) for _, other in found):
            found.append((hits, refined))
    found.sort(key=lambda both: -both[0])
    least = settings.close * max((hits for hits, _ in found), default=0)
    return [_pose(similarity) for hits, similarity in found[: settings.returned] if hits >= least]


def _voted(
    markers: RestMarkers, voters: Complex, seen: Complex, ratio: float, settings: SearchSettings
) -> list[_Similarity]:
    """Find similarities by votes of pairs of markers, most votes first."""
    view = markers.sensor.view
    reach = (settings.shift + 0.03) * min(view.width, view.height)
    starts: list[tuple[float, _Similarity]] = []
    scales = np.array(settings.scales) * ratio
    for scale in np.clip(scales, settings.smallest_scale, settings.largest_scale):
        cell = settings.cell * markers.pitch * float(scale)
        half = math.ceil(reach / cell)
        for roll in np.arange(0.0, 2 * math.pi, settings.roll_step):
            factor = complex(scale * np.exp(1j * roll))
            apart = (seen[:, None] - factor * voters).ravel() / cell
            apart = apart[(abs(apart.real) < half) & (abs(apart.imag) < half)]
            column = (apart.real + half).astype(np.int64)
            row = (apart.imag + half).astype(np.int64)
            votes = np.bincount(2 * half * row + column, minlength=4 * half * half)
            grid = votes.reshape(2 * half, 2 * half)
            # A true shift may lie at the edge of cells: count four cells together.
            grid = grid[1:, 1:] + grid[:-1, 1:] + grid[1:, :-1] + grid[:-1, :-1]
            least = max(settings.likely * float(grid.max()), 3.0)
            for y, x in zip(*np.nonzero(grid >= least), strict=True):
                shift = cell * complex(x + 1 - half, y + 1 - half)
                starts.append((float(grid[y, x]), _Similarity(factor=factor, shift=shift)))
    starts.sort(key=lambda both: -both[0])
    most = starts[: settings.most]
    return [start for votes, start in most if votes >= settings.likely * starts[0][0]]


def _refined(
    start: _Similarity,
    pitch: float,
    voters: Complex,
    seen: Complex,
    tree: "scipy.spatial.KDTree",
    settings: SearchSettings,
) -> tuple[_Similarity, int]:
    """Fit a similarity to the nearest markers repeatedly; also return the number matched."""
    current, hits = start, 0
    for radius in settings.radii:
        distance, nearest = tree.query(_pixels(current.factor * voters + current.shift))
        near = np.asarray(distance) < radius * pitch * abs(current.factor)
        hits = int(near.sum())
        if hits < 3:
            break
        p, q = voters[near], seen[np.asarray(nearest)[near]]
        p_mean, q_mean = p.mean(), q.mean()
        factor = complex(np.vdot(p - p_mean, q - q_mean) / np.vdot(p - p_mean, p - p_mean).real)
        current = _Similarity(factor=factor, shift=complex(q_mean - factor * p_mean))
    return current, hits


def _pose(similarity: _Similarity) -> CameraPose:
    """Camera pose of a similarity."""
    factor, shift = similarity.factor, similarity.shift
    return CameraPose(
        roll=float(np.angle(factor)), scale=abs(factor), shift=(shift.real, shift.imag)
    )


def _alike(one: _Similarity, other: _Similarity, pitch: float) -> bool:
    """Whether two similarities put markers at the same positions."""
    far = 5.0 * pitch  # distance from the middle
    return (
        abs(one.shift - other.shift) < 0.5 * pitch
        and abs(one.factor - other.factor) * far < 0.5 * pitch
    )


def _complex(pixels: Array) -> Complex:
    return np.asarray(pixels[..., 0] + 1j * pixels[..., 1])


def _pixels(numbers: Complex) -> Array:
    return np.column_stack([numbers.real, numbers.imag])
