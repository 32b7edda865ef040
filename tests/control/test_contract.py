"""What each controller of the registry does, whatever its law is."""

import math
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromagrip import Scene, load_scene
from chromagrip.control import Controller, GripObservation
from chromagrip.scene.controllers import CONTROLLERS

from .observed import PERIOD, field, seen

NAMES = sorted(CONTROLLERS.entries)
#: Controllers that aim at a margin, and those that never lower their grip.
AIMING = [n for n in NAMES if load_scene("margin-60hz", {"controller": n}).target_margin]
RAISING = sorted({*NAMES} - {*AIMING})


@cache
def scene_of(name: str, **changes: Any) -> Scene:
    """Scene of a controller; the changes are of its own table."""
    table = name.replace("-", "_")
    own = {f"{table}.{key}": value for key, value in changes.items()}
    return load_scene("margin-60hz", {"controller": name, **own})


def forces(controller: Controller, observations: list[GripObservation]) -> list[float]:
    return [controller.command(one).force for one in observations]


def gripped(
    controller: Controller, force: float, load: float, mu: float, count: int
) -> list[float]:
    """Commands while each grips an object of this load, after a first grip [N]."""
    commands = [force]
    for k in range(count):
        there = min(load / (mu * commands[-1]), 1.0)
        told = seen(1.0 + PERIOD * k, 1.0 - there, normal=commands[-1], mu=mu)
        commands.append(controller.command(told).force)
    return commands


def silent(time: float, size: float) -> GripObservation:
    """Observation without an estimate, whose other numbers mean nothing."""
    return seen(
        time, math.nan, normal=0.0, mu=size, no_estimate="imitated",
        field=field(0.0, size), friction_observable=size > 1.0,
    )  # fmt: skip


MARGINS = st.floats(-2.0, 1.0) | st.just(math.nan)


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=40)
@given(st.lists(st.tuples(MARGINS, st.floats(0.0, 1.0)), min_size=1, max_size=25))
def test_commands_are_forces_and_the_same_after_a_reset(
    name: str, told: list[tuple[float, float]]
) -> None:
    observations = [seen(0.01 * k, *pair) for k, pair in enumerate(told)]
    scene = scene_of(name)
    used, fresh = scene.build_controller(), scene.build_controller()
    commands = forces(used, observations)
    used.reset()
    assert forces(used, observations) == forces(fresh, observations) == commands
    assert all(0.0 <= force < math.inf for force in commands)
    if scene.grip_ceiling is not None:
        assert max(commands) <= scene.grip_ceiling


#: Observations that no sensor should give; each has what a contract of observations allows.
ODD = {
    "no friction yet": {"mu": math.nan, "margin": math.nan},
    "no interval": {"friction_interval": (math.nan, math.nan), "margin_interval": (math.nan,) * 2},
    "no bound": {"margin_interval": (-math.inf, math.inf), "friction_interval": (0.0, math.inf)},
    "a huge force": {"normal": 1e9},
    "a tiny force": {"normal": 1e-12},
    "a huge friction": {"field": field(1.0, 1e9), "margin": -2e9},
    "no friction coefficient": {"mu": 0.0, "margin": -1e9},
    "unsure sums": {"field": field(1.0, 0.2, math.inf)},
}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("odd", ODD)
def test_odd_observations_are_answered_by_a_force(name: str, odd: str) -> None:
    scene = scene_of(name)
    controller = scene.build_controller()
    forces(controller, [seen(PERIOD * k, 0.3) for k in range(5)])
    told = [seen(0.1 + PERIOD * k, **({"margin": 0.2} | ODD[odd])) for k in range(20)]  # type: ignore[arg-type]
    commands = forces(controller, told)
    assert np.isfinite(commands).all()
    assert min(commands) >= 0.0
    # A pause of a day, and the grasp goes on.
    after = forces(controller, [seen(9e4 + PERIOD * k, 0.3) for k in range(5)])
    assert np.isfinite(after).all()


@pytest.mark.parametrize("name", NAMES)
def test_frames_without_an_estimate_are_not_read_and_never_lower_the_grip(name: str) -> None:
    """The grip is held for a moment, then it rises to a ceiling, or stays where it is constant."""
    scene = scene_of(name)
    runs = []
    for size in (0.5, 1e6):
        controller = scene.build_controller()
        before = gripped(controller, 1.0, 0.3, 0.5, 60)[-1]
        runs.append(forces(controller, [silent(2.0 + PERIOD * k, size) for k in range(600)]))
    assert runs[0] == runs[1]
    assert runs[0][0] == before
    assert all(one <= other for one, other in pairwise(runs[0]))
    first = getattr(scene._settings, "grip_first", None)
    assert runs[0][-1] == pytest.approx(before if first is None else first.ceiling_n)
    if first is not None:
        rise = np.diff(runs[0])[20:60]
        assert rise == pytest.approx(first.rise_n_per_s * PERIOD)


@pytest.mark.parametrize("name", AIMING)
@pytest.mark.parametrize(("target", "mu"), [(0.15, 0.7), (0.3, 0.5), (0.6, 0.3)])
@pytest.mark.parametrize("start", [0.2, 8.0])
def test_one_that_aims_settles_at_its_target(
    name: str, target: float, mu: float, start: float
) -> None:
    """It grips harder at once where Γ is below it, and gives way where Γ is above."""
    controller = scene_of(name, desired_margin=target).build_controller()
    commands = gripped(controller, start, 0.65, mu, 240)
    assert 1.0 - 0.65 / (mu * commands[-1]) == pytest.approx(target, abs=0.02)
    low, high = (scene_of(name).build_controller() for _ in range(2))
    for controller, margin, sign in ((low, 0.1, 1.0), (high, 0.8, -1.0)):
        first = controller.command(seen(1.0, 0.3, normal=2.0)).force
        later = forces(controller, [seen(1.1 + PERIOD * k, margin, normal=2.0) for k in range(6)])
        assert sign * (later[-1] - first) > 0.0


@pytest.mark.parametrize("name", RAISING)
def test_one_without_a_target_never_lowers_its_grip(name: str) -> None:
    controller = scene_of(name).build_controller()
    margins = np.repeat([0.8, 0.3, -0.1, 0.9, 0.0, 1.0], 15)
    commands = forces(controller, [seen(PERIOD * k, m) for k, m in enumerate(margins)])
    assert all(one <= other for one, other in pairwise(commands))
    assert (commands[-1] > commands[0]) == (name == "react-to-slip")
