"""What the log of a run of one finger holds, read from its run folder."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model import GROSS_SLIP
from ...output.frames import FRAMES
from ...output.logs.entries import (
    ERROR,
    OK,
    WARNING,
    Array,
    Condition,
    Log,
    Pictures,
    Signal,
    Wrench,
)
from ...tracking import Z90
from ..trace import COLUMNS
from .log_pictures import Part, raw_pictures, video_pictures
from .report import RunRead
from .tactile_video import HEAD

Columns = Mapping[str, Array]


@dataclass(frozen=True, kw_only=True)
class Named:
    """A column of a trace, as a signal of the log.

    Attributes
    ----------
    topic: of the signal
    column: of the trace
    unit: of both
    interval: columns of the ends of its 90 % interval, or the one of its standard deviation
    """

    topic: str
    column: str
    unit: str = "1"
    interval: Sequence[str] = ()


def ends(name: str) -> tuple[str, str]:
    """Columns of the ends of a 90 % interval."""
    return f"{name}_low", f"{name}_high"


_SIGNALS = (
    Named(topic="/margin/true", column="margin_true"),
    Named(topic="/margin/estimated", column="margin_estimated", interval=ends("margin")),
    Named(topic="/limit_margin/true", column="limit_margin_true"),
    Named(
        topic="/limit_margin/estimated",
        column="limit_margin_estimated",
        interval=ends("limit_margin"),
    ),
    Named(topic="/grip_n/commanded", column="grip_n", unit="N"),
    Named(topic="/grip_n/applied", column="applied_n", unit="N"),
    Named(topic="/load_n/lateral", column="load_n", unit="N"),
    Named(topic="/mu/true", column="mu_true"),
    Named(topic="/mu/estimated", column="mu_estimated", interval=ends("mu")),
    Named(topic="/normal_n/true", column="normal_true_n", unit="N"),
    Named(
        topic="/normal_n/estimated",
        column="normal_estimated_n",
        unit="N",
        interval=("normal_deviation_n",),
    ),
    Named(topic="/friction_n/true", column="friction_true_n", unit="N"),
    Named(
        topic="/friction_n/estimated",
        column="friction_estimated_n",
        unit="N",
        interval=("friction_deviation_n",),
    ),
    Named(topic="/slip_mm/lateral_displacement", column="lateral_displacement_mm", unit="mm"),
    Named(topic="/slip_mm/rigid_slip", column="rigid_slip_mm", unit="mm"),
    Named(topic="/pressure_n_per_m/true", column="pressure_n_per_m", unit="N/m"),
    Named(topic="/markers/visible", column="markers_visible"),
)


def log_of(run: RunRead) -> Log:
    """Log of a run of one finger."""
    of = run.columns
    came = frames_that_came(run, of)
    sliding = condition_of_slip(of["time_s"], of["lateral_displacement_mm"], "slip")
    return Log(
        name=run.folder.resolve().name,
        scene=(run.folder / "scene.toml").read_text(encoding="utf-8"),
        facts=facts_of_log(run),
        signals=[*signals_of(of, _SIGNALS, COLUMNS), *target_of(run)],
        wrenches=wrenches_of(of),
        conditions=[*conditions_of(run, of, came), *sliding],
        pictures=list(_pictures(run, came)),
    )


def facts_of_log(run: RunRead) -> dict[str, str]:
    """Results that are one number or word, as text."""
    simple = {k: v for k, v in run.summary.items() if isinstance(v, str | int | float)}
    return {name: str(value) for name, value in simple.items()}


def signals_of(
    of: Columns, named: Sequence[Named], meanings: Mapping[str, str], before: str = ""
) -> list[Signal]:
    """Signals of those columns that have a value.

    Parameters
    ----------
    of: columns of a trace
    named: columns to take
    meanings: of the columns
    before: what stands before the names of the columns, such as `first_`; the topics of these begin
        with `/first`
    """
    place = _place(before)
    return [
        _signal(of, each, before, place, meanings[before + each.column])
        for each in named
        if before + each.column in of and np.isfinite(of[before + each.column]).any()
    ]


def _place(before: str) -> str:
    """Beginning of the topics of what has a name with this before it."""
    return f"/{before.rstrip('_')}" if before else ""


def _signal(of: Columns, named: Named, before: str, place: str, meaning: str) -> Signal:
    values = of[before + named.column]
    there = np.isfinite(values)
    low: Array | None = None
    high: Array | None = None
    interval = [of[before + name] for name in named.interval if before + name in of]
    if len(interval) == 2:
        low, high = interval
    elif len(interval) == 1:
        low, high = values - Z90 * interval[0], values + Z90 * interval[0]
    return Signal(
        topic=place + named.topic,
        unit=named.unit,
        meaning=meaning,
        times=of["time_s"][there],
        values=values[there],
        low=None if low is None else _finite(low[there]),
        high=None if high is None else _finite(high[there]),
    )


def _finite(values: Array) -> Array:
    """Values with NaN where an interval has no end."""
    return np.where(np.isfinite(values), values, np.nan)


def target_of(run: RunRead, before: str = "") -> list[Signal]:
    """Margin that the controller aims at; none where it has no such setting.

    `before` is as in `signals_of`.
    """
    target, times = run.scene.target_margin, run.columns["time_s"]
    if target is None:
        return []
    meaning = "margin that the controller aims at"
    values = np.full(len(times), target)
    topic = f"{_place(before)}/margin/target"
    return [Signal(topic=topic, unit="1", meaning=meaning, times=times, values=values)]


def wrenches_of(of: Columns, before: str = "") -> list[Wrench]:
    """True and estimated force and torque of the object on a fingertip, where they are known.

    The trace of a chain has sums along and across its slice only; they are x and −z. `before` is as
    in `signals_of`.
    """
    place = _place(before)
    wrenches = []
    for kind in ("true", "estimated"):
        names = [f"{before}force_{axis}_{kind}_n" for axis in "xyz"]
        meaning = f"force and torque of the object on the fingertip, {kind}; a press has a −z"
        if all(name in of and np.isfinite(of[name]).any() for name in names):
            force = np.stack([of[name] for name in names], axis=1)
            turning = 1e-3 * of[f"{before}torque_{kind}_nmm"]
        elif not before:
            normal, friction = of[f"normal_{kind}_n"], of[f"friction_{kind}_n"]
            turning = np.zeros(len(normal))
            force = np.stack([friction, turning, -normal], axis=1)
            meaning += "; x is the size of ΣFf, whose sign the trace does not tell"
        else:
            continue
        there = np.isfinite(force).all(axis=1)
        if not there.any():
            continue
        torque = np.stack([np.zeros(len(turning)), np.zeros(len(turning)), turning], axis=1)
        wrenches.append(
            Wrench(
                topic=f"{place}/wrench/{kind}",
                meaning=meaning,
                times=of["time_s"][there],
                force=force[there],
                torque=torque[there],
            )
        )
    return wrenches


def frames_that_came(run: RunRead, of: Columns, before: str = "") -> NDArray[np.bool_]:
    """Whether each frame's picture came; of the truth path, whether its forces did."""
    told = "markers_visible" if run.scene.path == "camera" else "normal_estimated_n"
    return np.isfinite(of[before + told])


