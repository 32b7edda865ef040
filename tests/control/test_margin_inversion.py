"""Margin Inversion, against what is known of the grip that it is to find."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from chromagrip.control import (
    GripObservation,
    InversionSettings,
    MarginInversion,
    MarginInversionSettings,
)

from . import observed
from .observed import PERIOD

Z90 = 1.645


def seen(
    time: float, load: float, mu: float, normal: float, deviation: float = 0.0, **more: Any
) -> GripObservation:
    """Observation of a load under a grip, with µ and its standard deviation."""
    margin = 1.0 - load / (mu * normal) if normal > 0.0 else math.nan
    interval = (mu - Z90 * deviation, mu + Z90 * deviation)
    return observed.seen(time, margin, normal=normal, mu=mu, friction_interval=interval, **more)


def held(controller: MarginInversion, frames: int, load: float, mu: float, **more: Any) -> float:
    """Force after some frames in which what is commanded is what presses, and may slip."""
    start = 0.0 if math.isnan(controller._time) else controller._time + PERIOD
    force = controller._force
    for k in range(frames):
        there = min(load, mu * force)
        force = controller.command(seen(start + PERIOD * k, there, mu, force, **more)).force
    return force


def test_the_smallest_friction_bounds_what_is_read() -> None:
    observation = seen(0.0, 0.25, 0.1, 5.0)
    for least, grip in ((0.1, 0.25 / (0.1 * 0.7)), (0.25, 0.25 / (0.1 * 0.95))):
        tuned = InversionSettings(least_friction=least)
        controller = MarginInversion(MarginInversionSettings(), tuned)
        # Grip first demands more than the larger friction does.
        assert controller.command(observation).force == pytest.approx(grip)


def test_a_new_load_is_answered_at_once() -> None:
    """No gain, no build-up: the first frame that shows a load commands the grip for it.

    A slipping skin shows no more than µ·Fn, which is answered with 1/(1 − Γ_des) times the grip,
    and with up to `surge` times that if it goes on.
    """
    controller = MarginInversion(MarginInversionSettings(caution=0.0, surge=1.2))
    before = held(controller, 100, 0.25, 0.5)
    assert held(controller, 1, 0.30, 0.5) == pytest.approx(0.30 / (0.5 * 0.7))
    controller.reset()
    held(controller, 100, 0.25, 0.5)
    assert held(controller, 1, 0.65, 0.5) == pytest.approx(before / 0.7)
    # Once more, then the load shows, and what is too much is let go.
    assert held(controller, 1, 0.65, 0.5) > 1.02 * before / 0.7**2
    assert held(controller, 100, 0.65, 0.5) == pytest.approx(0.65 / (0.5 * 0.7), rel=0.02)


def test_it_gives_way_no_faster_than_its_release() -> None:
    controller = MarginInversion(MarginInversionSettings(release_n_per_s=3.0))
    before = held(controller, 100, 0.65, 0.5)
    after = held(controller, 6, 0.1, 0.5)
    assert before - after == pytest.approx(3.0 * 6 * PERIOD)
    assert held(controller, 100, 0.1, 0.5) == pytest.approx(0.1 / 0.35, rel=0.02)
    assert held(controller, 40, 0.001, 0.5) == controller.settings.floor_n


def test_without_a_view_of_friction_it_holds_its_start_unless_the_load_is_heavy() -> None:
    """A pure press: ratios near the tissue's Poisson factor say nothing of µ (E7)."""
    for load, deviation, light in ((0.001, 0.2, True), (2.0, 0.1, False)):
        controller = MarginInversion(MarginInversionSettings(start_n=1.0))
        force = held(controller, 30, load, 0.4, deviation=deviation, friction_observable=False)
        assert force == 1.0 if light else force > load / (0.4 * 0.7)
    nothing = seen(0.0, 0.0, math.nan, 0.0)  # touches: it makes contact
    assert MarginInversion(MarginInversionSettings(start_n=1.3)).command(nothing).force == 1.3


