"""The scenes beyond the thesis: what happens in each of them, against what must."""

import math
from typing import Any

import numpy as np
import pytest

from chromagrip import Result, load_scene, run
from chromagrip.measure.bench.control import SCENES
from chromagrip.scene.scene import LoadSettings


def held(name: str, force: float, **changes: Any) -> Result:
    """Truth-path run of a scene in which the grip does not move, on a coarse chain."""
    told = {key.replace("__", "."): value for key, value in changes.items()}
    fixed = {"path": "truth", "controller": "conservative", "conservative.force_n": force}
    return run(load_scene(name, {"fingertip.nodes": 101} | fixed | told))


@pytest.mark.loops
@pytest.mark.parametrize("name", SCENES)
def test_a_scene_runs_on_the_truth_path_and_enough_grip_holds_in_it(name: str) -> None:
    """A scene that no grip survives would say nothing of a controller."""
    assert held(name, 5.0).summary["lateral_displacement_mm"] < 0.1
    scene = load_scene(name, {"path": "truth"})
    assert (scene.camera.rate_hz, scene.camera.latency_frames) == (60.0, 1)
    assert 0.0 < scene.last_change < scene.duration_s - 0.5  # there is time to settle
    trace = run(scene).trace
    touching = trace["contact_nodes"] > 0
    assert touching[5:].all()
    margin = trace["margin_true"][touching]
    assert (margin > -1e-9).all()
    assert (margin < 1.0 + 1e-9).all()
    # What the load says of the load is what the trace has.
    loads = [scene.load.force(t) for t in np.arange(0.0, scene.duration_s, 1e-3)]
    assert trace["load_n"].max() == pytest.approx(max(loads), rel=0.1)


def test_loads_between_their_points() -> None:
    hold = LoadSettings(times_s=(0.1, 0.5), forces_n=(0.2, 0.6))
    linear = LoadSettings(times_s=(0.1, 0.5), forces_n=(0.2, 0.6), interpolation="linear")
    for load in (hold, linear):
        assert load.force(0.0999) == 0.0
        assert [load.force(t) for t in (0.1, 0.5, 9.0)] == [0.2, 0.6, 0.6]
    assert (hold.force(0.3), linear.force(0.3)) == (0.2, pytest.approx(0.4))
    sine = LoadSettings(times_s=(0.1,), forces_n=(0.4,), sine_n=0.25, sine_hz=2.0)
    assert [sine.force(0.1 + k / 8) for k in range(5)] == pytest.approx([0.4, 0.65, 0.4, 0.15, 0.4])
    assert sine.force(0.0) == 0.0
    assert LoadSettings(times_s=(), forces_n=()).force(1.0) == 0.0


def test_a_drop_of_friction_slips_by_the_drag_law() -> None:
    """1 N holds 0.5 N before the drop and 0.3 N after it, of a load of 0.4 N."""
    result = held("moisture-1", 1.0, object__friction_times_s=[0.8], duration_s=1.1)
    trace, time = result.trace, result.trace["time_s"]
    x = 1e-3 * trace["object_mm"]
    before, after = time < 0.8 - 1e-9, time > 0.95
    assert trace["margin_true"][before][-1] == pytest.approx(1.0 - 0.4 / 0.5, abs=0.01)
    assert abs(np.diff(x[before][-5:])).max() < 5e-6  # a third of what follows
    assert (trace["mu_true"][before] == 0.5).all()
    assert (trace["mu_true"][time > 0.8 + 1e-9] == 0.3).all()
    assert trace["margin_true"][after] == pytest.approx(0.0, abs=1e-6)
    speed = np.diff(x[after]) * result.scene.camera.rate_hz
    assert speed == pytest.approx((0.4 - 0.3) / result.scene.object.drag_n_s_per_m, rel=0.02)


@pytest.mark.loops
def test_the_jerk_needs_more_than_the_grip_of_the_load_before_it() -> None:
    for force, slips in ((0.4 / 0.5 / 0.7, True), (1.2 / 0.5 / 0.9, False)):
        assert held("jerk-1", force).summary["gross_slip"] is slips


