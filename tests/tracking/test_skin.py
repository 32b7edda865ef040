"""Light of an uneven skin: markers that move over seams, clouds, threads and white glow."""

from functools import cache

import numpy as np
import pytest

from chromagrip import Pose, TactileSensor
from chromagrip.model import Solid
from chromagrip.model.shapes import ball
from chromagrip.render import Defects, Frame, MarkerTruth, marker_truth
from chromagrip.tracking import FitSettings, MarkerTracker, load_palette
from chromagrip.tracking.fit.settings import SkinSettings

RADIUS = 15e-3
EVEN = FitSettings(skin=SkinSettings(worse=np.inf))


@cache
def press(seed: int, glow: float | None = None) -> tuple[list[Frame], list]:
    """Rest frames, and frames with their true markers; the first truth is that at rest."""
    defects = None if glow is None else Defects(glow=glow)
    sensor = TactileSensor("dome-2020", noise=2.0, seed=seed, defects=defects)
    sensor.attach(Solid(shape=ball(RADIUS), friction=0.8))
    rest = sensor.rest_frames(8)
    start = marker_truth(sensor.design, sensor.camera.membrane(sensor.body.untouched().carried))
    frames: list[tuple[Frame | None, MarkerTruth]] = [(None, start)]
    top = sensor.design.shape.radius + RADIUS
    for share in np.linspace(0.1, 1.0, 10):
        place = (2e-3 * max(0.0, 2 * share - 1), 0.0, top - 1.6e-3 * min(1.0, 2 * share))
        data = sensor.update(Pose(place=place), dt=1 / 60)
        frames.append((data.frame, data.markers))
    return rest, frames


@cache
def motions(seed: int, settings: FitSettings, glow: float | None = None) -> tuple[np.ndarray, ...]:
    """Errors of the outer markers' motions [px], their motions [px], and stated deviations [px].

    The rows are frames times true markers; errors and deviations of unseen ones are NaN.
    """
    rest, frames = press(seed, glow)
    tracker = MarkerTracker(load_palette("dome-2020"), 2.0, settings)
    at_rest, true_rest = tracker.reset(rest), frames[0][1]
    apart = np.linalg.norm(at_rest.position[0][:, None] - true_rest.image_centres[0], axis=2)
    apart = np.nan_to_num(apart, nan=np.inf)
    marker = apart.argmin(axis=1)
    known = at_rest.visible[0] & (apart.min(axis=1) < 3.0)
    shape = (len(frames) - 1, len(true_rest.image_centres[0]), 2)
    errors, true_motions = np.full(shape, np.nan), np.zeros(shape)
    stated = np.full(shape[:2], np.nan)
    for row, (frame, truth) in enumerate(frames[1:]):
        tracks = tracker.update(frame)
        ok = known & tracks.visible[0] & ~tracks.ambiguous[0]
        true_motions[row] = truth.image_centres[0] - true_rest.image_centres[0]
        seen = tracks.position[0] - at_rest.position[0]
        errors[row, marker[ok]] = (seen - true_motions[row, marker])[ok]
        stated[row, marker[ok]] = np.sqrt(tracks.covariance[ok, 0, 0])
    return errors.reshape(-1, 2), true_motions.reshape(-1, 2), stated.reshape(-1)


@pytest.mark.stages
def test_motions_over_an_uneven_skin_are_more_exact_not_drawn_to_rest_and_known() -> None:
    smooth, (errors, moved, stated) = motions(1, EVEN)[0], motions(1, FitSettings())
    length = np.linalg.norm(moved, axis=1)
    seen = [np.isfinite(e[:, 0]) & (length > 0.3) for e in (smooth, errors)]
    assert seen[1].sum() >= seen[0].sum()  # no marker is given up for it
    both = seen[0] & seen[1]
    assert (errors[both] ** 2).mean() < 0.7**2 * (smooth[both] ** 2).mean()
    far = (length > 0.5) & np.isfinite(stated)
    weight = 1.0 / (stated[far] ** 2 + 0.02**2)
    slope = np.sum(weight * np.sum(errors[far] * moved[far], axis=1)) / np.sum(
        weight * np.sum(moved[far] ** 2, axis=1)
    )
    assert abs(slope) < 0.015  # what a marker leaves of itself in the skin's light would hold it
    far &= length > 1.0
    assert 0.5 < np.median(np.abs(errors[far]).max(axis=1) / stated[far]) < 3.0


@pytest.mark.stages
def test_light_above_white_is_white() -> None:
    errors, moved, stated = motions(0, EVEN, glow=0.2)
    far = (np.linalg.norm(moved, axis=1) > 1.0) & np.isfinite(stated)
    # A glow is smooth: nothing but the clipped light disturbs.
    assert np.sqrt(np.mean(errors[far] ** 2)) < 0.02


def test_an_even_skin_needs_no_fit_of_its_light() -> None:
    sensor = TactileSensor("thesis", noise=2.0, seed=0)
    rest = sensor.rest_frames(1)
    found = [
        MarkerTracker(load_palette("thesis"), 2.0, settings).reset(rest)
        for settings in (FitSettings(), EVEN)
    ]
    np.testing.assert_array_equal(found[0].position, found[1].position)
