"""The log of a run, read from its folder."""

import os
from collections.abc import Iterator, Mapping, Sequence

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
from ..column import OUTCOMES, Column
from ..columns import FINGERS, columns_of, interval_of, prefixes
from .log_pictures import Part, raw_pictures, video_pictures
from .run_folder import RunRead
from .tactile_video import HEAD

Columns = Mapping[str, Array]


def log_of(run: RunRead) -> Log:
    """Make the log of a run; with two fingers, their topics begin with `/first` or `/second`."""
    of, scene = run.columns, run.scene
    signals = list(_signals(of, columns_of(scene.mechanics)))
    wrenches, conditions = list[Wrench](), list[Condition]()
    for before in prefixes(scene):
        signals += _target(run, before)
        wrenches += _wrenches(of, before)
        conditions += _conditions(run, before)
    if "outcome" in of:
        conditions.append(_outcome(of))
    return Log(
        name=os.path.basename(os.path.realpath(run.folder)),
        scene=run.file("scene.toml").read_text(encoding="utf-8"),
        facts={k: str(v) for k, v in run.summary.items() if isinstance(v, str | int | float)},
        signals=signals,
        wrenches=wrenches,
        conditions=conditions,
        pictures=list({1: _pictures, 2: _pictures_of_two}[scene.fingers](run)),
    )


def _signals(of: Columns, columns: Mapping[str, Column]) -> Iterator[Signal]:
    """Signals of the columns with a topic and a value."""
    for name, column in columns.items():
        if not column.topic or name not in of:
            continue
        there = np.isfinite(of[name])
        if not there.any():
            continue
        interval = interval_of(of, name)
        low, high = interval or (None, None)
        yield Signal(
            topic=_place(name.removesuffix(column.name)) + column.topic,
            unit=column.unit,
            meaning=column.meaning,
            times=of["time_s"][there],
            values=of[name][there],
            low=None if low is None else _finite(low[there]),
            high=None if high is None else _finite(high[there]),
        )


def _place(before: str) -> str:
    """Beginning of the topics of a finger, from the beginning of its columns' names."""
    return f"/{before.rstrip('_')}" if before else ""


def _finite(values: Array) -> Array:
    """Replace infinite ends of intervals by NaN."""
    return np.where(np.isfinite(values), values, np.nan)


def _target(run: RunRead, before: str) -> Iterator[Signal]:
    """Signal of the margin that the controller aims at, if it has such a setting."""
    target, times = run.scene.target_margin, run.columns["time_s"]
    if target is not None:
        yield Signal(
            topic=f"{_place(before)}/margin/target",
            unit="1",
            meaning="margin that the controller aims at",
            times=times,
            values=np.full(len(times), target),
        )


def _wrenches(of: Columns, before: str) -> Iterator[Wrench]:
    """True and estimated force and torque of the object on a fingertip, if they are known.

    The trace of a chain has sums along and across its slice only; they are x and −z.
    """
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
            meaning += "; x is the size of ΣFf, whose sign the trace does not have"
        else:
            continue
        there = np.isfinite(force).all(axis=1)
        if not there.any():
            continue
        torque = np.stack([np.zeros(len(turning)), np.zeros(len(turning)), turning], axis=1)
        yield Wrench(
            topic=f"{_place(before)}/wrench/{kind}",
            meaning=meaning,
            times=of["time_s"][there],
            force=force[there],
            torque=torque[there],
        )


def _came(run: RunRead, before: str) -> NDArray[np.bool_]:
    """Frames whose picture came, or on the truth path whose forces came, bool, shape (T,)."""
    read = "markers_visible" if run.scene.path == "camera" else "normal_estimated_n"
    return np.isfinite(run.columns[before + read])


