"""A log as a file of Rerun, with a layout in which its viewer opens it."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...extras import need
from ...folders import write_whole
from .entries import (
    ERROR,
    OK,
    WARNING,
    Array,
    Condition,
    Log,
    Pictures,
    Signal,
    Wrench,
    nanoseconds,
)

#: Entity of the conditions.
DIAGNOSTICS = "/diagnostics"
#: Colours of lines, RGB, by the last part of their names; they are seen on black and on white.
COLOURS = {
    "true": (60, 130, 220),
    "applied": (60, 130, 220),
    "estimated": (230, 100, 30),
    "commanded": (230, 100, 30),
    "low": (235, 170, 130),
    "high": (235, 170, 130),
    "target": (140, 140, 140),
}


def write_rerun(log: Log, path: Path) -> None:
    """Write a log as a file of Rerun, which is whole or not there.

    The SDK only prints an error of the disk. So it writes into memory here, and Python to the disk.

    Raises
    ------
    UserError
        When it cannot be written, such as on a full disk.
    """
    rr = need("rerun", "viz")
    stream = rr.RecordingStream("chromagrip")
    memory = stream.binary_stream()
    stream.send_blueprint(_blueprint(log))
    stream.send_recording_name(log.name)
    for signal in log.signals:
        _send_signal(rr, stream, signal)
    for wrench in log.wrenches:
        _send_wrench(rr, stream, wrench)
    for condition in log.conditions:
        _send_condition(rr, stream, condition)
    for pictures in log.pictures:
        _send_pictures(rr, stream, pictures)
    told = "\n".join(f"| {name} | {value} |" for name, value in log.facts.items())
    text = f"| {log.name} | |\n|---|---|\n{told}\n\n```toml\n{log.scene}\n```"
    document = rr.TextDocument(text, media_type="text/markdown")
    stream.log("/run", document, static=True, strict=True)
    write_whole(path, memory.read(flush=True))
    stream.disconnect()


def _column(rr: Any, times: Array) -> list[Any]:
    return [rr.TimeColumn("time", duration=nanoseconds(times).astype("timedelta64[ns]"))]


def _send_lines(
    rr: Any,
    stream: Any,
    topic: str,
    times: Array,
    values: Array,
    names: Sequence[str],
) -> None:
    """Send values of shape (N, number of names) as lines of these names."""
    colour = COLOURS.get(topic.rpartition("/")[2])
    lines = rr.SeriesLines(names=names, colors=None if colour is None else [colour])
    stream.log(topic, lines, static=True, strict=True)
    sent = rr.Scalars.columns(scalars=values.ravel()).partition([len(names)] * len(times))
    stream.send_columns(topic, indexes=_column(rr, times), columns=sent, strict=True)


def _send_signal(rr: Any, stream: Any, signal: Signal) -> None:
    """Send a signal; the ends of its interval are entities below it."""
    unit = "" if signal.unit == "1" else f" [{signal.unit}]"
    name = " ".join(signal.topic.rpartition("/")[2].split("_")) + unit
    values = signal.values[:, None]
    _send_lines(rr, stream, signal.topic, signal.times, values, [name])
    meaning = rr.AnyValues(unit=signal.unit, meaning=signal.meaning)
    stream.log(signal.topic, meaning, static=True, strict=True)
    for end, column in (("low", signal.low), ("high", signal.high)):
        known = np.zeros(0, bool) if column is None else np.isfinite(column)
        if column is not None and known.any():
            place = f"{signal.topic}/{end}"
            values = column[known][:, None]
            _send_lines(rr, stream, place, signal.times[known], values, [f"{name}, {end}"])


def _send_wrench(rr: Any, stream: Any, wrench: Wrench) -> None:
    for kind, values in (("force_n", wrench.force), ("torque_nm", wrench.torque)):
        unit = "[N]" if kind == "force_n" else "[N m]"
        names = [f"{axis} {unit}" for axis in "xyz"]
        _send_lines(rr, stream, f"{wrench.topic}/{kind}", wrench.times, values, names)
    meaning = rr.AnyValues(unit="N, N·m", meaning=wrench.meaning)
    stream.log(wrench.topic, meaning, static=True, strict=True)


def _send_condition(rr: Any, stream: Any, condition: Condition) -> None:
    """Send the words of a condition wherever they change."""
    words = np.array(condition.messages)
    new = np.flatnonzero(np.append(True, words[1:] != words[:-1]))
    levels = {OK: "INFO", WARNING: "WARN", ERROR: "ERROR"}
    sent = rr.TextLog.columns(
        text=[f"{condition.name}: {words[k]}" for k in new],
        level=[levels[int(condition.levels[k])] for k in new],
    )
    place = f"{DIAGNOSTICS}/{condition.name}"
    indexes = _column(rr, condition.times[new])
    stream.send_columns(place, indexes=indexes, columns=sent, strict=True)


def _send_pictures(rr: Any, stream: Any, pictures: Pictures) -> None:
    kind = f"image/{pictures.encoding}"
    for batch in _batches(pictures.read()):
        times = np.array([time for time, _ in batch])
        sent = rr.EncodedImage.columns(
            blob=[data for _, data in batch], media_type=[kind] * len(batch)
        )
        indexes = _column(rr, times)
        stream.send_columns(pictures.topic, indexes=indexes, columns=sent, strict=True)


def _batches(of: Iterator[tuple[float, bytes]]) -> Iterator[list[tuple[float, bytes]]]:
    batch = []
    at_once = 100  # pictures that are sent at once
    for one in of:
        batch.append(one)
        if len(batch) == at_once:
            yield batch
            batch = []
    if batch:
        yield batch


def _blueprint(log: Log) -> Any:
    """Layout: pictures and diagnoses to the left, plots to the right."""
    views = need("rerun.blueprint", "viz")
    groups = list(dict.fromkeys(signal.topic.rpartition("/")[0] for signal in log.signals))
    groups += [wrench.topic for wrench in log.wrenches]

    def plots(chosen: Sequence[str]) -> list[Any]:
        return [views.TimeSeriesView(origin=group, name=group.strip("/")) for group in chosen]

    # Groups of signals whose plots are open at first, the uppermost first; the others lie behind.
    first = ("margin", "grip_n", "mu", "friction_n")
    # Plots of two fingers stand side by side.
    rows = [[group for group in groups if group.rpartition("/")[2] == name] for name in first]
    rest = [group for group in groups if group.rpartition("/")[2] not in first]
    right = [views.Horizontal(*plots(row)) for row in rows if row]
    right += [views.Tabs(*plots(rest))] if rest else []
    pictures = [one.topic for one in log.pictures]
    left = [views.Spatial2DView(origin=topic, name=topic.strip("/")) for topic in pictures]
    words = views.TextLogView(origin=DIAGNOSTICS, name="diagnostics")
    left.append(views.Tabs(words, views.TextDocumentView(origin="/run", name="run")))
    return views.Blueprint(
        views.Horizontal(views.Vertical(*left), views.Vertical(*right)), collapse_panels=True
    )
