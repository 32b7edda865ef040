"""Grip first: what controllers do where a frame leaves open whether the object slides."""

import math
from typing import Any

import numpy as np
import pytest

from chromagrip import load_scene
from chromagrip.control import DoubtSettings, GripFirstSettings, GripObservation
from chromagrip.control.grip_first import GripFirst
from chromagrip.control.sliding import FollowingFriction
from chromagrip.tracking import Z90

from . import observed
from .observed import PERIOD

SETTINGS = GripFirstSettings()


def seen(k: int, lower: float, half: float = 0.1, **more: Any) -> GripObservation:
    """Observation of frame k, of a Γ whose interval has this lower end."""
    return observed.seen(PERIOD * k, lower + half, half, **more)


def test_the_least_grip_has_the_sliding_margin_as_lower_end() -> None:
    """Γ = 1 − ΣFf/(µ·Fn) at both ends: the grip may fall by (1 − Γ_low)/(1 − 0.05), no further."""
    first = GripFirst(SETTINGS)
    first.see(seen(0, 0.24), 1.0)
    assert not first.doubt
    assert first.least == pytest.approx(0.76 / 0.95)
    assert first.most == math.inf


@pytest.mark.parametrize("lower", [0.05, 0.03, -math.inf])
def test_in_doubt_the_grip_does_not_fall_and_rises_to_the_ceiling(lower: float) -> None:
    """Also where the observed ΣFn is far below the command, so that its inverse says nothing."""
    first, force = GripFirst(SETTINGS), 1.0
    for k in range(800):
        first.see(seen(k, max(lower, -1.0), margin_interval=(lower, 2.0), normal=0.2), force)
        assert first.doubt
        assert force <= first.least <= first.most
        force = first.least
    assert force == pytest.approx(1.0 if lower == 0.05 else SETTINGS.ceiling_n)


def test_where_sliding_is_seen_or_nothing_touches_there_is_no_doubt() -> None:
    first, unknown = GripFirst(SETTINGS), (math.nan, math.nan)
    first.see(seen(0, -1.0, lateral_displacement=0.0), 1.0)
    assert (first.doubt, first.least, first.most) == (False, 0.0, math.inf)
    first.see(observed.seen(PERIOD, math.nan), 1.0)
    assert (first.doubt, first.least) == (False, 0.0)
    first.see(seen(2, 0.2, margin_interval=unknown), 1.0)  # a margin alone counts as it is
    assert first.least == pytest.approx(0.7 / 0.95)


def test_a_rise_counts_the_longest_period_and_grows_by_the_need() -> None:
    def least(doubt: DoubtSettings, normal: float) -> float:
        first = GripFirst(SETTINGS, doubt)
        first.see(seen(0, 0.0, normal=normal), 1.0)
        first.see(seen(100000, 0.0, normal=normal), 1.0)
        return first.least

    for period in (0.1, 0.5):
        tuned = DoubtSettings(longest_period_s=period)
        assert least(tuned, 1e-3) == pytest.approx(1.0 + period * SETTINGS.rise_n_per_s)
    for growth in (0.0, 0.35):  # and later by 0.65 more
        tuned = DoubtSettings(growth=growth)
        assert least(tuned, 3.0) == pytest.approx((1.65 + growth) * 3.0 / 0.95)


@pytest.mark.parametrize("rate", [30.0, 1000.0])
def test_friction_that_follows_the_grip_down_is_sliding(rate: float) -> None:
    """ΣFf = µ·ΣFn of a slide; a held load is the same at each grip, and a falling one is ahead.

    At a grip that stays, both look alike.
    """

    def found(load: float | None, change: float = 0.0, release: float = 2.5) -> bool:
        follows = FollowingFriction()
        rng = np.random.default_rng(1)
        for time in np.arange(0.0, 0.3, 1.0 / rate):
            grip = 2.0 - release * time
            friction = 0.3 * grip if load is None else load * math.exp(-change * time)
            friction *= 1.0 + 0.01 * rng.standard_normal()
            follows.see(float(time), grip, friction, near=True)
        return follows.follows

    assert found(None)
    assert not found(0.5)
    assert not found(0.5, change=4.0)
    assert not found(None, release=0.0)


def suspected() -> FollowingFriction:
    """After half a second in which friction rose to .316 N at a grip that stays."""
    follows = FollowingFriction()
    for k in range(30):
        follows.see(PERIOD * k, 1.0, 0.2 + 0.004 * k, near=True)
    assert follows.follows
    return follows


def test_a_rise_of_the_grip_shows_whether_the_object_is_held() -> None:
    """Friction of a held load becomes a smaller share of the grip; that of a slide does not."""
    follows = suspected()
    follows.see(0.5, 1.12, 0.32, near=True)
    assert not follows.follows
    assert math.isnan(follows.slid_ratio)
    follows = suspected()
    for k in range(1, 11):
        follows.see(0.5 + PERIOD * k, 1.03**k, 0.316 * 1.03**k, near=True)
    assert follows.slid_ratio == pytest.approx(0.316)


def slid(
    name: str, half: float, error: float, mu: float, blind: tuple[float, float] = (0.0, 0.0)
) -> float:
    """Slide in 0.9 s of an object of one node, whose load rises at 0.4 s [mm].

    The controller is given what an honest camera might say, a frame late. The interval of Γ of a
    firm grip that slides has this half-width, and Γ an error of so many of them; above 0 is unsafe.
    """
    controller = load_scene("margin-60hz", {"controller": name}).build_controller()
    noise, shown, way, grip, coming = np.random.default_rng(5), False, 0.0, 0.5, 0.5
    for k in range(54):
        time, grip = PERIOD * k, coming
        load = 0.25 if time < 0.4 else 0.65
        friction = min(load, mu * grip)
        way += 1e3 * (load - friction) / 120.0 * PERIOD  # against a damper of 120 N·s/m
        used = friction / (mu * grip)
        shown |= used > 0.5
        wide = math.hypot(half, 0.01 / grip)  # light grips are unsure
        # Until friction has shown, µ is .5 ± .4.
        read, deviation = (mu / (1.0 - error * wide), wide * mu / Z90) if shown else (0.5, 0.4)
        margin = 1.0 - friction / (read * grip) + 0.01 * noise.standard_normal()
        spread = wide * used if shown else (1.0 - margin) * deviation / read
        told = observed.seen(
            time, margin, spread, normal=grip, mu=read, friction_observable=shown,
            field=observed.field(grip, friction),
            friction_interval=(read - Z90 * deviation, read + Z90 * deviation if shown else 2.0),
        )  # fmt: skip
        if blind[0] <= time < blind[1]:
            told = observed.seen(time, math.nan, normal=0.0, no_estimate="blind")
        coming = controller.command(told).force
    assert mu * coming > load
    return way


@pytest.mark.parametrize("name", ["margin-inversion", "safety-margin"])
@pytest.mark.parametrize(
    ("half", "error", "mu", "blind", "most"),
    [
        (0.06, 0.0, 0.5, (0.0, 0.0), 0.3),
        (0.15, 1.5, 0.5, (0.0, 0.0), 0.5),
        (0.15, 1.0, 0.15, (0.0, 0.0), 2.0),
        (0.08, 0.5, 0.5, (0.35, 0.7), 0.3),
    ],
)
def test_an_object_is_held_by_what_an_honest_camera_shows(
    name: str, half: float, error: float, mu: float, blind: tuple[float, float], most: float
) -> None:
    """Also where Γ reads 0.23 [0.08, 0.38] of an object that slides.

    The last load comes while there is no estimate.
    """
    assert slid(name, half, error, mu, blind) < most
