"""Grip first: what controllers do where a frame leaves open whether the object slides."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from chromagrip import load_scene
from chromagrip.control import (
    Controller,
    DoubtSettings,
    GripCommand,
    GripFirstSettings,
    GripObservation,
    SafetyMarginSettings,
)
from chromagrip.control.controllers import SafetyMarginControl
from chromagrip.control.grip_first import GripFirst
from chromagrip.control.sliding import FollowingFriction, SlidingSettings
from chromagrip.loop.record import Result
from chromagrip.loop.run import run
from chromagrip.model import GROSS_SLIP, ForceField
from chromagrip.tracking import Z90

SETTINGS = GripFirstSettings()
PERIOD = 1.0 / 60.0


def seen(k: int, lower: float, half: float = 0.1, normal: float = 1.0, **more: Any) -> Any:
    margin = lower + half
    field = ForceField(
        position=np.zeros((1, 2)),
        normal=np.array([normal]),
        friction=np.array([0.5 * normal * (1.0 - margin)]),
        contact=np.ones(1, dtype=bool),
        totals_covariance=np.zeros((2, 2)),
    )
    told = {
        "time": PERIOD * k,
        "field": field,
        "friction": 0.5,
        "friction_interval": (0.4, 0.6),
        "friction_observable": True,
        "margin": margin,
        "margin_interval": (lower, margin + half),
        "lateral_displacement": math.nan,
    }
    return GripObservation(**(told | more))


def test_the_least_grip_has_the_sliding_margin_as_lower_end() -> None:
    """Γ = 1 − ΣFf/(µ·Fn) at both ends: the grip may fall by (1 − Γ_low)/(1 − 0.05), no further."""
    first = GripFirst(SETTINGS)
    first.see(seen(0, 0.24), 1.0)
    assert not first.doubt
    assert first.least == pytest.approx(0.76 / 0.95)
    assert first.most == math.inf


@pytest.mark.parametrize("lower", [0.05, 0.03, 0.0, -0.4, -math.inf])
def test_in_doubt_the_grip_does_not_fall_and_rises_to_the_ceiling(lower: float) -> None:
    """Also where the observed ΣFn is far below the command, so that its inverse says nothing."""
    first, force = GripFirst(SETTINGS), 1.0
    for k in range(2000):
        first.see(seen(k, max(lower, -1.0), margin_interval=(lower, 2.0), normal=0.2), force)
        assert first.doubt
        assert force <= first.least <= first.most
        force = first.least
    assert force == pytest.approx(1.0 if lower == 0.05 else SETTINGS.ceiling_n)


def test_where_sliding_is_seen_or_nothing_touches_there_is_no_doubt() -> None:
    first = GripFirst(SETTINGS)
    first.see(seen(0, -1.0, lateral_displacement=0.0), 1.0)
    assert (first.doubt, first.least, first.most) == (False, 0.0, math.inf)
    first.see(seen(1, -1.0, margin=math.nan, margin_interval=(math.nan, math.nan)), 1.0)
    assert (first.doubt, first.least) == (False, 0.0)


def test_safety_margin_goes_on_from_the_grip_that_doubt_asked_for() -> None:
    """When doubt ends with Γ at its target, the PI law keeps the grip: no step back."""
    controller = SafetyMarginControl(SafetyMarginSettings(start_s=0.0))
    target = controller.settings.desired_margin
    force = 0.0
    for k in range(30):  # Γ is at its target, and its interval leaves sliding open
        force = controller.command(seen(k, -0.2, half=target + 0.2)).force
    assert force > controller.settings.feedforward_n + 0.1
    for k in range(30, 60):
        after = controller.command(seen(k, target - 0.001, half=0.001)).force
        assert after == pytest.approx(force, abs=1e-6)


def test_a_margin_without_an_interval_counts_as_it_is() -> None:
    first = GripFirst(SETTINGS)
    first.see(seen(0, 0.2, margin_interval=(math.nan, math.nan)), 1.0)
    assert first.least == pytest.approx(0.7 / 0.95)


def test_a_pause_is_not_a_long_rise() -> None:
    first = GripFirst(SETTINGS)
    first.see(seen(0, 0.0, normal=1e-3), 1.0)
    first.see(seen(100000, 0.0, normal=1e-3), 1.0)
    assert 1.0 < first.least < 1.5


def test_the_longest_period_and_the_growth_are_settings() -> None:
    """After a pause, the rise counts the longest period; full growth is 1 + 0.35 times the need."""

    def least(doubt: DoubtSettings, normal: float) -> float:
        first = GripFirst(SETTINGS, doubt)
        first.see(seen(0, 0.0, normal=normal), 1.0)
        first.see(seen(100000, 0.0, normal=normal), 1.0)
        return first.least

    assert least(DoubtSettings(), 1e-3) == pytest.approx(1.0 + 0.1 * SETTINGS.rise_n_per_s)
    long = DoubtSettings(longest_period_s=0.5)
    assert least(long, 1e-3) == pytest.approx(1.0 + 0.5 * SETTINGS.rise_n_per_s)
    slow = DoubtSettings(growth=0.0, later_growth=0.0)
    assert least(slow, 3.0) == pytest.approx(3.0 / 0.95)
    assert least(DoubtSettings(), 3.0) == pytest.approx(2.0 * 3.0 / 0.95)


def test_frames_that_are_compared_may_be_fewer() -> None:
    def follows(settings: SlidingSettings) -> bool:
        friction = FollowingFriction(settings)
        for k in range(3):  # friction falls with the grip
            friction.see(PERIOD * k, 2.0 * 0.9**k, 0.3 * 0.9**k, near=True)
        return friction.follows

    assert not follows(SlidingSettings())
    assert follows(SlidingSettings(fewest_frames=3))


@pytest.mark.parametrize("rate", [30.0, 60.0, 1000.0])
def test_friction_that_follows_the_grip_down_is_sliding(rate: float) -> None:
    """ΣFf = µ·ΣFn of a slide; a held load is the same at each grip, and a falling one is ahead."""

    def found(load: float | None, change: float = 0.0) -> bool:
        follows = FollowingFriction()
        rng = np.random.default_rng(1)
        for time in np.arange(0.0, 0.3, 1.0 / rate):
            grip = 2.0 - 2.5 * time
            friction = 0.3 * grip if load is None else load * math.exp(-change * time)
            friction *= 1.0 + 0.01 * rng.standard_normal()
            follows.see(float(time), grip, friction, near=True)
        return follows.follows

    assert found(None)
    assert not found(0.5)
    assert not found(0.5, change=4.0)


def test_friction_at_a_grip_that_stays_shows_nothing() -> None:
    follows = FollowingFriction()
    for k in range(60):
        follows.see(PERIOD * k, 1.0, 0.3, near=True)
    assert not follows.follows


def test_a_ratio_that_falls_short_ends_the_suspicion() -> None:
    """After a rise of the grip by a tenth, friction of a held load has a smaller share of it."""
    follows = FollowingFriction()
    for k in range(30):
        follows.see(PERIOD * k, 1.0, 0.2 + 0.004 * k, near=True)
    assert follows.follows
    follows.see(0.5, 1.12, 0.32, near=True)
    assert not follows.follows
    assert math.isnan(follows.slid_ratio)


def test_the_ratio_at_which_it_slid_is_known_after_the_grip_rose_in_vain() -> None:
    follows = FollowingFriction()
    for k in range(30):
        follows.see(PERIOD * k, 1.0, 0.2 + 0.004 * k, near=True)
    for k in range(30, 40):
        grip = 1.03 ** (k - 29)
        follows.see(PERIOD * k, grip, 0.316 * grip, near=True)
    assert follows.slid_ratio == pytest.approx(0.316)


def held(time: float, grip: float, load: float, deviation: float) -> Any:
    """Observation of a held load whose Γ leaves little: µ is read as .4 ± .1."""
    margin = 1.0 - load / (0.4 * grip)
    told = seen(0, margin - 0.15, half=0.15, normal=grip, time=time)
    covariance = np.diag([1e-6, deviation**2])
    forces = replace(told.field, friction=np.array([load]), totals_covariance=covariance)
    return replace(told, field=forces)


def alarmed(rate: float, deviation: float = 1e-3) -> float:
    """Largest grip in 20 ms after a load that jumped by a fifth looked like sliding."""
    first, highest, force = GripFirst(SETTINGS), 0.0, 1.0
    for time in np.arange(0.0, 0.12, 1.0 / rate):
        load = 0.25 if time < 0.1 else 0.3
        first.see(held(float(time), force, load, deviation), force)
        # Once in doubt the grip follows what it asks for, and the load stays.
        force = max(force, first.least)
        highest = max(highest, force)
    return highest


def test_a_false_alarm_costs_one_rise_at_any_rate() -> None:
    """At 1000 frames/s the next rise waits until friction can tell what the last one did."""
    slow, fast = alarmed(100.0), alarmed(1000.0)
    assert 1.2 < slow < 2.0
    assert fast < 1.1 * slow


def test_friction_that_may_be_none_is_not_compared() -> None:
    assert alarmed(100.0, deviation=0.12) < alarmed(100.0)


#: µ that stands in until the skin has slipped, and its deviation.
PRIOR = (0.5, 0.4)
#: True Γ below which friction has been seen.
SEEN = 0.5
#: Error of ΣFn that makes light grips unsure [N].
FORCE_ERROR = 0.01


@dataclass
class Imitated:
    """A controller that is given a camera's observations of what the truth path shows.

    Parameters
    ----------
    controller: that is tried
    half: half-width of the interval of Γ of a firm grip that slides
    error: constant error of Γ there, in half-widths; above 0 is unsafe
    blind: times from and to which frames give no estimate [s]
    """

    controller: Controller
    half: float
    error: float
    blind: Sequence[tuple[float, float]] = ()
    told: list[tuple[GripObservation, float]] = field(default_factory=list)

    def reset(self) -> None:
        self.controller.reset()
        self.told, self._seen = [], False
        self._noise = np.random.default_rng(5)

    def command(self, observation: GripObservation) -> GripCommand:
        told = self.imitate(observation)
        given = self.controller.command(told)
        self.told.append((told, given.force))
        return given

    def imitate(self, truth: GripObservation) -> GripObservation:
        """What a camera might say of the truth."""
        hidden = replace(truth, lateral_displacement=math.nan)
        if any(low <= truth.time < high for low, high in self.blind):
            nothing = replace(truth.field, contact=np.zeros_like(truth.field.contact))
            return replace(
                hidden, field=nothing, margin=math.nan, margin_interval=(math.nan,) * 2,
                no_estimate="imitated",
            )  # fmt: skip
        if math.isnan(truth.margin):
            return hidden
        normal, friction = truth.field.total_normal, truth.field.total_friction
        self._seen |= truth.margin < SEEN
        half = math.hypot(self.half, FORCE_ERROR / normal)
        mu, deviation = truth.friction / (1.0 - self.error * half), half * truth.friction / Z90
        if not self._seen:
            mu, deviation = PRIOR
        margin = 1.0 - friction / (mu * normal) + 0.01 * self._noise.standard_normal()
        spread = half * (1.0 - truth.margin) if self._seen else (1.0 - margin) * deviation / mu
        return replace(
            hidden,
            friction=mu,
            friction_interval=(mu - Z90 * deviation, mu + Z90 * deviation if self._seen else 2.0),
            friction_observable=self._seen,
            margin=margin,
            margin_interval=(margin - spread, margin + spread),
        )


def imitated_run(
    controller: str,
    half: float,
    error: float,
    changes: dict[str, Any],
    blind: Sequence[tuple[float, float]] = (),
) -> tuple[Result, Imitated, Result]:
    """Run with imitated observations, what was told in it, and the run of the truth path."""
    scene = load_scene("margin-60hz", {"controller": controller, "path": "truth", **changes})
    rig = Imitated(scene.build_controller(), half, error, blind)
    return run(scene, controller=rig), rig, run(scene)


def never_falls_in_doubt(rig: Imitated, blind_s: float) -> bool:
    """Whether no answer to a frame that leaves sliding open is below the one before."""
    since, before = math.nan, 0.0
    for told, force in rig.told:
        since = math.nan if not told.no_estimate else told.time if math.isnan(since) else since
        blind = told.time - since > blind_s
        if (blind or told.margin_interval[0] <= 0.05) and force < before:
            return False
        before = force
    return True


@pytest.mark.parametrize("controller", ["margin-inversion", "safety-margin"])
@pytest.mark.parametrize(
    ("half", "error", "friction"),
    [(0.06, 0.0, 0.5), (0.15, 1.0, 0.15), (0.15, -1.0, 0.9), (0.15, 2.0, 0.5)],
)
def test_what_the_truth_path_holds_is_held_by_an_honest_camera(
    controller: str, half: float, error: float, friction: float
) -> None:
    """Also two half-widths out: Γ then reads 0.3 [0.15, 0.45] while the object slides."""
    changes = {
        "object.friction": friction,
        "load.times_s": [0.04, 0.4],
        "load.forces_n": [0.25, 0.65],
        "duration_s": 0.9,
    }
    done, rig, truth = imitated_run(controller, half, error, changes)
    assert never_falls_in_doubt(rig, SETTINGS.blind_s)
    slips = [1e-3 * float(r.trace["lateral_displacement_mm"][-1]) for r in (done, truth)]
    assert slips[0] < max(GROSS_SLIP, slips[1])


def test_a_load_that_comes_while_the_camera_is_blind_is_held() -> None:
    """0.4 s without an estimate, in which the load rises from 0.25 to 0.65 N."""
    changes = {"load.times_s": [0.04, 0.5], "load.forces_n": [0.25, 0.65], "duration_s": 1.2}
    for controller in ("margin-inversion", "safety-margin"):
        done, rig, _ = imitated_run(controller, 0.08, 0.5, changes, blind=[(0.45, 0.85)])
        assert never_falls_in_doubt(rig, SETTINGS.blind_s)
        assert done.summary["lateral_displacement_mm"] < 1e3 * GROSS_SLIP


def test_react_to_slip_reacts_to_what_the_image_can_show() -> None:
    """The truth path waits for 1.3 mm; an honest interval says sooner that sliding is open."""
    changes = {"load.times_s": [0.04, 0.4], "load.forces_n": [0.1, 0.65], "duration_s": 1.2}
    for half, error in ((0.1, 0.0), (0.15, 1.0)):
        done, _, truth = imitated_run("react-to-slip", half, error, changes)
        assert truth.summary["lateral_displacement_mm"] > 1.2
        assert done.summary["lateral_displacement_mm"] < 1.0


def test_a_ratio_that_falls_slowly_is_held() -> None:
    """It is compared with the largest of half a second, not with the last few frames alone."""
    friction = FollowingFriction()
    for k in range(11):  # the ratio rises at a constant grip: it looks like sliding
        friction.see(0.01 * k, 1.0, 0.3 + 0.02 * k, near=True)
    assert friction.follows
    for k in range(1, 31):  # down to 91 % in 0.3 s: by less than 8 % in any 0.15 s
        friction.see(0.1 + 0.01 * k, 1.0, 0.5 - 0.0015 * k, near=True)
    assert not friction.follows
