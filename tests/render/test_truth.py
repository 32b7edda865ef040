"""Ground truth of an image against geometry that needs no renderer."""

import numpy as np
import pytest

from chromagrip.model import ContactObject, Fingertip, equilibrium
from chromagrip.render import (
    GroundTruth,
    Membrane,
    MembraneMap,
    TruthMap,
    load_sensor,
    marker_truth,
)
from chromagrip.render.drawing.truth import overlap_share

SENSOR = load_sensor("thesis")
TIP = Fingertip()
TRUTH = TruthMap(SENSOR, TIP.nodes)
MAP = MembraneMap(SENSOR, TIP.nodes)
SEEN = equilibrium(TIP, ContactObject(), 2.0, 0.6).deformation.seen


@pytest.fixture(scope="module")
def rest() -> GroundTruth:
    seen = np.zeros_like(SEEN)
    return TRUTH(MAP(seen), seen)


@pytest.fixture(scope="module")
def pressed() -> GroundTruth:
    return TRUTH(MAP(SEEN), SEEN)


def test_the_resting_skin_is_a_ball_that_has_not_moved(rest: GroundTruth) -> None:
    seen = np.isfinite(rest.depth)
    np.testing.assert_allclose(rest.depth[seen], 8e-3, rtol=1e-5)
    # A half ball of 152.8 px/rad, cut off by the image above and below.
    radius = 152.8 * np.pi / 2
    y, x = np.mgrid[:480, :640]
    np.testing.assert_array_equal(seen, np.hypot(x - 319.5, y - 239.5) < radius)
    np.testing.assert_allclose(rest.flow[:, seen], 0.0, atol=1e-4)
    assert rest.visible.all()


@pytest.mark.parametrize("layer", [0, 1])
def test_flow_carries_resting_markers_to_where_they_are(
    rest: GroundTruth, pressed: GroundTruth, layer: int
) -> None:
    """The flow at a marker's resting pixel is the marker's motion."""
    x, y = rest.pixels[layer].T
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    u, v = (x - left)[:, None], (y - top)[:, None]
    f = pressed.flow[layer]
    read = (1 - v) * ((1 - u) * f[top, left] + u * f[top, left + 1]) + v * (
        (1 - u) * f[top + 1, left] + u * f[top + 1, left + 1]
    )
    moved = pressed.pixels[layer] - rest.pixels[layer]
    assert np.abs(moved).max() > 3.0
    # Interpolated between pixels, of a field that has kinks at the edge of contact.
    np.testing.assert_allclose(read, moved, atol=0.12)
    assert np.sqrt(np.mean((read - moved) ** 2)) < 0.01


def test_depth_is_that_of_the_flat_object(pressed: GroundTruth) -> None:
    """Where the skin is held flat its distance is plane over cosine of the ray."""
    contact = np.abs(TIP.rest_positions()[:, 0]) < 1e-3
    heights = (TIP.rest_positions() + SEEN)[contact, 1]
    assert np.ptp(heights) < 0.02e-3  # flat indeed
    x = np.arange(320 - 12, 320 + 12)
    cosine = np.cos(np.abs(x - 319.5) / 152.8)
    np.testing.assert_allclose(pressed.depth[239, x] * cosine, heights.mean(), atol=0.02e-3)


def test_overlap_of_two_discs_is_their_lens() -> None:
    """Equal circles of radius r, d apart, share 2r²·acos(d/2r) − d/2·√(4r² − d²)."""
    coefficients = np.zeros((2, 1, 6, 2))
    coefficients[:, :, 1:3] = 5.0 * np.eye(2)
    for d in (0.0, 2.0, 5.0, 8.0, 11.0):
        coefficients[1, 0, 0] = [0.6 * d, 0.8 * d]
        lens = 2 * 25 * np.arccos(min(d / 10, 1.0)) - d / 2 * np.sqrt(max(100 - d * d, 0.0))
        share = overlap_share(coefficients, square=False)
        assert share[0] == pytest.approx(lens / (25 * np.pi), abs=0.02)


def test_image_centres_are_where_the_mask_s_mass_is() -> None:
    """Of markers that stand alone, one near the contact and one near the rim."""
    membrane = MAP(SEEN)
    y, x = np.mgrid[:480, :640]
    for m in (3, int(np.argmax(SENSOR.places[:, 0]))):
        centres = np.full_like(membrane.centres, np.nan)
        centres[0, m] = membrane.centres[0, m]
        alone = Membrane(centres=centres, axes=membrane.axes)
        mask = TRUTH.images(["masks"], alone, SEEN)["masks"][0].astype(float)
        mass = np.array([(mask * x).sum(), (mask * y).sum()]) / mask.sum()
        truth = marker_truth(SENSOR, alone)
        told = truth.image_centres[0, m]
        assert mask.sum() == pytest.approx(truth.areas[0, m], rel=0.012)
        assert truth.visible.sum() == 1
        assert np.isnan(truth.overlap[m])
        np.testing.assert_allclose(mass, told, atol=0.005)
