"""Boundaries of the closed loop: predicted, of small disturbances, and as the maps show them."""

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...control import GripObservation, SafetyMarginControl, SafetyMarginSettings
from ...model import ContactObject, Fingertip, State, contact_forces, step
from ...output.report import Row, within
from ...sensing.observers import TruthObserver
from .cells import FIRST_LOAD, MARGIN, LoopCell, LoopSetting, plant
from .linear import critical_gain, critical_period, held
from .maps import Map

#: Largest difference between prediction and boundary that counts as agreement, as a share.
AGREES = 0.30
#: Disturbance: share by which the grip is off until the first command that can react to it.
_KICK = 0.02
#: Delays for which its echo is followed.
_DELAYS = 60
#: Limits of the time for which its echo is followed [s].
_SHORTEST = 0.1
_LONGEST = 1.5
#: Periods that are searched, as shares of the predicted one.
_SEARCHED = (0.4, 2.5)
#: Number of periods in that range between which the onset is searched.
_PERIODS = 129


@dataclass(frozen=True, kw_only=True)
class Boundary:
    """Place where one line of a map crosses from rest to swinging; NaN where it does not.

    Attributes
    ----------
    map, panel: of the line
    at: latency [frames] or Kp [N] of the line
    predicted: by the linearised loop: delay (L + 1)·T [s], or both gains as a multiple of those
        half-way between the two cells
    small: delay at which a small disturbance of a held grasp grows, on the node model [s]
    rests, swings: the same quantity of the last cell at rest and of the first that swings
    """

    map: str
    panel: str
    at: float
    predicted: float
    small: float
    rests: float
    swings: float

    @property
    def middle(self) -> float:
        """Half-way between the two cells."""
        return float(np.sqrt(self.rests * self.swings))


def boundaries(
    plan: Mapping[str, Map],
    done: Mapping[LoopSetting, LoopCell],
    onsets: Mapping[LoopSetting, float],
) -> Iterator[Boundary]:
    """Boundaries of the maps of rate and latency, and of gains.

    Parameters
    ----------
    plan, done: maps, and the outcomes of their settings
    onsets: period at which a small disturbance grows, see `onset` [s]
    """
    which = plan["rate-latency"]
    for panel in which.panels:
        for latency in panel.y if panel.base.predicted else ():
            setting = which.at(panel, panel.x[0], latency)
            pair = crossing([done[which.at(panel, x, latency)] for x in panel.x])
            rests, swings = (c.linear().delay for c in pair) if pair else (np.nan, np.nan)
            delay = setting.latency_frames + 1
            yield Boundary(
                map="rate-latency",
                panel=panel.title,
                at=float(latency),
                predicted=delay * critical_period(setting.linear()),
                small=delay * onsets[setting],
                rests=rests,
                swings=swings,
            )
    which = plan["gains"]
    for panel in which.panels:
        rows = [[done[which.at(panel, x, y)] for x in panel.x] for y in panel.y]
        for line in (*rows, *map(list, zip(*rows, strict=True))):
            pair = crossing(line)
            if pair is not None:
                yield _between(panel.title, *pair)


def crossing(cells: Sequence[LoopCell]) -> tuple[LoopCell, LoopCell] | None:
    """Last cell of a line that comes to rest, and the next, which swings.

    None where the line does not cross from rest to swinging.
    """
    swings = [cell.swings for cell in cells]
    if swings[0] or not any(swings):
        return None
    first = swings.index(True)
    return cells[first - 1], cells[first]


def _between(panel: str, rests: LoopCell, swings: LoopCell) -> Boundary:
    """Boundary half-way between two cells of the map of gains."""
    kp = (rests.proportional_n, swings.proportional_n)
    ki = (rests.integral_n_per_s, swings.integral_n_per_s)
    step = math.sqrt(max(kp[1] / kp[0], ki[1] / ki[0]))
    middle = replace(
        rests.setting,
        proportional_n=math.sqrt(kp[0] * kp[1]),
        integral_n_per_s=math.sqrt(ki[0] * ki[1]),
    ).linear()
    return Boundary(
        map="gains",
        panel=panel,
        at=middle.proportional,
        # Both gains times a factor are the plant's gain times that factor.
        predicted=critical_gain(middle) / middle.plant.gain,
        small=np.nan,
        rests=1.0 / step,
        swings=step,
    )


