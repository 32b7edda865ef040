"""Maps of the closed loop: the prediction against an independent loop, and where methods break."""

import math
from collections import deque
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from chromagrip.loop.run import run
from chromagrip.loop.trace import Trace
from chromagrip.measure.engine import measure
from chromagrip.measure.stability import loop as loop_study
from chromagrip.measure.stability.boundaries import onset
from chromagrip.measure.stability.cells import (
    CRUSH,
    FIRST_LOAD,
    MARGIN,
    OUTCOMES,
    SWING,
    LoopCell,
    LoopSetting,
    cell,
    outcome,
    swing,
)
from chromagrip.measure.stability.linear import (
    LinearLoop,
    Plant,
    critical_gain,
    critical_integral,
    critical_period,
    held,
    noise_gain,
    plant_of,
)
from chromagrip.measure.stability.maps import (
    PRINTED,
    RETUNED,
    SLOW,
    Map,
    crushing_grip,
    maps,
)
from chromagrip.measure.study import Asked
from chromagrip.model import GROSS_SLIP, Drive, ForceField, contact_forces, simulate
from chromagrip.sensing.observers import TruthObserver

Array = NDArray[np.float64]


def in_time(loop: LinearLoop, frames: int, noise: Array) -> Array:
    """Commands of the linear loop after a unit kick, integrated in time without any polynomial."""
    fine = max(60, math.ceil(20.0 * loop.period / loop.plant.lag))
    dt = loop.period / fine
    normal, total, force = 1.0, 0.0, 0.0
    waiting: deque[float] = deque([0.0] * loop.latency)
    commands = np.zeros(frames)
    for k in range(frames):
        waiting.append(-loop.plant.gain * normal - noise[k])
        error = waiting.popleft()
        total += error * loop.period
        force = loop.proportional * error + loop.integral * total
        commands[k] = force
        for _ in range(fine):  # midpoint rule
            half = normal + 0.5 * dt * (force - normal) / loop.plant.lag
            normal += dt * (force - half) / loop.plant.lag
    return commands


@settings(max_examples=4)
@given(
    gain=st.floats(0.2, 1.5),
    lag=st.floats(2e-3, 10e-3),
    proportional=st.floats(0.1, 3.0),
    integral=st.floats(10.0, 150.0),
    latency=st.integers(0, 3),
)
def test_the_linear_loop_breaks_where_the_polynomial_says(
    gain: float, lag: float, proportional: float, integral: float, latency: int
) -> None:
    loop = LinearLoop(
        plant=Plant(gain=gain, lag=lag),
        proportional=proportional,
        integral=integral,
        period=1e-3,
        latency=latency,
    )
    critical = critical_period(loop)
    frames = 150 * (latency + 1)
    for share, grows in ((0.93, False), (1.07, True)):
        commands = abs(in_time(replace(loop, period=share * critical), frames, np.zeros(frames)))
        third = frames // 3
        assert (commands[-third:].max() > commands[third : 2 * third].max()) == grows


def test_the_polynomial_in_limits_that_can_be_solved_by_hand() -> None:
    def loop(latency: int, proportional: float, integral: float) -> LinearLoop:
        gains = {"proportional": proportional, "integral": integral}
        return LinearLoop(plant=Plant(gain=0.8, lag=1e-7), **gains, period=1e-3, latency=latency)

    # No lag, no Kp: z(z − 1)z^L + g·Ki·T·z = 0, so 1 − g·Ki·T = −1, and |z|² = g·Ki·T = 1.
    for latency, product in ((0, 2.0), (1, 1.0)):
        one = loop(latency, 0.0, 25.0)
        assert critical_period(one) == pytest.approx(product / (0.8 * 25.0), rel=1e-6)
        assert critical_integral(one) == pytest.approx(product / (0.8 * 1e-3), rel=1e-6)
    # No lag, hardly any Ki: unstable from g·Kp = 1 on, whatever the latency.
    for latency in (0, 2):
        assert critical_gain(loop(latency, 0.5, 1e-3)) == pytest.approx(2.0, rel=1e-3)


