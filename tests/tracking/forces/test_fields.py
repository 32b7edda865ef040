import numpy as np
import pytest

from chromagrip.calibrate.variations import Variations, varied_shifts
from chromagrip.model import ContactObject, Fingertip, equilibrium
from chromagrip.render import load_sensor
from chromagrip.tracking.forces.chain.fields import at_places, circle_places, fields_on_circles
from chromagrip.tracking.forces.chain.sensitivity import MarkerResponse

SENSOR = load_sensor("thesis")
TIP = Fingertip()
#: A ball pressed and sheared: nothing about it is symmetric but its plane.
BALL = equilibrium(TIP, ContactObject(curvature=60.0, friction=0.8), 2.0, 0.7).deformation.seen
EVEN, ODD = np.array([False]), np.array([True])


def by_fields(variations: Variations, places: np.ndarray, azimuth: float = 0.0) -> np.ndarray:
    """Shifts (P, 6) of the ball by its fields on circles."""
    on_circles = varied_shifts(SENSOR, circle_places(), TIP, BALL[None], variations)
    even, odd = fields_on_circles(on_circles)
    both = np.stack([places] * 2)
    return sum(
        at_places(part, sign, both).at(azimuth)[..., 0] for part, sign in ((even, EVEN), (odd, ODD))
    )


def test_without_variations_markers_move_as_the_chain_carries_them() -> None:
    """Two ways to the same shifts: the estimators' response, and the training's own map."""
    response = MarkerResponse(SENSOR, np.stack([SENSOR.places] * 2), TIP.angles())
    expected = response.measured(BALL) - response.measured(np.zeros_like(BALL))
    shifts = varied_shifts(SENSOR, SENSOR.places, TIP, BALL[None], Variations.none(1))[0]
    assert shifts == pytest.approx(expected, abs=1e-8)


def test_fields_give_the_shifts_at_any_place() -> None:
    rng = np.random.default_rng(0)
    places = np.column_stack([rng.uniform(0.05, 1.3, 200), rng.uniform(-3.0, 3.0, 200)])
    variations = Variations.none(1)
    variations.twist[:] = 0.05
    variations.off_plane[:] = 0.1
    expected = varied_shifts(SENSOR, places, TIP, BALL[None], variations)[0]
    found = by_fields(variations, places)
    assert np.sqrt(((found - expected)[:, [0, 1, 3, 4]] ** 2).mean()) < 0.02
    assert np.sqrt((expected[:, [0, 1, 3, 4]] ** 2).mean()) > 2.0