def conditions_of(
    run: RunRead, of: Columns, came: NDArray[np.bool_], before: str = ""
) -> list[Condition]:
    """Whether there is an estimate, how many markers are lost, and whether the grip is safe.

    Parameters
    ----------
    run: whose scene has the camera's latency
    of: columns of a trace
    came: whether each frame's picture came
    before: as in `signals_of`
    """
    times, place = of["time_s"], before.replace("_", "/")
    known = np.isfinite(of[f"{before}normal_estimated_n"])
    latency = 1e3 * run.scene.camera.latency_frames * run.scene.period
    states = (
        (known, OK, "forces are estimated"),
        (came & ~known, WARNING, "no forces could be estimated"),
        (~came, WARNING, "the frame was dropped"),
    )
    values = {"latency_ms": np.full(len(times), latency)}
    conditions = [_condition(f"{place}estimate", times, states, values)]
    visible = of[f"{before}markers_visible"]
    if np.isfinite(visible).any():
        lost = np.nanmax(visible) - visible
        states = (
            (lost == 0, OK, "all markers are tracked"),
            (lost > 0, WARNING, "markers are lost"),
            (np.isnan(lost), WARNING, "no picture"),
        )
        values = {"visible": visible, "lost": lost}
        conditions.append(_condition(f"{place}markers", times, states, values))
    margin = of[f"{before}margin_estimated"]
    states = (
        (margin > 0.0, OK, "the estimated margin is above 0"),
        (margin <= 0.0, ERROR, "the estimated margin is 0 or less: the contact slides"),
        (np.isnan(margin), WARNING, "the margin is not known"),
    )
    return [*conditions, _condition(f"{place}grip", times, states, {"margin": margin})]


def condition_of_slip(times: Array, way: Array, name: str) -> list[Condition]:
    """Whether the object slid, in truth; none where the truth is not known."""
    if not np.isfinite(way).any():
        return []
    limit = 1e3 * GROSS_SLIP
    states = ((way <= limit, OK, "held"), (way > limit, ERROR, "gross slip"))
    return [_condition(name, times, states, {"lateral_displacement_mm": way})]


def _condition(
    name: str,
    times: Array,
    states: Sequence[tuple[NDArray[np.bool_], int, str]],
    values: Mapping[str, Array],
) -> Condition:
    """Condition whose state at a frame is the first that holds then."""
    chosen = np.argmax([state[0] for state in states], axis=0)
    levels = np.array([state[1] for state in states])[chosen]
    messages = [states[k][2] for k in chosen]
    return Condition(name=name, times=times, levels=levels, messages=messages, values=values)


def _pictures(run: RunRead, came: NDArray[np.bool_]) -> Iterator[Pictures]:
    """The camera's pictures, and beside them the contact as the video shows it."""
    raw = raw_pictures(run.folder / FRAMES, "/camera")
    yield from raw
    if run.video is None:
        return
    width = run.scene.build_sensor().view.width
    meaning = "what the camera took, as the video keeps it"
    parts = [Part(topic="/camera", meaning=meaning, top=HEAD, right=width)]
    meaning = "contact as it was estimated and as it is in truth, drawn"
    drawn = Part(topic="/contact", meaning=meaning, top=HEAD, left=width)
    for part in ([] if raw else parts) + [drawn]:
        yield video_pictures(run.video, part, run.columns["time_s"][came])