def test_noise_passes_the_loop_as_its_time_series_says() -> None:
    loop = LinearLoop(
        plant=Plant(gain=1.0, lag=3e-3), proportional=0.8, integral=40.0, period=5e-3, latency=1
    )
    noise = np.random.default_rng([0, 1]).standard_normal(6000)
    commands = in_time(loop, len(noise), noise)[200:]
    assert noise_gain(loop) == pytest.approx(commands.std(), rel=0.05)
    assert noise_gain(replace(loop, period=2 * critical_period(loop))) == math.inf


@pytest.mark.studies
@pytest.mark.parametrize(("preset", "latency"), [(PRINTED, 3), (RETUNED, 1)])
def test_the_node_model_starts_to_swing_near_the_prediction(
    preset: LoopSetting, latency: int
) -> None:
    setting = replace(preset, latency_frames=latency)
    assert onset(setting) / critical_period(setting.linear()) == pytest.approx(1.0, abs=0.3)


@pytest.mark.studies
def test_printed_gains_never_rest_at_a_cameras_rate_and_hold_at_a_kilohertz() -> None:
    kinds = [
        panel for panel in maps(False)["objects"].panels if panel.title.startswith("printed, 100")
    ]
    assert sum(len(panel.x) * len(panel.y) for panel in kinds) == 27
    setting = replace(kinds[1].base, stiffness_kpa=32.0, radius_mm=np.inf)
    scene = msgspec.structs.replace(setting.scene(), duration_s=0.5)
    assert swing(run(scene).trace, 0.5) > SWING  # under the first load already
    found = cell(replace(SLOW, friction=0.3, stiffness_kpa=32.0, radius_mm=20.0))
    assert found.swings
    assert found.displacement_mm > 1e3 * GROSS_SLIP
    found = cell(replace(PRINTED, friction=0.3))
    assert found.outcome in ("holds", "micro-slip")
    assert found.root < 1.0
    assert found.displacement_mm < 0.1


def test_past_its_boundary_the_loop_swings_and_well_below_it_does_not() -> None:
    critical = critical_integral(RETUNED.linear())
    rests = cell(replace(RETUNED, integral_n_per_s=0.4 * critical))
    swings = cell(replace(RETUNED, integral_n_per_s=1.5 * critical))
    assert rests.root < 1.0 < swings.root
    assert not rests.swings
    assert swings.swings
    assert swings.outcome in ("limit cycle", "gross slip", "crush")


def trace_of(time: Array, command: Array) -> Trace:
    return Trace({"time_s": time, "grip_n": command})


def test_a_swing_is_what_a_ramp_is_not() -> None:
    time = np.arange(0.0, 2.0, 1e-3)
    wave = 0.2 * np.cos(2 * np.pi * 20.0 * time)  # across which a line fits level
    assert swing(trace_of(time, 1.0 + wave), 2.0) == pytest.approx(0.4, rel=0.03)
    assert swing(trace_of(time, 1.0 + time), 2.0) == pytest.approx(0.0, abs=1e-9)
    # What settles in time is not a swing.
    late = np.where(time < 1.55, wave, 0.0)
    assert swing(trace_of(time, 1.0 + late), 2.0) == pytest.approx(0.0, abs=1e-12)
    assert swing(trace_of(time, 1.0 + late), 1.0) > 0.3


def test_the_worst_outcome_counts() -> None:
    calm = {"displacement_mm": 0.01, "margin_min": 0.2, "swing": 0.01, "pressure_n_per_m": 400.0}
    assert outcome(**calm) == "holds"
    for change, word in (
        ({"margin_min": 0.0}, "micro-slip"),
        ({"swing": 0.5}, "limit cycle"),
        ({"displacement_mm": 0.21}, "gross slip"),
        ({"pressure_n_per_m": CRUSH + 1.0}, "crush"),
    ):
        calm |= change
        assert outcome(**calm) == word
    assert all(known.words for known in OUTCOMES.values())


