"""The gripper's drive against the solutions of df/dt = (command − f)/lag, |df/dt| ≤ rate."""

import math

import numpy as np
import pytest

from chromagrip import load_scene, run
from chromagrip.scene.actuator import ActuatorSettings


def path(actuator: ActuatorSettings, force: float, command: float, dt: float, end: float) -> float:
    for _ in range(round(end / dt)):
        force = actuator.follow(force, command, dt)
    return force


@pytest.mark.parametrize("dt", [1e-3, 7e-3, 0.05])
@pytest.mark.parametrize("command", [4.0, -2.0])
def test_rate_and_lag_are_exact_whatever_the_step(dt: float, command: float) -> None:
    """Straight at 20 N/s until 20·0.05 = 1 N is left, after 0.1 s; then the lag."""
    actuator = ActuatorSettings(lag_ms=50.0, rate_n_per_s=20.0)
    way = math.copysign(1.0, command - 1.0)
    for end in (dt * round(0.05 / dt), dt * round(0.35 / dt)):
        left = 3.0 - 20.0 * end if end < 0.1 else math.exp(-(end - 0.1) / 0.05)
        expected = command - way * left
        assert path(actuator, 1.0, command, dt, end) == pytest.approx(expected, abs=1e-9)
    lag = ActuatorSettings(lag_ms=30.0)
    expected = command - way * 3.0 * math.exp(-7 * dt / 0.03)
    assert path(lag, 1.0, command, dt, 7 * dt) == pytest.approx(expected, abs=1e-12)


def test_a_rate_alone_gets_there_and_stays() -> None:
    actuator = ActuatorSettings(rate_n_per_s=10.0)
    forces = [path(actuator, 0.0, 0.25, 1e-3, end) for end in (0.01, 0.02, 0.03, 0.1)]
    assert forces == pytest.approx([0.1, 0.2, 0.25, 0.25], abs=1e-12)


def test_commands_are_rounded_to_the_resolution() -> None:
    actuator = ActuatorSettings(resolution_n=0.25)
    assert [actuator.rounded(f) for f in (0.0, 0.12, 0.13, 1.87)] == [0.0, 0.0, 0.25, 1.75]
    off = ActuatorSettings()
    assert off.follow(7.0, off.rounded(1.2345), 1e-3) == 1.2345


def test_the_grip_lags_in_the_loop() -> None:
    """Under a constant command the traced force is the lag's exponential, from an open grip."""
    changes = {
        "path": "truth",
        "controller": "conservative",
        "conservative.force_n": 2.1,
        "actuator.lag_ms": 20.0,
        "actuator.resolution_n": 0.5,
        "duration_s": 0.1,
        "load.times_s": [1.0],
        "load.forces_n": [0.1],
    }
    trace = run(load_scene("camera-100hz", changes)).trace
    expected = 2.0 * (1.0 - np.exp(-trace["time_s"] / 0.02))
    np.testing.assert_allclose(trace["applied_n"], expected, atol=1e-12)
    assert (trace["grip_n"] == 2.1).all()
    # What the object feels is the drive's force, but for the damping of what still moves.
    assert trace["normal_true_n"][-1] == pytest.approx(expected[-1], rel=0.02)
    slower = run(load_scene("camera-100hz", changes | {"actuator.rate_n_per_s": 5.0})).trace
    assert slower["applied_n"][6] == pytest.approx(0.3)