def ratio_rows(edges: Sequence[Boundary]) -> Iterator[Row]:
    """Range of boundaries of each panel over their prediction, of both kinds."""
    for name, panel in dict.fromkeys((edge.map, edge.panel) for edge in edges):
        lines = [edge for edge in edges if (edge.map, edge.panel) == (name, panel)]
        for kind, ratios in (
            ("small", [edge.small / edge.predicted for edge in lines]),
            ("map", [edge.middle / edge.predicted for edge in lines]),
        ):
            known = [ratio for ratio in ratios if math.isfinite(ratio)]
            for word, value in (("least", min), ("largest", max)) if known else ():
                score = f"{kind}_over_predicted_{word}"
                yield within((name, panel, score), value(known), "", 1.0 - AGREES, 1.0 + AGREES)


def sentences(which: Map, edges: Sequence[Boundary]) -> list[str]:
    """Plant and boundaries of each panel of the map of rate and latency."""
    texts = []
    for panel in which.panels:
        base = panel.base
        if not base.predicted:
            continue
        dynamics = plant(base.friction, base.stiffness_kpa, base.radius_mm)
        lines = [edge for edge in edges if edge.panel == panel.title]
        texts.append(
            f"{panel.title} (g = {dynamics.gain:.2f} /N, τ = {1e3 * dynamics.lag:.1f} ms): "
            f"(latency + 1)·T may be {_range(edge.predicted for edge in lines)} ms by the "
            f"linearised loop, {_range(edge.small for edge in lines)} ms for a small disturbance, "
            f"{_range(edge.middle for edge in lines)} ms in the map"
        )
    return texts


def _range(delays: Iterable[float]) -> str:
    """Range of delays [s] in milliseconds."""
    known = [f"{1e3 * delay:.3g}" for delay in sorted(delays) if math.isfinite(delay)]
    if not known:
        return "beyond the cells of the map"
    return known[0] if known[0] == known[-1] else f"{known[0]} to {known[-1]}"


def onset(setting: LoopSetting) -> float:
    """Shortest period at which a small disturbance grows, on the node model [s].

    NaN where it grows, or does not, at every period around the predicted one.
    """
    scene = setting.scene()
    tip, obj = scene.build_fingertip(), scene.build_object()
    state, _, grip = held(tip, obj, FIRST_LOAD, MARGIN)
    predicted = critical_period(setting.linear())
    low, high = (share * predicted for share in _SEARCHED)
    periods = np.geomspace(low, high, _PERIODS).tolist()
    first = bisect_left(periods, True, key=lambda one: _grows(setting, tip, obj, state, grip, one))
    if first in (0, len(periods)):
        return math.nan
    return math.sqrt(periods[first - 1] * periods[first])


def _grows(
    setting: LoopSetting,
    tip: Fingertip,
    obj: ContactObject,
    state: State,
    grip: float,
    period: float,
) -> bool:
    """Whether the margin is further off at the end than the disturbance itself moved it."""
    gains = SafetyMarginSettings(
        desired_margin=contact_forces(tip, obj, state).safety_margin(obj.friction),
        feedforward_n=grip,
        proportional_n=setting.proportional_n,
        integral_n_per_s=setting.integral_n_per_s,
        start_s=0.0,
    )
    controller, observer = SafetyMarginControl(gains), TruthObserver(setting.window_s)
    delay = (setting.latency_frames + 1) * period
    count = round(min(max(_DELAYS * delay, _SHORTEST), _LONGEST) / period)
    substeps = math.ceil(1e3 * period - 1e-9)
    dt = period / substeps
    waiting: deque[GripObservation] = deque()
    state, force = replace(state, time=0.0), (1.0 + _KICK) * grip
    strayed = np.zeros(count)
    for k in range(count):
        observation = observer.observe(k * period, contact_forces(tip, obj, state), math.nan)
        strayed[k] = abs(observation.margin - gains.desired_margin)
        waiting.append(observation)
        if k > setting.latency_frames:  # the first frame shows the grasp before the disturbance
            force = controller.command(waiting.popleft()).force
        for _ in range(substeps):
            state = step(tip, obj, state, dt, force, FIRST_LOAD)
    return bool(strayed[-(count // 4) :].max() > _KICK * (1.0 - MARGIN))
