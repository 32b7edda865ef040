"""Tuned parameters of the estimate of the camera's pose from a rest frame."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class MatchSettings:
    """Tuned parameters of the assignment of markers to design positions; distances are in pitches.

    Attributes
    ----------
    least_markers: smallest number of markers in a layer
    same: distance below which a marker is at a design position, for a perfect specimen
    scattered: its increase per standard deviation of a specimen's markers from their positions
    own: distance below which positions of a rotated layout coincide
    symmetric: smallest share of positions that coincide under a rotational symmetry of the layout
    largest_order: largest order of a symmetry that is tried
    neighbours: number of neighbours onto which a layout is shifted to find a lattice
    lattice: smallest share of positions that coincide when a lattice is shifted
    """

    least_markers: int = 20
    same: float = 0.25
    scattered: float = 1.0
    own: float = 0.1
    symmetric: float = 0.6
    largest_order: int = 72
    neighbours: int = 8
    lattice: float = 0.6


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """Tuned parameters of the search over roll, scale and shift; distances are in pitches.

    Attributes
    ----------
    smallest_scale, largest_scale: bounds of the scale
    shift: largest shift over the image's smaller side
    voters: number of markers that vote for a pose, those nearest to the middle of the image, where
        a tilt looks like a shift; in a lattice all vote, as it looks the same everywhere
    scales: tried scales, relative to that from the markers' spacing
    roll_step: step of the tried rolls [rad]
    cell: side of the cells in which votes for a shift are counted
    likely: share of the largest number of votes above which a pose is refined
    most: largest number of such poses
    radii: distances up to which markers are matched, by round
    close: share of the largest number of matched markers above which a pose is returned
    returned: largest number of returned poses
    """

    smallest_scale: float = 0.7
    largest_scale: float = 1.4
    shift: float = 0.15
    voters: int = 60
    scales: tuple[float, ...] = (0.9, 0.95, 1.0, 1.05)
    roll_step: float = math.radians(3.0)
    cell: float = 0.3
    likely: float = 0.7
    most: int = 300
    radii: tuple[float, ...] = (0.5, 0.4, 0.3)
    close: float = 0.8
    returned: int = 8


@dataclass(frozen=True, kw_only=True)
class PoseSettings:
    """Tuned parameters of `rest_pose`.

    Attributes
    ----------
    tilt: prior standard deviation of the camera's tilt about each axis [rad]
    shift: prior standard deviation of its shift along each axis [px]
    log_scale: prior standard deviation of the logarithm of its scale
    turn: prior standard deviation of the inner layer's rotation about each axis [rad]
    along: prior standard deviation of the inner layer's shift along a pad [m]
    place: standard deviation of a marker's position due to manufacture [pitches]
    from_design: rounds of a fit from the design's pose: distance up to which markers are matched
        [pitches], and share of the layout, from the middle; near it a tilt looks like a shift
    from_search: such rounds of a fit from a pose of the search
    largest_tilt: largest tilt that can be distinguished from a shift [rad]
    share: share of the visible markers that must lie at design positions; a layout resembles
        others, 95 % of whose markers then lie at its positions
    crooked: the same for a design whose specimens have crooked markers, the farthest of which lie
        elsewhere; of the markers of another design at most 40 % lie at its positions
    found: share of the design positions that must have markers
    apart: largest RMS distance of the markers from the design positions [pitches]
    sure: loss of overlap below which a fit from the design's own pose needs no search, over
        1/√markers; a square grid that is shifted by a pitch loses 1
    equal: loss of overlap up to which two poses are equally good, over 1/√markers
    clear: motion of a pose from the design, over that of the next pose, below which it is accepted
    match, search: settings of the parts of the method
    """

    tilt: float = 0.1
    shift: float = 40.0
    log_scale: float = 0.2
    turn: float = 0.03
    along: float = 2e-4
    place: float = 0.03
    from_design: tuple[tuple[float, float], ...] = (
        (0.45, 1.0),
        (0.35, 1.0),
        (0.25, 1.0),
        (0.25, 1.0),
    )
    from_search: tuple[tuple[float, float], ...] = (
        (0.4, 0.5),
        (0.4, 0.7),
        (0.4, 0.85),
        *from_design,
    )
    largest_tilt: float = math.radians(15.0)
    share: float = 0.97
    crooked: float = 0.9
    found: float = 0.3
    apart: float = 0.2
    sure: float = 0.5
    equal: float = 0.25
    clear: float = 0.25
    match: MatchSettings = MatchSettings()
    search: SearchSettings = SearchSettings()
