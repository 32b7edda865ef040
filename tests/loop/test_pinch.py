"""Two fingers in the loop: what they hold, what a controller is told, and what is written."""

import math
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

import chromagrip
from chromagrip import UserError, load_scene
from chromagrip.control import GripObservation
from chromagrip.loop.rig import Rig
from chromagrip.loop.run import run
from chromagrip.outside.grasp import run_outside
from chromagrip.scene.scene import dump_scene
from chromagrip.scene.settings import LoadSettings
from chromagrip.sensing.margins import smaller

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


def test_the_box_is_lifted_and_held_at_the_desired_margin() -> None:
    done = run(scene())
    summary, trace = done.summary, done.trace
    assert (summary["outcome"], summary["complete"], summary["lifted"]) == ("held", True, True)
    assert summary["final_margin_true"] == pytest.approx(0.3, abs=0.12)
    assert trace["table_n"][0] == pytest.approx(0.05 * 9.81, rel=1e-6)
    assert trace["table_n"][-1] == 0.0
    assert trace["height_mm"][-1] == pytest.approx(60.0, abs=0.5)
    for finger in ("first", "second"):
        friction, normal = (trace[f"{finger}_{name}_true_n"][-1] for name in ("friction", "normal"))
        assert friction == pytest.approx(0.05 * 9.81 / 2, rel=0.02)
        assert normal == pytest.approx(trace["applied_n"][-1], rel=0.02)


def test_an_object_off_centre_turns_and_the_margin_with_torsion_says_so() -> None:
    """Each fingertip is told of a torque about its own axis; the truth path observes the truth."""
    done = run(scene(**HELD, pinch__centre_mm=[0.0, 6.0, 0.0]))
    assert done.summary["outcome"] == "turned"
    assert done.summary["largest_turn_deg"] > 20.0
    assert done.summary["smallest_limit_margin_true"] < 0.1
    lifted, torques = done.trace["time_s"] > 0.45, []
    for finger in ("first", "second"):
        of = {
            name.removeprefix(f"{finger}_"): values[lifted]
            for name, values in done.trace.columns.items()
            if name.startswith(finger)
        }
        for name in ("force_x_{}_n", "force_y_{}_n", "force_z_{}_n", "torque_{}_nmm"):
            true, estimated = (of[name.format(kind)] for kind in ("true", "estimated"))
            np.testing.assert_allclose(estimated, true, atol=1e-9)
        assert of["force_z_true_n"] == pytest.approx(-of["normal_true_n"], rel=0.02)
        sizes = np.hypot(of["force_x_true_n"], of["force_y_true_n"])
        assert sizes == pytest.approx(of["friction_true_n"], rel=0.05)
        assert (of["force_x_true_n"] > 0.5 * sizes).all()  # the weight pulls along x
        known = np.isfinite(of["mu_low"])
        assert (of["mu_low"] <= of["mu_estimated"])[known].all()
        assert (of["mu_estimated"] <= of["mu_high"])[known].all()
        torques.append(of["torque_true_nmm"])
    assert torques[0] == pytest.approx(-torques[1], abs=0.05)
    assert torques[1].max() > 0.3


def test_a_controller_is_told_of_the_smaller_margin() -> None:
    """Of a finger without contact first, and of one without an estimate last."""
    observation = Rig(scene()).reset()

    def seen(margin: float | str) -> GripObservation:
        """Observation with a margin, or with a reason for which there is none."""
        of = {"no_estimate": margin} if isinstance(margin, str) else {"margin": margin}
        return replace(observation, **of)

    for first, second, told in (
        (0.2, 0.4, 0),
        (0.4, 0.2, 1),
        (math.nan, 0.4, 0),
        (0.4, math.nan, 1),
        ("dark", 0.4, 1),
        (0.4, "dark", 0),
        ("dark", math.nan, 1),
        ("dark", "dark", 0),
    ):
        assert smaller([seen(first), seen(second)]) == told, (first, second)


@pytest.mark.loops
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


