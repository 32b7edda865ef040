"""Fields of markers that move as a whole: over ground that goes on, and out of sight."""

import cv2
import numpy as np
import pytest

from chromagrip.render import Frame
from chromagrip.tracking import learn_palette, load_tracker, sight

PITCH, RADIUS, TIMES = 30.0, 8, 4
STEP = np.array([1.2, 0.36])


def drawn(shift: np.ndarray, housing: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Dark discs on grey ground within a black housing of that width, and their places."""
    height, width = 360, 480
    x, y = np.meshgrid(110 + PITCH * np.arange(9), 90 + PITCH * np.arange(7))
    places = np.stack([x.ravel(), y.ravel()], axis=-1) + shift
    image = np.full((height * TIMES, width * TIMES, 3), 200, np.uint8)
    for place in places:
        centre = np.rint((place + 0.5) * TIMES - 0.5).astype(int)
        cv2.circle(image, tuple(map(int, centre)), RADIUS * TIMES, (60, 40, 50), -1)
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA).astype(float)
    if housing:
        edge = np.ones((height, width), dtype=bool)
        edge[housing:-housing, housing:-housing] = False
        small[edge] = 8.0
    small += np.random.default_rng(seed).normal(0.0, 2.0, small.shape)
    return np.clip(np.rint(small), 0, 255).astype(np.uint8), places


@pytest.mark.parametrize("tracker", ["fit", "quick", "lk", "chromatouch", "detect"])
@pytest.mark.parametrize("housing", [0, 62])
def test_markers_are_followed_over_ground_and_hidden_where_they_are_cut(
    tracker: str, housing: int
) -> None:
    """By a pitch and a half to the right: in sight all the way, or up to a dark housing."""
    image, places = drawn(0.0 * STEP, housing, 0)
    follower = load_tracker(tracker)(learn_palette(image, sight(image)), 2.0)
    rest = follower.reset([Frame(image=image, time=0.0)])
    number = np.argmin(np.linalg.norm(rest.position[0][:, None] - places, axis=2), axis=1)
    hidden = 0
    for frame in range(1, 38):
        image, true = drawn(frame * STEP, housing, frame)
        tracks = follower.update(Frame(image=image, time=frame / 30.0))
        told = tracks.visible[0] & ~tracks.ambiguous[0]
        error = np.linalg.norm(tracks.position[0] - true[number], axis=1)
        assert (error[told] < 0.5).all()
        hidden += int((~told).sum())
        if not housing:
            assert told.all()
        # Discs that are whole by a little more than the lens's blur are told.
        edges = np.array([480, 360]) - 62 - RADIUS - 12
        assert told[(true[number] < edges).all(axis=1)].all()
    assert (hidden > 0) == bool(housing)
