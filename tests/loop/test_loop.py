"""The closed loop: what each controller holds, what the camera decides, and what is told when."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from chromagrip import Result, UserError, load_scene, run
from chromagrip.control import GripCommand, GripObservation
from chromagrip.loop import Sample, arrivals, grasp, open_camera
from chromagrip.loop.methods import choose
from chromagrip.model import State
from chromagrip.render import Frame
from chromagrip.scene.controllers import CONTROLLERS
from chromagrip.scene.scene import Scene

#: Γ at the end under the thesis's second load of 0.65 N; React To Slip holds 2.5 N by then.
FINAL = {"react-to-slip": 1.0 - 0.65 / (0.5 * 2.5), "conservative": 1.0 - 0.65 / (0.5 * 5.0)}


@pytest.mark.parametrize("name", CONTROLLERS.entries)
def test_each_controller_holds_the_load_at_its_margin(name: str) -> None:
    changes = {"controller": name, "path": "truth", "fingertip.nodes": 101, "duration_s": 1.6}
    scene = load_scene("margin-60hz", changes | {"load.times_s": [0.04, 0.3]})
    result = run(scene)
    summary, trace = result.summary, result.trace
    expected = FINAL.get(name, scene.target_margin)
    assert trace["margin_true"][-1] == pytest.approx(expected, abs=0.03)
    assert trace["grip_n"][-1] == pytest.approx(0.65 / (0.5 * (1.0 - expected)), rel=0.05)
    if name == "react-to-slip":  # the reaction is the first frame whose grip has risen
        (event,) = summary["slip_reactions"]
        risen = np.argmax(trace["grip_n"] > 2.0)
        assert event["time_s"] == trace["time_s"][risen]
        assert event["lateral_displacement_mm"] == trace["lateral_displacement_mm"][risen]
        assert summary["lateral_displacement_mm"] > 1.3
    else:
        assert summary["lateral_displacement_mm"] < 0.25
        assert summary["slip_reactions"] == []


@pytest.fixture(scope="module")
def truth() -> dict[str, Result]:
    """The thesis's validation experiment on the truth path, once for each controller."""
    names = ("safety-margin", "react-to-slip", "conservative")
    return {
        name: run(load_scene("thesis", {"path": "truth", "controller": name})) for name in names
    }


@pytest.mark.loops
def test_the_thesis_has_its_printed_courses(truth: dict[str, Result]) -> None:
    grip = truth["safety-margin"].trace["grip_n"]
    # First down to the floor (E1), then two plateaus of 0.25/(0.7·0.5) and 0.65/(0.7·0.5) N.
    assert grip[50:100].min() == pytest.approx(0.1)
    assert grip[990] == pytest.approx(0.714, abs=0.02)
    assert grip[-1] == pytest.approx(1.857, abs=0.06)
    assert truth["safety-margin"].summary["lateral_displacement_mm"] < 0.05
    margin = truth["conservative"].trace["margin_true"]
    assert (margin[990], margin[-1]) == pytest.approx((0.90, 0.74), abs=0.01)
    assert truth["conservative"].summary["lateral_displacement_mm"] < 1e-3


@pytest.mark.loops
def test_react_to_slip_slips_once_and_then_holds(truth: dict[str, Result]) -> None:
    summary, trace = truth["react-to-slip"].summary, truth["react-to-slip"].trace
    (event,) = summary["slip_reactions"]
    assert event["time_s"] == pytest.approx(1.4, abs=0.05)
    assert summary["lateral_displacement_mm"] == pytest.approx(1.3, abs=0.05)
    assert (summary["gross_slip"], summary["max_grip_n"]) == (True, 2.5)
    # Γ is 0 from before the second load until the reaction.
    assert np.abs(trace["margin_true"][1010:1380]).max() < 0.02


PRINTED = {
    "controller": "safety-margin",
    "safety_margin.proportional_n": 2.5,
    "safety_margin.integral_n_per_s": 100.0,
    "safety_margin.friction_window_s": 0.05,
}


