"""An object that slides away, against the law of its damper."""

import numpy as np
import pytest

from chromagrip import load_scene, run

GRIP, LOAD, MU, DRAG = 1.0, 1.0, 0.5, 120.0
CHANGES = {
    "path": "truth",
    "controller": "conservative",
    "conservative.force_n": GRIP,
    "load.times_s": [0.0, 0.1],
    "load.forces_n": [0.0, LOAD],
    "object.radius_mm": float("inf"),
    "object.friction": MU,
    "object.drag_n_s_per_m": DRAG,
    "duration_s": 0.4,
}


@pytest.mark.parametrize("column", ["rigid_slip_mm", "lateral_displacement_mm"])
def test_slip_grows_with_the_speed_of_the_object(column: str) -> None:
    """Where all of the contact slides, drag bears what friction does not: v = (F − µ·Fn)/drag."""
    trace = run(load_scene("camera-100hz", CHANGES)).trace
    late = trace["time_s"] > 0.3
    speed = np.diff(trace[column][late]) / np.diff(trace["time_s"][late])
    assert speed == pytest.approx(1e3 * (LOAD - MU * GRIP) / DRAG, rel=1e-3)
