"""Maps of a dome and of two fingers: boundaries by analysis against runs, and resumed work."""

import math
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from chromagrip.loop.trace import Trace
from chromagrip.measure.engine import measure
from chromagrip.measure.stability.grips import study as grip_study
from chromagrip.measure.stability.grips.cells import (
    OUTCOMES,
    GripCell,
    GripSetting,
    World,
    at_the_end,
    cell,
    outcome,
)
from chromagrip.measure.stability.grips.maps import maps
from chromagrip.measure.stability.grips.predicted import (
    farthest,
    heaviest,
    linear,
    pressed,
    reached,
    slide_time,
    slowest_rate,
    slowest_reaction,
)
from chromagrip.measure.study import Asked

WORLDS: tuple[World, ...] = get_args(World)
CONSTANT = GripSetting(world="pinch", controller="conservative")


@pytest.mark.studies
@pytest.mark.parametrize(("share", "word"), [(0.9, "holds"), (1.1, "dropped")])
def test_a_constant_grip_bears_the_weight_that_friction_does(share: float, word: str) -> None:
    grip = CONSTANT.scene().conservative.force_n
    found = cell(replace(CONSTANT, mass_g=share * heaviest(0.5, grip)))
    assert found.outcome == word
    assert found.grip_n == grip


@pytest.mark.studies
@pytest.mark.parametrize(("share", "word"), [(0.8, "holds"), (1.4, "turned")])
def test_a_constant_grip_bears_the_torque_of_the_limit_surface(share: float, word: str) -> None:
    grip = CONSTANT.scene().conservative.force_n
    found = cell(replace(CONSTANT, offset_mm=share * farthest(CONSTANT, grip)))
    assert found.outcome == word


@pytest.mark.studies
@pytest.mark.parametrize(("share", "holds"), [(1.5, True), (0.8, False)])
def test_past_the_rate_of_the_linearised_loop_the_object_is_lost(share: float, holds: bool) -> None:
    base = GripSetting(world="pinch", controller="safety-margin", latency_frames=2)
    found = cell(replace(base, rate_hz=share * slowest_rate(base)))
    assert (found.outcome == "holds") == holds


def test_the_torsion_of_a_press_is_that_of_hertz_at_a_light_grip() -> None:
    """3π/16 of the contact's radius, a³ = 3FR/4E*; the layer's thickness spreads it a little."""
    dome = CONSTANT.scene().build_dome()
    force, modulus = 0.3, dome.young / (1.0 - dome.poisson**2)
    radius = (0.75 * force * dome.radius / modulus) ** (1.0 / 3.0)
    assert pressed("pinch", force).torsion == pytest.approx(3.0 * math.pi / 16.0 * radius, rel=0.1)
    # and what a heavier object leaves of it: nothing where the weight alone is too much
    assert math.isnan(farthest(replace(CONSTANT, mass_g=1.01 * heaviest(0.5, 6.0)), 6.0))
    light, heavy = (replace(CONSTANT, mass_g=mass) for mass in (100.0, 200.0))
    assert farthest(light, 6.0) > 2.0 * farthest(heavy, 6.0)


def test_what_a_controller_reaches_while_the_object_slides() -> None:
    tau = slide_time(CONSTANT)  # of a rise by 60 mm in a second, with the least jerk
    assert 10.0 * tau**3 - 15.0 * tau**4 + 6.0 * tau**5 == pytest.approx(5.0 / 60.0, rel=1e-6)
    names = ("conservative", "react-to-slip", "margin-inversion", "safety-margin")
    assert {name: reached(replace(CONSTANT, controller=name)) for name in names} == {
        "conservative": 6.0,
        "react-to-slip": 6.0,  # three steps of 1 N, at 1.3, 2.6 and 3.9 mm
        "margin-inversion": 15.0,
        # On the table Γ is 1, and the grip opens to its floor.
        "safety-margin": pytest.approx(2.0 + 0.3 * (1.0 + 60.0 * (tau - 2.0 / 60.0))),
    }
    # 600 g are 1.96 times what 3 N bear: two rises by 1/0.7.
    heavy = replace(CONSTANT, controller="margin-inversion", mass_g=600.0)
    assert slowest_reaction(heavy) == pytest.approx(2.0 * 2.0 / tau)
    assert slowest_reaction(replace(heavy, controller="safety-margin")) == pytest.approx(2.0 / tau)
    assert math.isnan(slowest_reaction(replace(heavy, mass_g=200.0)))


@pytest.mark.parametrize("world", WORLDS)
def test_a_lighter_load_needs_a_faster_camera(world: World) -> None:
    base = GripSetting(world=world, controller="safety-margin")
    light = replace(base, load_n=1.0, mass_g=100.0)
    assert linear(light).plant.gain == pytest.approx(2.0 * linear(base).plant.gain)
    assert slowest_rate(light) > slowest_rate(base)
    assert slowest_rate(replace(base, latency_frames=3)) > slowest_rate(base)


def test_the_worst_outcome_counts() -> None:
    assert all(known.words for known in OUTCOMES.values())
    assert outcome("held", 0.1) == "holds"
    assert outcome("held", 0.5) == "swings"
    assert outcome("turned", 0.5) == "turned"
    time = np.arange(0.0, 3.0, 0.01)
    wave = 2.0 + np.where(time < 1.5, 1.0, 0.4) * np.cos(2.0 * np.pi * 10.0 * time)
    swings, mean = at_the_end(Trace({"time_s": time, "grip_n": wave}))
    assert swings == pytest.approx(0.4, rel=0.03)  # 2 × 0.4 of 2 N
    assert mean == pytest.approx(2.0, rel=0.01)


@pytest.mark.parametrize("world", WORLDS)
def test_every_cell_is_drawn_and_counted(
    world: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[GripSetting] = []

    def quick_cell(setting: GripSetting) -> GripCell:
        ran.append(setting)
        assert setting.scene().path == "truth"
        names = list(OUTCOMES)
        return GripCell(**vars(setting), outcome=names[len(ran) % len(names)], note="a, b")

    monkeypatch.setattr(grip_study, "cell", quick_cell)
    out, asked = tmp_path / "out", Asked(quick=True, world=world, methods=("react-to-slip",))
    report = measure("stability", "loop", asked, out=out, workers=1)
    assert len(ran) == len(set(ran))
    plan = maps(world, True, ("react-to-slip",))
    names = {f"{name}.{end}" for name in plan for end in ("csv", "png", "svg")}
    assert {path.name for path in out.iterdir()} == names | {"results.json", "index.html"}
    cells = sum(len(which.settings()) for which in plan.values())
    assert sum(row.value or 0 for row in report.rows) == cells
    assert {one.controller for one in ran} >= {"react-to-slip", "safety-margin"}


@pytest.mark.parametrize("world", WORLDS)
def test_maps_name_real_settings_and_draw_their_boundaries(world: World) -> None:
    for which in maps(world, False).values():
        assert which.lines is not None
        for panel in which.panels:
            assert which.at(panel, panel.x[0], panel.y[-1]).scene().path == "truth"
            for line in which.lines(panel):
                assert np.isfinite([line.x, line.y]).all()