@pytest.mark.loops
@pytest.mark.parametrize(
    ("scene", "friction"), [("camera-100hz", 0.5), ("margin-60hz", 0.3), ("margin-30hz", 0.7)]
)
def test_printed_gains_slip_at_camera_rate(scene: str, friction: float) -> None:
    """A frame late, gains for 1 kHz drop what the gains of the camera and the inversion hold."""
    changes = {"path": "truth", "object.friction": friction}
    assert run(load_scene(scene, changes | PRINTED)).summary["gross_slip"] is True
    result = run(load_scene(scene, changes))
    assert result.summary["gross_slip"] is False
    if scene != "camera-100hz":
        late = result.trace["time_s"] > 1.5
        assert np.abs(result.trace["margin_true"][late] - 0.30).max() < 0.03


@pytest.mark.loops
def test_the_camera_path_holds_the_object() -> None:
    """The estimate is an estimate: near the truth, and not the truth."""
    changes = {"duration_s": 0.3, "load.times_s": [0.02, 0.1], "camera.rest_frames": 2}
    result = run(load_scene("margin-30hz", changes))
    summary, trace = result.summary, result.trace
    assert (summary["complete"], summary["frames"], summary["reconstructor"]) == (True, 10, "way")
    assert summary["reading_ms"]["worst"] >= summary["reading_ms"]["p95"] > 0.0
    assert summary["lateral_displacement_mm"] < 0.1
    late = trace["time_s"] > 0.2
    assert 0.15 < trace["margin_true"][late].min() < trace["margin_true"][late].max() < 0.6
    assert 0.005 < summary["margin_rmse"] < 0.3
    assert trace["markers_visible"].min() > 380


@pytest.mark.loops
def test_the_object_is_held_through_the_camera_for_long() -> None:
    # Sum of changes over time [N/s]: the grip is quiet, with an image's noise in every reading.
    trace = run(load_scene("margin-60hz", {"duration_s": 1.7})).trace
    late = trace["time_s"] > 1.2 - 1e-9
    assert 0.2 < trace["margin_true"][late].min() < trace["margin_true"][late].max() < 0.4
    assert np.abs(np.diff(trace["grip_n"][late])).sum() / 0.5 < 0.5


def test_reaction_comes_one_frame_and_the_latency_after_an_event() -> None:
    """(L + 1)·T: the first frame after the event shows it, L frames later it is answered."""
    changes = {
        "path": "truth",
        "safety_margin.start_s": 0.0,
        "safety_margin.desired_margin": 0.99,  # off its floor, so that any change shows
        "load.times_s": [0.1],
        "duration_s": 0.16,
    }
    for latency in (0, 3):
        changes["camera.latency_frames"] = latency
        pulled, still = (
            run(load_scene("camera-100hz", changes | {"load.forces_n": [load]})).trace
            for load in (0.3, 0.0)
        )
        differs = np.flatnonzero(pulled["grip_n"] != still["grip_n"])
        assert pulled["time_s"][differs[0]] == pytest.approx(0.1 + (latency + 1) * 0.01)


class Tampered:
    """A camera in front of which something else is held: other pictures, by number of the frame."""

    def __init__(self, scene: Scene, pictures: Mapping[int, Frame]) -> None:
        self._camera, self._pictures = open_camera(scene), pictures

    def expose(self, state: State, index: int, before: np.ndarray) -> Frame:
        real = self._camera.expose(state, index, before)
        return replace(self._pictures.get(index, real), time=state.time)

    def __getattr__(self, name: str) -> object:
        return getattr(self._camera, name)


def gripped(force: float, pictures: Mapping[int, Frame]) -> list[Sample]:
    """Samples of a constant grip, with a load that rises from frame 3 on."""
    changes = {"controller": "conservative", "conservative.force_n": force, "duration_s": 0.21}
    changes |= {"load.times_s": [0.1, 0.14], "load.forces_n": [0.0, 0.6], "camera.rest_frames": 2}
    changes |= {"load.interpolation": "linear", "camera.rate_hz": 30.0}
    scene = load_scene("camera-100hz", changes)
    return list(grasp(scene, Tampered(scene, pictures)))  # type: ignore[arg-type]


