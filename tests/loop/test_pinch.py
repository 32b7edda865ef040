"""Two fingers in the loop: what they hold, what a controller is told, and what is written."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import msgspec
import numpy as np
import pytest

import chromagrip
from chromagrip import UserError, load_scene
from chromagrip.control import GripCommand, GripObservation
from chromagrip.loop.columns import columns_of
from chromagrip.loop.rig import Rig
from chromagrip.loop.run import run
from chromagrip.loop.run_files import FILES
from chromagrip.outside.grasp import run_outside
from chromagrip.scene.scene import dump_scene
from chromagrip.scene.settings import LoadSettings
from chromagrip.sensing.margins import smaller

Typed = Callable[..., CompletedProcess[str]]

#: A light box and coarse domes, so that a run takes a second.
COARSE = {
    "path": "truth",
    "sensor": "thesis",
    "dome.pitch_mm": 0.8,
    "duration_s": 1.0,
    "pinch.mass_g": 50.0,
    "pinch.hand_times_s": [0.0, 0.2, 0.6],
    "object.size_mm": [20.0, 20.0, 16.0],
    "margin_inversion.start_n": 1.0,
}
HELD = {"controller": "conservative", "conservative.force_n": 1.0}


def scene(**changes: Any) -> chromagrip.Scene:
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    return load_scene("pinch-lift", {**COARSE, **keys})


def test_the_box_is_lifted_and_held_at_the_desired_margin(tmp_path: Path) -> None:
    done = run(scene(duration_s=1.5), tmp_path / "run")
    summary, trace = done.summary, done.trace
    assert summary["outcome"] == "held"
    assert summary["complete"]
    assert summary["final_margin_true"] == pytest.approx(0.3, abs=0.12)
    assert trace["table_n"][0] == pytest.approx(0.05 * 9.81, rel=1e-6)
    assert trace["table_n"][-1] == 0.0
    assert trace["height_mm"][-1] == pytest.approx(60.0, abs=0.5)
    for finger in ("first", "second"):
        assert trace[f"{finger}_friction_true_n"][-1] == pytest.approx(0.05 * 9.81 / 2, rel=0.02)
        assert trace[f"{finger}_normal_true_n"][-1] == pytest.approx(
            trace["applied_n"][-1], rel=0.02
        )
    assert {path.name for path in (tmp_path / "run").iterdir()} == set(FILES)
    written = json.loads((tmp_path / "run" / "summary.json").read_text(encoding="utf-8"))
    assert {key: written[key] for key in summary} == summary
    assert load_scene(str(tmp_path / "run" / "scene.toml")) == done.scene
    with pytest.raises(UserError, match="not empty"):
        run(scene(), tmp_path / "run")


def test_a_grip_that_is_too_small_drops_it() -> None:
    done = run(scene(**HELD, conservative__force_n=0.3))
    assert done.summary["outcome"] == "dropped"


def test_an_object_off_centre_turns_and_the_margin_with_torsion_says_so() -> None:
    done = run(scene(**HELD, pinch__centre_mm=[0.0, 6.0, 0.0]))
    assert done.summary["outcome"] == "turned"
    assert done.summary["largest_turn_deg"] > 20.0
    assert done.summary["smallest_limit_margin_true"] < 0.1
    # Both fingertips are told of opposite torques, each about its own axis.
    lifted = done.trace["time_s"] > 0.45
    torque = [done.trace[f"{f}_torque_true_nmm"][lifted] for f in ("first", "second")]
    assert torque[0] == pytest.approx(-torque[1], abs=0.05)
    assert abs(torque[0]).max() > 0.3


def test_same_seed_and_grips_same_bytes() -> None:
    runs = [run(scene(truth__margin_noise=0.02)) for _ in range(2)]
    other = run(scene(truth__margin_noise=0.02, seed=1))
    for name in columns_of("pinch"):
        assert runs[0].trace[name].tobytes() == runs[1].trace[name].tobytes(), name
    assert not np.array_equal(
        runs[0].trace["first_margin_estimated"], other.trace["first_margin_estimated"]
    )
    # Each finger has noise of its own.
    noise = [
        runs[0].trace[f"{f}_margin_estimated"] - runs[0].trace[f"{f}_margin_true"]
        for f in ("first", "second")
    ]
    assert abs(noise[0] - noise[1])[20:].max() > 0.01


def _seen(margin: float | str) -> GripObservation:
    """Observation with a margin, or with a reason for which there is none."""
    seen = Rig(scene()).reset()
    if isinstance(margin, str):
        return replace(seen, no_estimate=margin)
    return replace(seen, margin=margin)


@pytest.mark.parametrize(
    ("first", "second", "told"),
    [
        (0.2, 0.4, 0),
        (0.4, 0.2, 1),
        (math.nan, 0.4, 0),
        (0.4, math.nan, 1),
        ("dark", 0.4, 1),
        (0.4, "dark", 0),
        ("dark", math.nan, 1),
        ("dark", "dark", 0),
    ],
)
def test_a_controller_is_told_of_the_smaller_margin(
    first: float | str, second: float | str, told: int
) -> None:
    assert smaller([_seen(first), _seen(second)]) == told


def test_a_finger_that_lets_go_is_told_of() -> None:
    """The weight comes to lie along the pinch: no friction is needed, and one finger lets go."""
    tilts = {
        "pinch__hand_times_s": [0.0, 0.2, 0.6, 1.4],
        "pinch__hand_mm": [[0.0, 0.0, 0.0]] * 2 + [[-60.0, 0.0, 0.0]] * 2,
        "pinch__hand_turns_deg": [[0.0, 0.0, 0.0]] * 3 + [[0.0, 90.0, 0.0]],
    }
    done = run(scene(**tilts, duration_s=2.0))
    trace = done.trace
    gone = (trace["first_contact_nodes"] == 0) & (trace["time_s"] > 0.6)
    assert gone.any()
    assert (trace["smaller_finger"][gone] == 1.0).all()
    assert done.summary["outcome"] == "held"


class Constant:
    """A controller that keeps one grip."""

    def reset(self) -> None:
        """Nothing to forget."""

    def command(self, observation: GripObservation) -> GripCommand:
        return GripCommand(force=1.5)


class Failing:
    """A controller that grips, and then raises."""

    def reset(self) -> None:
        self._frames = 0

    def command(self, observation: GripObservation) -> GripCommand:
        self._frames += 1
        if self._frames > 9:
            raise RuntimeError("out of ideas")
        return GripCommand(force=1.0)


def test_what_happened_before_a_failure_is_kept(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="out of ideas"):
        run(scene(), tmp_path / "run", controller=Failing())
    written = json.loads((tmp_path / "run" / "summary.json").read_text(encoding="utf-8"))
    assert not written["complete"]
    assert written["frames"] == 10
    assert {path.name for path in (tmp_path / "run").iterdir()} == set(FILES)


def test_latency_delays_what_arrives() -> None:
    rig = Rig(scene(camera__latency_frames=3))
    rig.reset()
    arrived = []
    for _ in range(6):
        seen = rig.step(1.0)
        arrived.append(None if seen is None else seen.time)
    period = rig.scene.period
    assert arrived[:2] == [None, None]
    assert arrived[2:] == pytest.approx([0.0, period, 2 * period, 3 * period])
    with pytest.raises(UserError, match="finite"):
        rig.step(math.nan)


def _goes_on_alike(rig: Rig) -> None:
    """Two rigs that go on from the same state do so with the same bytes."""
    saved = rig.save()
    ends = []
    for again in (rig, Rig(rig.scene)):
        again.restore(saved)
        again.step(1.2)
        seen = again.sample().readings[1].observation
        assert seen is not None
        ends.append((seen.margin, again.sample().pinch.state.second.linear.tobytes()))
        again.close()
    assert ends[0] == ends[1]
    with pytest.raises(UserError, match="another scene"):
        Rig(scene(duration_s=1.1)).restore(saved)


def test_the_trace_has_force_and_torque_of_each_finger() -> None:
    """The second finger sees a turn the other way round; the truth path observes the truth."""
    changes = {"path": "truth", "sensor": "thesis", "dome.pitch_mm": 0.8, "duration_s": 1.0}
    trace = run(load_scene("pinch-offcentre", changes)).trace
    for finger, sense in (("first", -1.0), ("second", 1.0)):
        for name in ("force_x_{}_n", "force_y_{}_n", "force_z_{}_n", "torque_{}_nmm"):
            true, estimated = (trace[f"{finger}_{name.format(k)}"] for k in ("true", "estimated"))
            np.testing.assert_allclose(estimated, true, atol=1e-9)
        assert sense * trace[f"{finger}_torque_estimated_nmm"][-1] > 5.0
        assert trace[f"{finger}_force_z_true_n"][-1] == pytest.approx(
            -trace[f"{finger}_normal_true_n"][-1], rel=1e-3
        )
        assert trace[f"{finger}_force_x_true_n"][-1] == pytest.approx(
            trace[f"{finger}_friction_true_n"][-1], rel=1e-2
        )
        known = np.isfinite(trace[f"{finger}_mu_low"])
        mu, low, high = (trace[f"{finger}_mu_{k}"][known] for k in ("estimated", "low", "high"))
        assert ((low <= mu) & (mu <= high)).all()


@pytest.mark.loops
def test_each_finger_has_its_own_camera_and_a_saved_pinch_goes_on() -> None:
    rig = Rig(scene(path="camera", duration_s=0.1, camera__rest_frames=2))
    rig.reset(seed=3)
    for _ in range(3):
        rig.step(1.0)
    first, second = rig.sample().readings
    assert first.frame is not None
    assert second.frame is not None
    assert not np.array_equal(first.frame.image, second.frame.image)
    for reading in (first, second):
        assert reading.observation is not None
        assert reading.observation.field.total_normal == pytest.approx(1.0, rel=0.25)
    _goes_on_alike(rig)


def test_a_saved_pinch_goes_on_on_the_truth_path() -> None:
    rig = Rig(scene(truth__margin_noise=0.02))
    rig.reset(seed=3)
    for _ in range(20):
        rig.step(1.0)
    _goes_on_alike(rig)


def test_friction_that_changes_is_felt() -> None:
    slick = {"object__friction_times_s": [0.7], "object__frictions": [0.15]}
    done = run(scene(**HELD, **slick))
    assert done.trace["first_mu_true"][-1] == 0.15
    assert done.summary["outcome"] == "dropped"


def changed(of: chromagrip.Scene, **values: float) -> chromagrip.Scene:
    """A scene with another object."""
    return msgspec.structs.replace(of, object=msgspec.structs.replace(of.object, **values))


def test_a_changed_friction_acts_as_one_that_was_planned() -> None:
    """From the frame of the change on, both fingers carry what a planned step of µ leaves them."""
    whole = scene(duration_s=0.6)
    at = whole.period * 20
    planned = scene(duration_s=0.6, object__friction_times_s=[at], object__frictions=[0.15])
    rig, other = Rig(whole), Rig(planned)
    rig.reset()
    other.reset()
    while not rig.done:
        if rig.index == 20:
            rig.change(changed(whole, friction=0.15))
        rig.step(1.0)
        other.step(1.0)
        for one, two in zip(rig.truth.fingers, other.truth.fingers, strict=True):
            assert one.field.total_friction == two.field.total_friction
            assert one.friction == two.friction == (0.15 if rig.index > 20 else 0.5)


def test_a_softer_object_lets_the_fingers_close() -> None:
    rig = Rig(scene(path="truth"))
    rig.reset()
    for _ in range(10):
        rig.step(1.0)
    before = rig.save()
    stiff = rig.step(1.0) and rig.truth.state.closing
    rig.restore(before)
    rig.change(changed(rig.scene, stiffness_kpa=rig.scene.object.stiffness_kpa / 4.0))
    rig.step(1.0)
    assert rig.truth.state.closing > stiff + 1e-6


def test_what_is_for_one_finger_is_refused() -> None:
    """Each in one sentence, which names what is there for two."""
    rig = Rig(scene())
    rig.reset()
    with pytest.raises(UserError, match=r"^picture\(\) is for one finger .* use pictures\(\)$"):
        rig.picture()
    sample = rig.sample()
    for name in ("reading", "observation", "frame", "tracks", "rest"):
        with pytest.raises(UserError, match=r"readings of two fingers; use readings\[0\]"):
            getattr(sample, name)
    heavier = msgspec.structs.replace(rig.scene.pinch, mass_g=60.0)
    with pytest.raises(UserError, match=r"only load, object\.friction and object\.stiffness_kpa"):
        rig.change(msgspec.structs.replace(rig.scene, pinch=heavier))
    loaded = LoadSettings(times_s=(0.0,), forces_n=(1.0,))
    with pytest.raises(UserError, match=r"load.times_s = .* is for one finger;"):
        rig.change(msgspec.structs.replace(rig.scene, load=loaded))
    with pytest.raises(UserError, match=r"^frames from outside are those of one finger; this"):
        run_outside(scene(path="camera"), "camera:0")


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"body": "chain"}, 'for body = "dome"'),
        ({"load.forces_n": [0.1, 0.2]}, r"load.forces_n = \(0.1, 0.2\) is for one finger"),
        (
            {"object.shape": "ball", "object.size_mm": [], "object.rounding_mm": 0.0},
            "of finite size",
        ),
        ({"pinch.hand_mm": [[0.0, 0.0, 0.0]]}, "hand_times_s has 3 entries and hand_mm 1"),
        ({"pinch.hand_times_s": [0.1, 0.2, 0.3]}, "increase from 0"),
        ({"pinch.mass_g": 0.0}, "must be above 0"),
        ({"fingers": 1}, "is for two fingers; set fingers = 2"),
        ({"fingers": 3}, "fingers"),
        ({"pinch.shake_s": [0.5]}, "a start and an end"),
        ({"pinch.shake_s": [0.5, 0.6]}, "two periods"),
        ({"pinch.fill_g": [0.0, 9.0]}, "fill_times_s has 0 entries and fill_g 2"),
        ({"pinch.fill_times_s": [0.5, 0.2], "pinch.fill_g": [0.0, 9.0]}, "must increase"),
        ({"pinch.weight": 3.0}, "unknown key pinch.weight"),
    ],
)
def test_what_is_no_pinch_is_refused(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(UserError, match=sentence):
        load_scene("pinch-lift", {**COARSE, **changes})


def test_any_scene_is_run_by_the_same_name() -> None:
    """The fate of the box says which rig ran it: a grip of less than mg/2µ drops it."""
    dropped = chromagrip.run(scene(**HELD, conservative__force_n=0.3))
    assert dropped.summary["outcome"] == "dropped"
    assert dropped.trace["height_mm"][-1] < 60.0
    one = chromagrip.run(load_scene("dome-1", {"duration_s": 0.05}))
    assert one.summary["mechanics"] == "dome"
    given = chromagrip.run(scene(duration_s=0.1), controller=Constant)
    assert given.trace["grip_n"] == pytest.approx(1.5)


def test_a_scene_of_one_finger_says_nothing_of_a_pinch() -> None:
    assert "[pinch]" not in dump_scene(load_scene("dome-1"))


def test_on_the_command_line(typed: Typed) -> None:
    changes = [f"--set={key}={json.dumps(value)}" for key, value in COARSE.items()]
    done = typed("grasp", "--scene", "pinch-lift", *changes, "--json")
    assert json.loads(done.stdout)["outcome"] == "held"


def test_what_is_added_is_in_trace_and_summary() -> None:
    filled = {"pinch.fill_times_s": [0.7, 0.9], "pinch.fill_g": [0.0, 40.0]}
    done = run(load_scene("pinch-lift", COARSE | filled))
    trace, summary = done.trace, done.summary
    assert (summary["mass_g"], summary["final_mass_g"]) == pytest.approx((50.0, 90.0))
    middle = abs(trace["time_s"] - 0.8).argmin()
    assert trace["mass_g"][middle] == pytest.approx(70.0, abs=40.0 / 60.0 / 0.2)
    borne = trace["first_friction_true_n"][-1] + trace["second_friction_true_n"][-1]
    assert borne == pytest.approx(0.09 * 9.81, rel=0.03)
    assert summary["lifted"]


def test_a_time_in_which_nobody_can_answer_is_refused() -> None:
    with pytest.raises(UserError, match="must be above 0; inf is no limit"):
        run(scene(), answer_within_s=-1.0)


@pytest.mark.parametrize("mass", [1500.0, 1600.0])
def test_a_grasp_ends_where_the_object_is_dropped(mass: float) -> None:
    """15 N and µ 0.5 bear 2·0.5·15/9.81 = 1.53 kg; what is left in the hand is not simulated."""
    scene = load_scene("pinch-lift", {"path": "truth", "pinch.mass_g": mass})
    result = run(scene)
    assert (result.summary["outcome"], result.summary["complete"]) == ("dropped", True)
    slide = result.trace["slide_mm"]
    assert slide[-1] > scene.pinch.dropped_mm > slide[-2]
    assert len(result.trace) < scene.frames
