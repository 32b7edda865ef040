"""The closed loop, stage by stage from what the issue promises of it."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from chromagrip import Result, UserError, load_scene, run
from chromagrip.control import GripCommand, GripObservation
from chromagrip.loop import Sample, grasp, open_camera
from chromagrip.model import State
from chromagrip.render import Frame
from chromagrip.scene import Scene


@pytest.fixture(scope="module")
def truth() -> dict[str, Result]:
    """The thesis's validation experiment on the truth path, once for each controller."""
    names = ("safety-margin", "react-to-slip", "conservative")
    return {
        name: run(load_scene("thesis", {"path": "truth", "controller": name})) for name in names
    }


def test_safety_margin_settles_at_the_desired_margin(truth: dict[str, Result]) -> None:
    summary = truth["safety-margin"].summary
    assert summary["final_margin_true"] == pytest.approx(0.30, abs=0.02)
    assert summary["lateral_displacement_mm"] < 0.05
    trace = truth["safety-margin"].trace
    # First down to the floor (E1), then two plateaus of 0.25/(0.7·0.5) and 0.65/(0.7·0.5) N.
    assert trace["grip_n"][50:100].min() == pytest.approx(0.1)
    assert trace["grip_n"][990] == pytest.approx(0.714, abs=0.02)
    assert trace["grip_n"][-1] == pytest.approx(1.857, abs=0.06)


def test_react_to_slip_slips_once_and_then_holds(truth: dict[str, Result]) -> None:
    summary = truth["react-to-slip"].summary
    (event,) = summary["slip_reactions"]
    assert event["time_s"] == pytest.approx(1.4, abs=0.05)
    assert summary["lateral_displacement_mm"] == pytest.approx(1.3, abs=0.05)
    assert summary["gross_slip"] is True
    assert summary["max_grip_n"] == 2.5
    # Γ is 0 from before the second load until the reaction.
    margin = truth["react-to-slip"].trace["margin_true"]
    assert np.abs(margin[1010:1380]).max() < 0.02


def test_conservative_shows_the_printed_margins(truth: dict[str, Result]) -> None:
    trace = truth["conservative"].trace
    assert trace["margin_true"][990] == pytest.approx(0.90, abs=0.01)
    assert trace["margin_true"][-1] == pytest.approx(0.74, abs=0.01)
    assert truth["conservative"].summary["lateral_displacement_mm"] < 1e-3


def test_printed_gains_slip_at_camera_rate() -> None:
    """The regime where the thesis's controller fails: 100 Hz with one frame of latency."""
    printed = {
        "path": "truth",
        "safety_margin.proportional_n": 2.5,
        "safety_margin.integral_n_per_s": 100.0,
        "safety_margin.friction_window_s": 0.05,
    }
    assert run(load_scene("camera-100hz", printed)).summary["gross_slip"] is True
    assert run(load_scene("camera-100hz", {"path": "truth"})).summary["gross_slip"] is False


def test_reaction_comes_one_frame_and_the_latency_after_an_event() -> None:
    """(L + 1)·T: the first frame after the event shows it, L frames later it is answered."""
    changes = {
        "path": "truth",
        "safety_margin.start_s": 0.0,
        "safety_margin.desired_margin": 0.99,  # off its floor, so that any change shows
        "load.times_s": [0.2],
        "load.forces_n": [0.3],
        "duration_s": 0.3,
    }
    for latency in (0, 1, 3):
        trace = run(load_scene("camera-100hz", changes | {"camera.latency_frames": latency})).trace
        still = run(
            load_scene(
                "camera-100hz",
                changes | {"camera.latency_frames": latency, "load.forces_n": [0.0]},
            )
        ).trace
        differs = np.flatnonzero(trace["grip_n"] != still["grip_n"])
        assert trace["time_s"][differs[0]] == pytest.approx(0.2 + (latency + 1) * 0.01)


@pytest.fixture(scope="module")
def through_the_camera() -> Result:
    return run(load_scene("camera-100hz"))