@pytest.mark.parametrize("deviation", [0.001, 0.05])
def test_friction_that_reads_low_does_not_run_away(deviation: float) -> None:
    """Skin that sticks again under a raised grip reads µ ever lower the harder it is gripped.

    Followed down, µ = 0.49 − 0.4·(F − F0) and F = 0.65/(0.7·µ) chase each other to the lowest µ
    that is believed; counted on as far as a deviation allows, µ and the grip stay.
    """
    balance = 0.65 / (0.7 * 0.5)
    forces = []
    for tolerance in (1.0, 0.0):
        controller = MarginInversion(MarginInversionSettings(caution=0.0, tolerance=tolerance))
        force = held(controller, 100, 0.65, 0.5, deviation=deviation)
        for k in range(300):
            read = max(0.49 - 0.4 * (force - balance), 0.02)
            told = seen(10.0 + PERIOD * k, 0.65, read, force * 0.5 / read, deviation)
            force = controller.command(told).force
        forces.append(force)
    assert forces[0] == pytest.approx(balance, rel=0.02)
    assert forces[1] > 3.0 * balance


def test_friction_falls_where_it_slips() -> None:
    """Moisture: µ drops from 0.5 to 0.3, the contact slips, and friction there is µ·Fn."""
    controller = MarginInversion(MarginInversionSettings())
    held(controller, 100, 0.65, 0.5)
    force = held(controller, 30, 0.65, 0.3)
    assert 1.0 - 0.65 / (0.3 * force) == pytest.approx(0.3, abs=0.05)


@pytest.mark.parametrize("noise", [0.002, 0.02])
def test_noise_neither_shakes_nor_lifts_the_grip(noise: float) -> None:
    """Whatever the noise of the load is, it is learned: the grip stays, and stays low."""
    rng = np.random.default_rng(3)
    controller = MarginInversion(MarginInversionSettings(caution=0.0))
    forces = []
    for k in range(600):
        load = 0.65 + noise * rng.standard_normal()
        force = forces[-1] if forces else 1.9
        forces.append(controller.command(seen(PERIOD * k, load, 0.5, force)).force)
    late = np.array(forces[300:])
    assert late.mean() == pytest.approx(0.65 / 0.35, rel=0.03)
    chatter = abs(np.diff(late)).sum() / (len(late) * PERIOD)
    # Mean change of a first-order filter of white noise, plus what the odd frame adds.
    gain = 1.0 - math.exp(-PERIOD / controller.settings.smoothing_s)
    white = gain * math.sqrt(2.0 / (2.0 - gain)) * noise / 0.35 * math.sqrt(2.0 / math.pi) / PERIOD
    assert chatter < 1.5 * white


def test_an_unsure_friction_is_counted_on_less() -> None:
    sure, unsure = (
        held(MarginInversion(MarginInversionSettings(caution=1.0)), 100, 0.65, 0.5, deviation=d)
        for d in (0.0, 0.05)
    )
    assert unsure / sure == pytest.approx(0.5 / 0.45, rel=0.02)


def test_torsion_is_borne_at_the_desired_margin() -> None:
    """A contact of Hertz bears a torsion that grows with the power 4/3 of the grip."""
    pull, twist, mu, bound = 0.2, 0.6e-3, 0.5, 0.9e-3  # N, N·m, and N·m at 1 N with µ = 1
    controller, force = MarginInversion(MarginInversionSettings()), 1.0
    for k in range(300):
        borne = mu * bound * force ** (4.0 / 3.0)
        share = min(math.hypot(pull / (mu * force), twist / borne), 1.0)
        told = seen(PERIOD * k, pull, mu, force)
        margin = 1.0 - share
        force = controller.command(
            replace(told, margin=margin, margin_interval=(margin, margin), limit_margin=margin)
        ).force
    assert margin == pytest.approx(0.3, abs=0.02)
    # Without the torsion it would be the grip for the pull alone.
    assert force > 2.5 * pull / (mu * 0.7)