def _conditions(run: RunRead, before: str) -> Iterator[Condition]:
    """Conditions of a finger: its estimate, lost markers, margin and slip."""
    of, times, place = run.columns, run.columns["time_s"], before.replace("_", "/")
    known, came = np.isfinite(of[f"{before}normal_estimated_n"]), _came(run, before)
    latency = 1e3 * run.scene.camera.latency_frames * run.scene.period
    states = (
        (known, OK, "forces are estimated"),
        (came & ~known, WARNING, "no forces could be estimated"),
        (~came, WARNING, "the frame was dropped"),
    )
    values = {"latency_ms": np.full(len(times), latency)}
    yield _condition(f"{place}estimate", times, states, values)
    visible = of[f"{before}markers_visible"]
    if np.isfinite(visible).any():
        lost = np.nanmax(visible) - visible
        states = (
            (lost == 0, OK, "all markers are tracked"),
            (lost > 0, WARNING, "markers are lost"),
            (np.isnan(lost), WARNING, "no picture"),
        )
        values = {"visible": visible, "lost": lost}
        yield _condition(f"{place}markers", times, states, values)
    margin = of[f"{before}margin_estimated"]
    states = (
        (margin > 0.0, OK, "the estimated margin is above 0"),
        (margin <= 0.0, ERROR, "the estimated margin is 0 or less: the contact slides"),
        (np.isnan(margin), WARNING, "the margin is not known"),
    )
    yield _condition(f"{place}grip", times, states, {"margin": margin})
    way, limit = of[f"{before}lateral_displacement_mm"], 1e3 * GROSS_SLIP
    if np.isfinite(way).any():
        states = (
            (way <= limit, OK, "held"),
            (way > limit, ERROR, "gross slip"),
            (np.isnan(way), WARNING, "the slip is not known"),
        )
        yield _condition(f"{place}slip", times, states, {"lateral_displacement_mm": way})


def _outcome(of: Columns) -> Condition:
    """Condition of the object of a pinch: the worst outcome so far."""
    states = tuple(
        (of["outcome"] == number, OK if number == 0 else ERROR, outcome)
        for number, outcome in enumerate(OUTCOMES)
    )
    values = {"turn_deg": of["turn_deg"], "slide_mm": of["slide_mm"]}
    return _condition("object", of["time_s"], states, values)


def _condition(
    name: str,
    times: Array,
    states: Sequence[tuple[NDArray[np.bool_], int, str]],
    values: Mapping[str, Array],
) -> Condition:
    """Condition whose state at a frame is the first true one."""
    chosen = np.argmax([state[0] for state in states], axis=0)
    levels = np.array([state[1] for state in states])[chosen]
    messages = [states[k][2] for k in chosen]
    return Condition(name=name, times=times, levels=levels, messages=messages, values=values)


def _pictures(run: RunRead) -> Iterator[Pictures]:
    """The camera's pictures, and the contact as drawn in the video."""
    raw = raw_pictures(run, FRAMES, "/camera")
    yield from raw
    if run.video is None:
        return
    width = run.scene.build_sensor().view.width
    meaning = "picture of the camera, from the video"
    parts = [Part(topic="/camera", meaning=meaning, top=HEAD, right=width)]
    meaning = "drawing of the estimated and the true contact"
    drawn = Part(topic="/contact", meaning=meaning, top=HEAD, left=width)
    for part in ([] if raw else parts) + [drawn]:
        yield video_pictures(run.video, part, run.columns["time_s"][_came(run, "")])


def _pictures_of_two(run: RunRead) -> Iterator[Pictures]:
    """Both cameras' raw pictures, if they were kept, and the video."""
    for finger in FINGERS:
        yield from raw_pictures(run, f"{FRAMES}/{finger}", f"/{finger}/camera")
    if run.video is not None:
        came = np.all([_came(run, before) for before in prefixes(run.scene)], axis=0)
        meaning = "both cameras' pictures with the tractions, and the object between the fingers"
        part = Part(topic="/video", meaning=meaning)
        yield video_pictures(run.video, part, run.columns["time_s"][came])
