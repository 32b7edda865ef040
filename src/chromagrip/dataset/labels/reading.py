"""Estimates of a reconstructor from the pictures of a sequence: a baseline next to the labels.

The reconstructor receives the pictures, the picture at rest, the sensor design and the noise level.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...loop.force_row import force_row
from ...loop.methods import reconstructor_for
from ...loop.trace import counted_kinds
from ...output.parquet import Row
from ...output.processes import one_thread
from ...render import Frame
from ...scene.scene import Scene
from ...sensing.reader import Reader, known_sensor
from ...tracking import CAMERA_RULE
from .columns import INTERVALS, READ, READING
from .shot import Image, Shot
from .tables import Table

Array = NDArray[np.float64]
Values = dict[str, float | int | str]


def with_readings(
    scene: Scene,
    reconstructor: str,
    rest: Image,
    shots: Iterator[Shot],
) -> Iterator[Shot]:
    """Add a reconstructor's estimates to the labels of frames.

    Parameters
    ----------
    scene: scene of the sequence; only sensor and camera are used
    reconstructor: name of the reconstructor; `auto`: the one for the scene's body
    rest: picture of the unloaded sensor
    shots: frames with their labels
    """
    with one_thread():
        read = _reader(scene, reconstructor, rest)
        for shot in shots:
            reading = read(Frame(image=shot.image, time=float(shot.values["time_s"])))
            yield replace(shot, values=shot.values | reading)


def _reader(scene: Scene, reconstructor: str, rest: Image) -> Callable[[Frame], Values]:
    """Make a function that estimates from successive frames, or reports why the sensor cannot."""
    try:
        known, method = known_sensor(scene), reconstructor_for(scene.body, reconstructor)
        reader = Reader(
            known,
            [rest],
            reconstructor=method,
            noise=scene.camera.noise_levels,
            window=scene.safety_margin.friction_window_s,
        )
    except UserError as error:
        reason = str(error)
        return lambda frame: _values({"no_estimate": reason})

    def read(frame: Frame) -> Values:
        observation = reader.update(frame).observation
        assert observation is not None
        return _values(force_row(observation, CAMERA_RULE))

    return read


def _values(row: Row) -> Values:
    """Values of a row by column of `READING`; NaN for a missing number."""
    values: Values = {}
    for name, of in READING.items():
        value = row.get(of)
        if of == "mu_observable":
            value = bool(value)
        assert not isinstance(value, np.ndarray)  # no lists of nodes are read
        values[name] = math.nan if value is None else value
    return values


def reading_lines(reconstructor: str, tables: Iterable[Table]) -> list[str]:
    """Lines of the dataset card on the errors of the estimates; empty without a reconstructor.

    Parameters
    ----------
    reconstructor: name of the reconstructor in the recipe
    tables: table of the frames of each sequence
    """
    if not reconstructor:
        return []
    reasons: list[str] = []
    found: dict[str, list[Array]] = {name: [] for name in INTERVALS}
    for table in tables:
        touching = table["contact_nodes"] > 0
        reasons += [reason for reason in table[f"{READ}no_estimate"].tolist() if reason]
        for name in set(INTERVALS) & set(table):
            columns = [table[column] for column in (name, *INTERVALS[name])]
            found[name].append(np.stack(columns)[:, touching])
    lines = [
        f"## Reading: `{reconstructor}`",
        "",
        "Estimates of a reconstructor from the pictures, next to the labels. It is given the "
        "pictures, `rest.png`, the sensor's design and the camera's noise. Frames in contact:",
        "",
        "| of | frames | median error | within its 90 % interval |",
        "|---|---|---|---|",
    ]
    for name, parts in found.items():
        truth, low, value, high = np.concatenate([np.empty((4, 0)), *parts], axis=1)
        read = np.isfinite(truth + value)
        if read.any():
            error = float(np.median(abs(value - truth)[read]))
            covered = float(((low <= truth) & (truth <= high))[read].mean())
            lines.append(f"| `{name}` | {read.sum()} | {error:.2g} | {covered:.0%} |")
    counted = [f"- {reason}: {count} frames" for reason, count in counted_kinds(reasons).items()]
    return [*lines, "", "Frames without an estimate:", "", *(counted or ["- none"]), ""]