def test_a_ramp_of_load_is_a_ramp_of_friction() -> None:
    """Friction and the drag of the object's own motion carry it together."""
    result = held("ramp-1", 5.0, load__times_s=[0.1, 0.6], duration_s=0.6)
    trace = result.trace
    speed = np.gradient(trace["object_mm"] * 1e-3, trace["time_s"])
    inside = (trace["time_s"] > 0.3) & (trace["time_s"] < 0.55)
    carried = trace["friction_true_n"] + result.scene.object.drag_n_s_per_m * speed
    assert carried[inside] == pytest.approx((trace["time_s"][inside] - 0.1) / 0.5, abs=0.012)


@pytest.mark.loops
def test_a_patchy_surface_has_the_friction_of_what_touches() -> None:
    """Along it µ is between its extremes, and another one as the object slides."""
    trace = held("patchy-1", 0.9, load__forces_n=[0.25, 0.8]).trace
    mu = trace["mu_true"][trace["time_s"] > 1.5]
    assert 0.35 < mu.min() < mu.max() < 0.65
    assert np.ptp(mu) > 0.005
    assert trace["margin_true"][-1] == pytest.approx(0.0, abs=1e-6)


def test_a_creeping_object_gives_way_under_the_same_force() -> None:
    settings = load_scene("creep-1").object
    assert settings.stiffness_kpa_at(0.0) == settings.stiffness_kpa
    assert settings.stiffness_kpa_at(1e3) == pytest.approx(settings.stiffness_kpa / 2.5)
    a_while = settings.stiffness_kpa / (1.0 + 1.5 * (1.0 - 1.0 / math.e))
    assert settings.stiffness_kpa_at(settings.creep_s) == pytest.approx(a_while)
    short = {"object__creep_s": 0.1, "duration_s": 0.7}
    creeping = held("creep-1", 2.0, **short).trace
    stiff = held("creep-1", 2.0, object__creeps=0.0, duration_s=0.7).trace
    soft = held("creep-1", 2.0, object__creeps=0.0, object__stiffness_kpa=16.0, **short).trace
    for name in ("rigid_part_mm", "pressure_n_per_m"):
        first, last = stiff[name][-1], creeping[name][-1]
        assert last == pytest.approx(soft[name][-1], rel=0.03)
        assert abs(last - first) > 0.1 * first
    assert creeping["normal_true_n"][-1] == pytest.approx(stiff["normal_true_n"][-1], rel=0.05)


@pytest.mark.loops
@pytest.mark.parametrize("share", [0.03, 0.2])
def test_a_light_press_is_read_in_spite_of_wear(share: float) -> None:
    """What is worn off is not tracked; of a pair that lost its outer marker the inner is read."""
    changes = {"defects__worn_markers": share}
    trace = held("worn-1", 1.5, path="camera", duration_s=0.3, **changes).trace
    assert 0.6 * 400 < trace["markers_visible"].min() <= (1.0 - 0.7 * share) * 400
    read = (trace["time_s"] > 0.15) & np.isfinite(trace["friction_deviation_n"])
    assert read.sum() >= 5
    error = trace["friction_estimated_n"][read] - trace["friction_true_n"][read]
    assert abs(error).max() < 0.05
    press = trace["normal_estimated_n"][read][-1]
    assert press == pytest.approx(trace["normal_true_n"][read][-1], rel=0.15)


@pytest.mark.loops
def test_too_much_compression_is_said_not_guessed() -> None:
    trace = run(load_scene("worn-1", {"duration_s": 0.2, "defects.jpeg_quality": 35})).trace
    assert np.isinf(trace["friction_deviation_n"]).all()
    assert np.isnan(trace["margin_estimated"]).all()
    # Without an estimate a load is not excluded: the grip is held, then it rises.
    steps = np.diff(trace["grip_n"])
    assert (steps >= 0.0).all()
    assert trace["grip_n"][-1] > trace["grip_n"][0]
