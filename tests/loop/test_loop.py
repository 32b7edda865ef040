"""The closed loop, stage by stage from what the issue promises of it."""

import json
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import ClassVar

import numpy as np
import pyarrow.parquet as pq
import pytest

from chromagrip import Result, UserError, load_scene, run
from chromagrip.control import GripCommand, GripObservation
from chromagrip.loop import Sample, arrivals, grasp, open_camera
from chromagrip.model import State
from chromagrip.render import Frame
from chromagrip.scene.scene import Scene


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


@pytest.mark.parametrize(
    ("scene", "friction"),
    [
        ("margin-60hz", 0.7),
        ("margin-30hz", 0.3),
        pytest.param("margin-60hz", 0.3, marks=pytest.mark.loops),
        pytest.param("margin-30hz", 0.7, marks=pytest.mark.loops),
    ],
)
def test_margin_inversion_holds_where_gains_slip(scene: str, friction: float) -> None:
    """At camera rate, a frame late: gains printed for 1 kHz drop what the inversion holds."""
    changes = {"path": "truth", "object.friction": friction}
    result = run(load_scene(scene, changes))
    assert result.summary["lateral_displacement_mm"] < 0.1
    assert result.trace["grip_n"][-1] == pytest.approx(0.65 / (0.7 * friction), rel=0.03)
    late = result.trace["time_s"] > 1.5
    assert np.abs(result.trace["margin_true"][late] - 0.30).max() < 0.03
    printed = {
        "controller": "safety-margin",
        "safety_margin.proportional_n": 2.5,
        "safety_margin.integral_n_per_s": 100.0,
    }
    assert run(load_scene(scene, changes | printed)).summary["gross_slip"] is True


def test_margin_inversion_through_the_camera() -> None:
    trace = run(load_scene("margin-60hz", {"duration_s": 1.7})).trace
    assert trace["lateral_displacement_mm"][-1] < 0.1
    late = trace["time_s"] > 1.2 - 1e-9
    assert trace["margin_true"][late].min() > 0.2
    assert trace["margin_true"][late].max() < 0.4
    # Sum of changes over time [N/s]: the grip is quiet, with an image's noise in every reading.
    assert np.abs(np.diff(trace["grip_n"][late])).sum() / 0.5 < 0.5


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
    short = {"duration_s": 0.06, "camera.rest_frames": 4}
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

    def expose(self, state: State, index: int, before: np.ndarray) -> Frame:
        self._kept[index] = self._camera.expose(state, index, before)
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
        def expose(self, state: State, index: int, before: np.ndarray) -> Frame:
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


class Moody:
    """Anybody's controller: constant, until it does something else at its sixth sample."""

    answer: object = GripCommand(force=1.5)

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        self._told = 0

    def command(self, observation: GripObservation) -> GripCommand:
        self._told += 1
        if self._told < 6:
            return GripCommand(force=1.5)
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer  # type: ignore[return-value]


class Demanding(Moody):
    """Anybody's controller that cannot be made."""

    def __init__(self, gain: float) -> None:
        super().__init__()