def test_the_pixels_decide() -> None:
    """Show the camera a harder press than the one that happens, and the estimate is of that one.

    Freeze it, and the estimate freezes, though the object is pulled ever harder.
    """
    free = gripped(3.0, {})
    frames = [sample.frame for sample in free if sample.frame is not None]
    frozen = gripped(1.5, {k: frames[min(k, 3)] for k in range(len(free))})
    true = [s.field.total_friction for s in frozen]
    assert true[-1] - true[3] > 0.25  # the world went on
    moved, stuck = ([s.observation.field for s in one] for one in (free, frozen))
    assert moved[-1].total_friction - moved[3].total_friction > 0.25
    assert abs(stuck[-1].total_friction - stuck[3].total_friction) < 0.03
    assert frozen[-1].field.total_normal == pytest.approx(1.5, rel=0.05)
    assert stuck[-1].total_normal == pytest.approx(3.0, rel=0.15)


class Moody:
    """Anybody's controller: constant, until it does something else at its sixth sample."""

    answer: object = None

    def reset(self) -> None:
        self._told = 0

    def command(self, observation: GripObservation) -> GripCommand:
        self._told += 1
        if self._told < 6:
            return GripCommand(force=1.5)
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer  # type: ignore[return-value]


QUICK = {"path": "truth", "duration_s": 0.2}


def test_a_controller_that_answers_nonsense_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is told of frame k at frame k + 1, and fails at what frame 5 shows."""
    for answer, words in (
        (
            ZeroDivisionError("no load"),
            "failed at t = .* ZeroDivisionError: no load",
        ),
        ("grip", "answered 'grip' at t = .*; expected a GripCommand with a force in N"),
        (GripCommand(force=float("nan")), "commanded nan N at t = .*; a grip force is finite"),
        (GripCommand(force=-0.1), "commanded -0.1 N at t = 0.05 s, sample 5"),
    ):
        monkeypatch.setattr(Moody, "answer", answer)
        with pytest.raises(UserError, match=f"^controller .*:Moody {words}"):
            run(load_scene("camera-100hz", QUICK), controller=Moody())


class Listening:
    """Anybody's controller that keeps what it is told, and changes its grip at each answer."""

    def __init__(self) -> None:
        self.told: list[GripObservation] = []
        self.resets: list[int] = []

    def reset(self) -> None:
        self.resets.append(len(self.told))

    def command(self, observation: GripObservation) -> GripCommand:
        self.told.append(observation)
        return GripCommand(force=1.0 + len(self.told))


def test_a_dropped_frame_is_never_heard_of() -> None:
    ear, changes = Listening(), QUICK | {"duration_s": 0.3, "camera.dropped": 0.4}
    scene, methods = choose(load_scene("camera-100hz", changes), controller=ear)
    seen = list(grasp(scene, None, methods=methods))
    kept = [s.index for s in seen if s.observation is not None]
    assert 0 < len(kept) < len(seen)
    assert kept[0] == 0
    # The first frame is answered twice: at once, and after the latency.
    told = [one.time for one in ear.told]
    assert told == pytest.approx([0.0, *(0.01 * k for k in kept if k < 30)])
    assert ear.resets == [0, 1]  # the first answer is forgotten
    for before, now in pairwise(seen):
        assert (now.grip != before.grip) == (before.observation is not None)


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


def test_a_frame_shows_the_middle_of_its_exposure() -> None:
    """While the pull rises evenly, half an exposure is worth that much less friction."""
    changes = {
        "path": "truth",
        "controller": "conservative",
        "camera.rate_hz": 50.0,
        "duration_s": 0.3,
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
    changes = {"path": "truth", "controller": "conservative", "duration_s": 0.08}
    plain, off = (
        run(load_scene("thesis", changes | {"camera.friction_bias": bias})).trace
        for bias in (0.0, 0.05)
    )
    touching = ~np.isnan(plain["margin_estimated"])
    assert touching.sum() > 50
    told = off["mu_estimated"][touching]
    assert told == pytest.approx(plain["mu_estimated"][touching] + 0.05, abs=1e-12)
    load = off["friction_true_n"][touching] / off["normal_true_n"][touching]
    margin = 1.0 - load / told
    assert off["margin_estimated"][touching] == pytest.approx(margin, abs=1e-9)
    assert off["margin_true"][touching] == pytest.approx(plain["margin_true"][touching], abs=1e-12)


def test_calm_phases_take_longer_steps_and_err_little() -> None:
    """A held load on a held grip: Γ and slip as with short steps, within what both are worth."""
    changes = {"path": "truth", "object.radius_mm": 20.0, "duration_s": 0.9}
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
