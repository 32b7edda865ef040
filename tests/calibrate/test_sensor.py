"""Forces that a fit of the chain leaves, where the list of presses is wrong by known amounts."""

from dataclasses import replace

import numpy as np
import pytest

from chromagrip.calibrate.press_fit import predict
from chromagrip.calibrate.presses import Press, Pressed
from chromagrip.calibrate.sensor import _Data, _forces_left
from chromagrip.render import MembraneMap
from chromagrip.render.outlines import areas, centroids, outlines
from chromagrip.tracking import Tracks, load_calibration
from chromagrip.tracking.forces import MarkerShifts

KNOWN = load_calibration("thesis")
FRICTION = 0.6
PRESSES = [
    Press(name="light", normal=0.5, lateral=0.0),
    Press(name="pulled", normal=2.0, lateral=0.5),
    Press(name="pushed", normal=4.0, lateral=-1.0),
]


def at_rest() -> Tracks:
    sensor = KNOWN.sensor
    nodes = KNOWN.fingertip.nodes
    shapes = outlines(MembraneMap(sensor, nodes)(np.zeros((nodes, 2))), sensor.view)
    pairs = shapes.shape[1]
    return Tracks(
        time=0.0,
        position=centroids(shapes, False),
        log_size=0.5 * np.log(areas(shapes, False)),
        hue=np.zeros(pairs),
        visible=np.ones((2, pairs), dtype=bool),
        ambiguous=np.zeros((2, pairs), dtype=bool),
        last_seen=np.zeros((2, pairs)),
        covariance=np.tile(1e-4 * np.eye(6), (pairs, 1, 1)),
    )


@pytest.mark.parametrize(
    ("heavier", "pulled"), [(0.0, 0.0), (0.03, 0.0), (0.0, 0.04), (-0.02, -0.03)]
)
def test_forces_left_are_those_by_which_the_list_is_wrong(heavier: float, pulled: float) -> None:
    """Pictures of presses whose forces differ from the list by a share, and by newtons."""
    rest = at_rest()
    shifts = MarkerShifts(KNOWN, rest, np.inf)
    pressed = Pressed(presses=PRESSES, rest=rest, tracks=[], noise=1.0)
    true = [
        replace(p, normal=(1.0 + heavier) * p.normal, lateral=p.lateral + pulled) for p in PRESSES
    ]
    seen = predict(KNOWN, FRICTION, rest, true, shifts.pose)
    data = _Data(
        shifts=seen,
        visible=np.ones(seen.shape[:2], dtype=bool),
        own=np.tile(1e-4 * np.eye(6), (*seen.shape[:2], 1, 1)),
        shared=shifts.rest_covariance,
        floor=shifts.floor,
        pose=shifts.pose,
    )
    normal, lateral = _forces_left(KNOWN, FRICTION, pressed, data, shifts.floor)
    # Springs of the chain snap from node to node, so that its response is rough.
    assert normal == pytest.approx(abs(heavier), abs=6e-3)
    assert lateral == pytest.approx(abs(pulled), abs=3e-3)