def test_the_camera_path_holds_the_object(through_the_camera: Result) -> None:
    summary, trace = through_the_camera.summary, through_the_camera.trace
    assert summary["complete"] is True
    assert summary["frames"] == 201
    assert summary["gross_slip"] is False
    late = trace["margin_true"][trace["time_s"] > 1.7 - 1e-9]
    assert late.min() > 0.15
    assert late.max() < 0.50
    # The estimate is an estimate: near the truth, and not the truth.
    assert 0.005 < summary["margin_rmse"] < 0.3
    assert trace["markers_visible"].min() > 380


def test_the_same_seed_gives_the_same_run() -> None:
    short = {"duration_s": 0.1}
    first, again = (run(load_scene("camera-100hz", short)).trace for _ in range(2))
    other = run(load_scene("camera-100hz", short | {"seed": 1})).trace
    for name, column in first.columns.items():
        np.testing.assert_array_equal(column, again[name])
    assert (first["normal_estimated_n"] != other["normal_estimated_n"]).any()


class Tampered:
    """A camera in front of which something else is held."""

    def __init__(self, scene: Scene, swap: dict[int, int]) -> None:
        self._camera = open_camera(scene)
        self._swap = swap
        self._kept: dict[int, Frame] = {}

    def expose(self, state: State, index: int) -> Frame:
        self._kept[index] = self._camera.expose(state, index)
        return replace(self._kept[self._swap.get(index, index)], time=state.time)

    def __getattr__(self, name: str) -> object:
        return getattr(self._camera, name)


def samples(scene: Scene, swap: dict[int, int]) -> Iterator[Sample]:
    return grasp(scene, Tampered(scene, swap))  # type: ignore[arg-type]


def test_the_pixels_decide() -> None:
    """Freeze the image and the estimate freezes, though the object is pulled ever harder."""
    scene = load_scene(
        "camera-100hz",
        {
            "duration_s": 0.4,
            "controller": "conservative",
            "conservative.force_n": 2.0,
            "load.times_s": [0.05, 0.2],
            "load.forces_n": [0.1, 0.6],
        },
    )
    free = list(samples(scene, {}))
    frozen = list(samples(scene, dict.fromkeys(range(21, 41), 20)))
    true = [s.field.total_friction for s in frozen]
    assert true[-1] - true[20] > 0.3  # the world went on
    moved = [s.observation.field.total_friction for s in free]
    stuck = [s.observation.field.total_friction for s in frozen]
    assert moved[-1] - moved[20] > 0.25
    assert abs(stuck[-1] - stuck[20]) < 0.03
    assert np.ptp(stuck[30:]) < 0.005


def test_the_force_follows_the_markers_of_another_object() -> None:
    """Show the camera a harder press than the one that happens: the estimate shows that one."""
    quiet = load_scene(
        "camera-100hz",
        {"duration_s": 0.3, "controller": "conservative", "conservative.force_n": 1.0},
    )
    hard = load_scene(
        "camera-100hz",
        {"duration_s": 0.3, "controller": "conservative", "conservative.force_n": 3.0},
    )
    images = [s.frame for s in grasp(hard, open_camera(hard))]

    class Swapped(Tampered):
        def expose(self, state: State, index: int) -> Frame:
            frame = images[index]
            assert frame is not None
            return frame

    last = list(grasp(quiet, Swapped(quiet, {})))[-1]  # type: ignore[arg-type]
    assert last.field.total_normal == pytest.approx(1.0, rel=0.05)
    assert last.observation.field.total_normal == pytest.approx(3.0, rel=0.15)


@pytest.mark.parametrize("answer", [float("nan"), -1.0, float("inf")])
def test_a_controller_that_answers_nonsense_is_stopped(
    answer: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    def command(self: object, observation: GripObservation) -> GripCommand:
        return GripCommand(force=answer if observation.time > 0.05 else 1.0)

    monkeypatch.setattr("chromagrip.control.ConservativeControl.command", command)
    scene = load_scene("camera-100hz", {"path": "truth", "controller": "conservative"})
    with pytest.raises(UserError, match=r"controller conservative commanded .* at t = 0.06 s"):
        run(scene)