@pytest.fixture
def anybodys(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both, in a module that can be imported."""
    module = ModuleType("anybodys")
    module.__dict__.update(Moody=Moody, Demanding=Demanding)
    monkeypatch.setitem(sys.modules, "anybodys", module)


QUICK = {"path": "truth", "duration_s": 0.2, "controller": "anybodys:Moody"}


@pytest.mark.usefixtures("anybodys")
def test_anybodys_controller_grips() -> None:
    trace = run(load_scene("camera-100hz", QUICK)).trace
    assert (trace["grip_n"] == 1.5).all()
    assert trace["normal_true_n"][-1] == pytest.approx(1.5, rel=0.02)


@pytest.mark.usefixtures("anybodys")
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("anybodys:Nobody", "controller 'anybodys:Nobody': module anybodys has no Nobody"),
        ("anybodys:Demanding", r"Demanding' needs gain \(a number\); it has gain"),
        ("json:JSONDecoder", r"has no reset; see chromagrip\.control\.Controller"),
    ],
)
def test_what_is_no_controller_is_refused_before_there_is_a_folder(
    name: str, words: str, tmp_path: Path
) -> None:
    with pytest.raises(UserError, match=words):
        run(load_scene("camera-100hz", QUICK | {"controller": name}), tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("anybodys")
@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (ZeroDivisionError("no load"), "failed at t = .*: ZeroDivisionError: no load"),
        (None, "answered None at t = .*; expected a GripCommand with a force in N"),
        ("grip", "answered 'grip' at t = .*; expected a GripCommand with a force in N"),
        (GripCommand(force=float("nan")), "commanded nan N at t = .*; a grip force is finite"),
        (GripCommand(force=-0.1), "commanded -0.1 N at t = "),
    ],
)
def test_a_run_that_its_controller_stops_keeps_its_trace(
    answer: object, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Moody, "answer", answer)
    with pytest.raises(UserError, match=f"^controller anybodys:Moody {words}") as caught:
        run(load_scene("camera-100hz", QUICK), tmp_path)
    # It is told of frame k at frame k + 1, and fails at what frame 5 shows.
    assert "at t = 0.05 s, sample 5" in str(caught.value)
    kept = pq.read_table(tmp_path / "trace.parquet").to_pydict()
    assert kept["time_s"] == pytest.approx([0.01 * k for k in range(6)])
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert (summary["complete"], summary["frames"]) == (False, 6)


class Listening(Moody):
    """Anybody's controller that keeps what it is told."""

    told: ClassVar[list[GripObservation]] = []

    def command(self, observation: GripObservation) -> GripCommand:
        self.told.append(observation)
        return GripCommand(force=1.0 + len(self.told))


def listen(monkeypatch: pytest.MonkeyPatch, changes: dict[str, object]) -> list[Sample]:
    monkeypatch.setattr(Listening, "told", [])
    monkeypatch.setitem(sys.modules["anybodys"].__dict__, "Listening", Listening)
    scene = load_scene("camera-100hz", QUICK | {"controller": "anybodys:Listening"} | changes)
    with closing(open_camera(scene)) as camera:
        return list(grasp(scene, camera))


@pytest.mark.usefixtures("anybodys")
def test_a_dropped_frame_is_never_heard_of(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = listen(monkeypatch, {"camera.dropped": 0.4, "duration_s": 1.0})
    kept = [s.index for s in seen if s.observation is not None]
    assert 0 < len(kept) < len(seen)
    assert kept[0] == 0
    # The first frame is answered twice: at once, and after the latency.
    expected = [0.0, *(0.01 * k for k in kept if k < 100)]
    assert [told.time for told in Listening.told] == pytest.approx(expected)
    for before, now in pairwise(seen):
        assert (now.grip != before.grip) == (before.observation is not None)
    again = listen(monkeypatch, {"camera.dropped": 0.4, "duration_s": 1.0})
    assert [s.grip for s in again] == [s.grip for s in seen]
    other = listen(monkeypatch, {"camera.dropped": 0.4, "duration_s": 1.0, "seed": 1})
    assert [s.grip for s in other] != [s.grip for s in seen]


def test_shares_of_dropped_and_late_frames_are_what_is_asked_for() -> None:
    changes = {"duration_s": 100.0, "camera.dropped": 0.1, "camera.late": 0.3}
    due = arrivals(load_scene("camera-100hz", changes))
    there = np.flatnonzero(due >= 0)
    spread = 3.0 / np.sqrt(len(due))
    assert 1.0 - len(there) / len(due) == pytest.approx(0.1, abs=0.3 * spread)
    delay = due[there] - there
    assert set(delay) == {1, 2}
    assert (delay == 2).mean() == pytest.approx(0.3, abs=0.46 * spread)
    assert (np.diff(due[there]) >= 0).all()  # none overtakes another


@pytest.mark.usefixtures("anybodys")
def test_late_frames_come_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = listen(monkeypatch, {"camera.late": 0.5, "duration_s": 0.5})
    times = [told.time for told in Listening.told[1:]]
    assert times == sorted(times)
    assert len(times) >= len(seen) - 2
    due = arrivals(load_scene("camera-100hz", {"camera.late": 0.5, "duration_s": 0.5}))
    assert {now.index for before, now in pairwise(seen) if now.grip != before.grip} == set(due) & {
        *range(len(seen))
    }


def test_a_frame_shows_the_middle_of_its_exposure() -> None:
    """While the pull rises evenly, half an exposure is worth that much less friction."""
    changes = {
        "path": "truth",
        "controller": "conservative",
        "camera.rate_hz": 50.0,
        "duration_s": 0.5,
    }

    def observed(exposure: float) -> tuple[np.ndarray, np.ndarray]:
        trace = run(load_scene("camera-100hz", changes | {"camera.exposure_ms": exposure})).trace
        return trace["friction_estimated_n"], trace["friction_true_n"]

    still, true = observed(0.0)
    np.testing.assert_array_equal(still, true)
    earlier, same = observed(20.0)
    np.testing.assert_array_equal(same, true)  # the world is as it was
    fine = run(load_scene("camera-100hz", changes | {"camera.rate_hz": 100.0})).trace
    # Ten milliseconds before a frame at 50 Hz is a frame at 100 Hz.
    np.testing.assert_allclose(earlier[1:], fine["friction_true_n"][1:-1:2], atol=1e-9)


def test_friction_that_is_read_off_moves_the_margin_with_it() -> None:
    """Γ = 1 − ΣFf/(µ·ΣFn) of µ as it is told; what is true stays."""
    changes = {"path": "truth", "controller": "conservative", "duration_s": 0.3}
    plain, off = (
        run(load_scene("thesis", changes | {"camera.friction_bias": bias})).trace
        for bias in (0.0, 0.05)
    )
    touching = ~np.isnan(plain["margin_estimated"])
    assert touching.sum() > 200
    told = off["mu_estimated"][touching]
    assert told == pytest.approx(plain["mu_estimated"][touching] + 0.05, abs=1e-12)
    load = off["friction_true_n"][touching] / off["normal_true_n"][touching]
    margin = 1.0 - load / told
    assert off["margin_estimated"][touching] == pytest.approx(margin, abs=1e-9)
    assert off["margin_true"][touching] == pytest.approx(plain["margin_true"][touching], abs=1e-12)


def test_calm_phases_take_longer_steps_and_err_little() -> None:
    """A held load on a held grip: Γ and slip as with short steps, within what both are worth."""
    changes = {"path": "truth", "controller": "margin-inversion", "object.radius_mm": 20.0}
    fine, coarse = (
        run(load_scene("margin-60hz", changes | {"fingertip.calm_um_per_s": calm})).trace
        for calm in (0.0, 300.0)
    )
    assert (coarse["normal_true_n"] != fine["normal_true_n"]).mean() > 0.3
    touching = np.isfinite(fine["margin_true"])
    off = abs(coarse["margin_true"] - fine["margin_true"])[touching]
    assert off.max() < 0.01
    slipped = coarse["lateral_displacement_mm"][-1] - fine["lateral_displacement_mm"][-1]
    assert abs(slipped) < 1e-3


def test_a_picture_of_what_does_not_move_is_not_drawn_again() -> None:
    """The same bytes as drawn anew, noise apart."""
    scene = load_scene("margin-60hz")
    with closing(open_camera(scene)) as one, closing(open_camera(scene)) as other:
        state = next(grasp(scene, one)).state
        kept = [one.expose(state, k).image for k in range(1, 4)]
        fresh = other.expose(state, 3).image
    assert (kept[2] == fresh).all()
    assert (kept[1] != kept[2]).any()