def test_a_saved_pinch_goes_on_on_the_truth_path() -> None:
    """Each finger has noise of its own."""
    rig = Rig(scene(truth__margin_noise=0.02))
    rig.reset(seed=3)
    for _ in range(8):
        rig.step(1.0)
    one, other = (
        reading.observation.margin - contact.field.safety_margin(contact.friction)
        for reading, contact in zip(rig.sample().readings, rig.truth.fingers, strict=True)
    )
    assert abs(one - other) > 1e-3
    saved, ends = rig.save(), []
    for again in (rig, Rig(rig.scene)):
        again.restore(saved)
        again.step(1.2)
        seen = again.sample().readings[1].observation
        ends.append((seen.margin, again.sample().pinch.state.second.linear.tobytes()))
    assert ends[0] == ends[1]
    with pytest.raises(UserError, match="another scene"):
        Rig(scene(duration_s=1.1)).restore(saved)


def changed(of: chromagrip.Scene, **values: float) -> chromagrip.Scene:
    """A scene with another object."""
    return msgspec.structs.replace(of, object=msgspec.structs.replace(of.object, **values))


def test_a_changed_friction_acts_as_one_that_was_planned() -> None:
    """From the frame of the change on, both fingers carry what a planned step of µ leaves them."""
    short = {"duration_s": 0.3, "pinch__hand_times_s": [0.0, 0.05, 0.2]}
    whole = scene(**short)
    at = whole.period * 12
    planned = scene(**short, object__friction_times_s=[at], object__frictions=[0.15])
    rig, other = Rig(whole), Rig(planned)
    rig.reset()
    other.reset()
    while not rig.done:
        if rig.index == 12:
            rig.change(changed(whole, friction=0.15))
        rig.step(1.0)
        other.step(1.0)
        for one, two in zip(rig.truth.fingers, other.truth.fingers, strict=True):
            assert one.field.total_friction == two.field.total_friction
            assert one.friction == two.friction == (0.15 if rig.index > 12 else 0.5)


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
    sample, alter = rig.sample(), msgspec.structs.replace
    heavier = alter(rig.scene, pinch=alter(rig.scene.pinch, mass_g=60.0))
    load = LoadSettings(times_s=(0.0,), forces_n=(1.0,))
    for call, words in (
        (rig.picture, r"^picture\(\) is for one finger .* use pictures\(\)$"),
        (lambda: sample.observation, r"readings of two fingers; use readings\[0\]"),
        (lambda: rig.change(heavier), r"only load, object\.friction and object\.stiffness_kpa"),
        (lambda: rig.change(alter(rig.scene, load=load)), r"load.times_s = .* is for one finger;"),
        (lambda: run_outside(scene(path="camera"), "camera:0"), "^frames from outside are those"),
    ):
        with pytest.raises(UserError, match=words):
            call()


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
        ({"fingers": 1}, "is for two fingers; set fingers = 2"),
        ({"pinch.shake_s": [0.5, 0.6]}, "two periods"),
        ({"pinch.fill_g": [0.0, 9.0]}, "fill_times_s has 0 entries and fill_g 2"),
    ],
)
def test_what_is_no_pinch_is_refused(changes: dict[str, Any], sentence: str) -> None:
    """And a scene of one finger says nothing of a pinch."""
    assert "[pinch]" not in dump_scene(load_scene("dome-1"))
    with pytest.raises(UserError, match=sentence):
        load_scene("pinch-lift", {**COARSE, **changes})


def test_what_is_added_is_in_trace_and_summary() -> None:
    done = run(scene(pinch__fill_times_s=[0.7, 0.9], pinch__fill_g=[0.0, 40.0]))
    trace, summary = done.trace, done.summary
    assert (summary["mass_g"], summary["final_mass_g"]) == pytest.approx((50.0, 90.0))
    middle = abs(trace["time_s"] - 0.8).argmin()
    assert trace["mass_g"][middle] == pytest.approx(70.0, abs=40.0 / 60.0 / 0.2)
    borne = trace["first_friction_true_n"][-1] + trace["second_friction_true_n"][-1]
    assert borne == pytest.approx(0.09 * 9.81, rel=0.03)


def test_a_grasp_ends_where_the_object_is_dropped() -> None:
    """A grip F and µ bear 2·µ·F; what is left in the hand is not simulated."""
    for share, outcome in ((0.8, "held"), (1.05, "dropped")):
        mass = 1e3 * share * 2 * 0.5 * 1.0 / 9.81
        lifted = scene(**HELD, pinch__mass_g=mass)
        result = run(lifted)
        assert (result.summary["outcome"], result.summary["complete"]) == (outcome, True)
    slide = result.trace["slide_mm"]
    assert slide[-1] > lifted.pinch.dropped_mm > slide[-2]
    assert len(result.trace) < lifted.frames