def test_noise_on_the_truth_path_is_as_large_as_stated() -> None:
    normal = np.full(20, 0.1)
    field = ForceField(
        position=np.column_stack([np.linspace(-1e-3, 1e-3, 20), np.full(20, 8e-3)]),
        normal=normal,
        friction=-0.03 * np.linspace(0.9, 5 / 3, 20),  # to the left; the last node slips at µ 0.5
        contact=np.ones(20, dtype=bool),
        totals_covariance=np.zeros((2, 2)),
    )
    observer = TruthObserver(0.05, 0.04, seed=3)
    seen = [observer.observe(1e-3 * k, field, 0.0) for k in range(2000)]
    error = np.array([one.margin for one in seen]) - field.safety_margin(0.5)
    assert error.std() == pytest.approx(0.04, rel=0.05)
    assert error.mean() == pytest.approx(0.0, abs=0.004)
    assert {round(one.friction, 12) for one in seen} == {0.5}
    inside = [a.margin_interval[0] < field.safety_margin(0.5) < a.margin_interval[1] for a in seen]
    assert np.mean(inside) == pytest.approx(0.9, abs=0.03)
    assert TruthObserver(0.05).observe(0.0, field, 0.0).field is field


@pytest.mark.studies
def test_a_grip_that_crushes_does_so_on_the_node_model() -> None:
    grip = crushing_grip(PRINTED)
    # Of the thesis's numbers: 5 N on this object are 858 N/m, and pressure grows with grip.
    assert 5.0 < grip < 8.0
    found = cell(replace(RETUNED, rate_hz=25.0, latency_frames=0, friction=0.15, step_n=2.0))
    assert grip < (0.25 + 2.0) / (0.7 * 0.15)
    assert found.outcome == "crush"


def test_what_the_linear_plant_is_and_what_it_leaves_out() -> None:
    """A rising grip moves Γ by the formula at once, a falling one by half, the rest later."""
    scene = LoopSetting(friction=0.7, radius_mm=5.0).scene()
    tip, obj = scene.build_fingertip(), scene.build_object()
    state, _, grip = held(tip, obj, FIRST_LOAD, MARGIN)

    def margins(share: float) -> Array:
        """Γ after 0.03 and 0.3 s of a grip that is off by a share."""
        drive = Drive.constant((1.0 + share) * grip, FIRST_LOAD)
        later = simulate(tip, obj, drive, dt=1e-3, duration=0.3, every=30, state=state)
        fields = [contact_forces(tip, obj, later.state(k)) for k in (1, 10)]
        return np.array([field.safety_margin(0.7) for field in fields])

    # Less what goes on anyway: the load still creeps in.
    rising, falling = ((margins(s) - margins(0.0)) / (s * grip) for s in (0.01, -0.01))
    plant = plant_of(tip, obj, FIRST_LOAD, MARGIN)
    assert rising / plant.gain == pytest.approx(0.95, abs=0.1)
    assert falling[0] / plant.gain < 0.8
    assert falling[1] / plant.gain == pytest.approx(0.95, abs=0.1)
    assert 2e-3 < plant.lag < 10e-3


@pytest.mark.studies
def test_every_map_is_drawn_and_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def quick_cell(setting: LoopSetting) -> LoopCell:
        found = list(OUTCOMES)[setting.latency_frames % len(OUTCOMES)]
        return LoopCell(**vars(setting), outcome=found, swing=0.1, root=0.5, note="a, b")

    def thin(*_: object) -> dict[str, Map]:
        return {name: replace(which, panels=which.panels[:1]) for name, which in maps(True).items()}

    monkeypatch.setattr(loop_study, "maps", thin)
    monkeypatch.setattr(loop_study, "onset", lambda one: critical_period(one.linear()))
    monkeypatch.setattr(loop_study, "cell", quick_cell)
    report = measure("stability", "loop", Asked(quick=True), out=tmp_path, workers=1)
    wanted = {f"{name}.{end}" for name in maps(True) for end in ("csv", "png", "svg")}
    assert wanted < {path.name for path in tmp_path.iterdir()}
    assert report.rows
