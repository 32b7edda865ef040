"""Forces, friction and margin in one's own pictures, in a folder."""

import math
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypedDict

import numpy as np

from ..by_name import Choice
from ..compiled import working_time
from ..errors import UserError, located, meant
from ..loop.trace import kind_of
from ..output.parquet import DISPLACEMENTS, FORCES, VALUES, EstimateTable, Row
from ..output.versions import versions
from ..publish import check_targets, message_of, publishing
from ..publish.targets import Send
from ..render import Frame
from ..sensing.observers import ForceObserver
from ..sensing.reader import DEFAULT_WINDOW
from ..sources import FrameSource
from ..sources.delivery import Lateness, lateness
from ..sources.source import ValueRange
from ..stored_pictures import MEGAPIXELS
from ..tracking import (
    CAMERA_RULE,
    DEFAULT_RECONSTRUCTOR,
    FRICTION,
    DisplacementGains,
    FrictionRule,
    Palette,
    SensorCalibration,
    Tracks,
    check_reconstructor,
    load_calibration,
)
from ..tracking.forces import PoseTable, body_read, rest_pose
from ..tracking.forces.chain import UsedReadOut, used
from .figure import Truth, draw_figure
from .following import Add, Came, Course, Outcome, Progress, SpeedCount, follow, opened_folder
from .opening import Opened, Setup, open_tracking
from .overlay import OVERLAY, OverlayVideo
from .readings import Read, displacement_reading, force_reading

FORMAT = "chromagrip estimate 1"
#: Files of a folder of estimates; the summary is written last.
FILES = ("summary.json", "estimates.parquet", "figure.png", OVERLAY)
#: Number of the last frames, which values, lateness and figure are of: a source may run for days.
_MOST_ROWS = 20_000


class Typical(TypedDict):
    """Values of a column: in the last frame with an estimate, its interval, and the median."""

    last: float | None
    last_interval: tuple[float, float] | None
    median: float


class Compared(TypedDict):
    """True values of a column, and the estimate's errors over the frames that have one."""

    last: float
    median: float
    rms_error: float
    inside_interval: float | None


class Estimates(TypedDict):
    """Part of a summary that counts the estimates; the last one is that of a frame.

    `late` is of the time from the arrival of a frame until its reading was made, and published.
    """

    without_estimate: int
    without_estimate_because: dict[str, int]
    last_estimate: int | None
    estimates: dict[str, Typical]
    truth: dict[str, Compared]
    mu_observable_frames: int
    ms_per_estimate: float | None
    published: bool
    late: Lateness
    skipped: int


class Method(TypedDict):
    """Part of a summary that says how forces are estimated."""

    format: str
    calibration: str
    reconstructor: str | None
    reconstructor_doubt: str | None
    readout: UsedReadOut | None
    stiffness_deviation: float | None
    friction: str | None
    rest_misfit_px: float
    camera_pose: PoseTable
    friction_window_s: float


class EstimateSummary(Method, Setup, Course, Estimates):
    """Content of `summary.json`."""

    versions: dict[str, str]


def estimate_source(
    rest: str,
    source: Choice | FrameSource,
    *,
    calibration: str,
    reconstructor: Choice,
    friction: str | None = None,
    tracker: Choice,
    window: float = DEFAULT_WINDOW,
    noise: float | None = None,
    fps: float | None = None,
    frames: int | None = None,
    out: Path | None = None,
    overwrite: bool = False,
    max_megapixels: float = MEGAPIXELS,
    value_range: ValueRange = None,
    truth: Truth | None = None,
    publish: Sequence[str] = (),
    tell: Callable[[str], None] = lambda _: None,
    progress: Progress = lambda _, __: None,
) -> Outcome[EstimateSummary]:
    """Estimate forces, µ and Γ in every frame, or displacements where there is no force model.

    With `out`, leave estimates, figure, overlay and summary in that folder; what is left where an
    extra is missing, or the source breaks off, is as in `track_source`.

    Parameters
    ----------
    calibration: name or file, see `load_calibration`
    reconstructor: name, `module:Class`, or a class or other factory, see `load_reconstructor`; not
        used on a flat pad
    friction: name of a reading of µ, see `FRICTION`; by default that of grasps
    window: moving average of the friction estimate [s]
    rest, source, tracker, noise, fps, frames, out, overwrite: see `track_source`
    max_megapixels, value_range, tell, progress: see `track_source`
    publish: targets to which each reading is sent at once, see `publish.targets`; frames of a live
        source are then skipped where newer ones have come
    truth: true value of each frame by column, if known; the summary compares the estimates with it

    Raises
    ------
    UserError
        When there is nothing to estimate, or the calibration is another sensor's.
    """
    check_targets(publish)
    known, rule = load_calibration(calibration), _friction_rule(friction)
    gains, read_with = _displacement_gains(known, calibration), None
    if gains is None:
        check_reconstructor(reconstructor, known)  # before the work
        read_with = used(reconstructor, known)
    palette = Palette.of_sensor(known.sensor)
    opened = open_tracking(
        rest,
        source,
        find=lambda *_: palette,
        tracker=tracker,
        noise=noise,
        fps=fps,
        tell=tell,
        sensor=known.sensor,
        max_megapixels=max_megapixels,
        value_range=value_range,
    )
    with located(f"calibration {calibration}"):
        pose = rest_pose(known.sensor, opened.resting)
        if gains is None:
            forces = ForceObserver(known, opened.resting, reconstructor, window, rule)
            reader = opened.reader.with_forces(forces)
            read = force_reading(reader, rule, opened, known.sensor.view, pose)
        else:
            read = displacement_reading(gains, opened, known.sensor.view, pose)
    method: Method = {
        "format": FORMAT,
        "calibration": calibration,
        "reconstructor": read_with and read_with["reconstructor"],
        "reconstructor_doubt": _assumed(reconstructor, known),
        "readout": read_with and read_with["readout"],
        "stiffness_deviation": read_with and read_with["stiffness_deviation"],
        "friction": friction,
        "rest_misfit_px": pose.error,
        "camera_pose": pose.table(),
        "friction_window_s": window,
    }
    doubt = method["reconstructor_doubt"]
    with publishing(publish) as sends, opened_folder(out, overwrite, FILES):
        rows = _Rows(read, opened, out, gains is not None, truth or {}, sends, doubt)
        summarise = partial(rows.summary, method)
        return follow(opened, rows.open_files, summarise, frames, out, progress, bool(publish))


def _displacement_gains(known: SensorCalibration, name: str) -> DisplacementGains | None:
    """Gains of a flat pad; None for a sensor with a force model.

    Raises
    ------
    UserError
        When a flat pad has none.
    """
    if not known.sensor.shape.flat:
        return None
    if known.displacement is None:
        raise UserError(
            f"calibration {name} is of a flat pad, which has no force model, and has no gains for "
            "displacements; get them from presses with `chromagrip calibrate sensor`"
        )
    return known.displacement


def _assumed(reconstructor: Choice, known: SensorCalibration) -> str | None:
    """What the default reconstructor assumes of a sensor that two of them can read, in words."""
    sensor = known.sensor
    if reconstructor != DEFAULT_RECONSTRUCTOR or sensor.shape.flat or sensor.silicone is None:
        return None
    if body_read(known) == "dome":
        return None  # nothing else reads a dome that was built
    return (
        "assumed: layers that move as in the model of the thesis, a chain of nodes; if the "
        "pictures show a dome of silicone, give --reconstructor contact"
    )


def _friction_rule(name: str | None) -> FrictionRule:
    if name is None:
        return CAMERA_RULE
    if name not in FRICTION:
        question = meant(name, FRICTION)
        raise UserError(f"no friction reading {name!r}{question}; there is {', '.join(FRICTION)}")
    return replace(CAMERA_RULE, read=FRICTION[name])


class _Rows:
    """Rows of the frames as they pass, with their table, overlay and figure.

    Parameters
    ----------
    read: gives a frame's row
    opened: tracker and frames
    out: folder of the files; None writes none
    flat: whether the rows are displacements of a flat pad
    truth: true value of each frame by column
    sends: functions that send each reading to a target
    doubt: what was assumed of the pictures, in words
    """

    def __init__(
        self,
        read: Read,
        opened: Opened,
        out: Path | None,
        flat: bool,
        truth: Truth,
        sends: Sequence[Send],
        doubt: str | None,
    ) -> None:
        self._truth, self._sends, self._doubt = truth, sends, doubt
        columns = DISPLACEMENTS if flat else FORCES
        self._columns = [name for name, (kind, _) in columns.items() if kind != "list"]
        self._skipped = 0
        self._read, self._opened, self._out, self._flat = read, opened, out, flat
        self._rows, self._late = deque[Row](maxlen=_MOST_ROWS), deque[float](maxlen=_MOST_ROWS)
        self._observable, self._reasons, self._firsts = 0, Counter[str](), dict[str, str]()
        self._clock = SpeedCount()

    def open_files(self, files: ExitStack) -> Add:
        """Open table and overlay; what adds a frame to them."""
        table = video = None
        if self._out is not None:
            columns = DISPLACEMENTS if self._flat else FORCES
            table = EstimateTable(self._out / "estimates.parquet", columns)
            video = OverlayVideo(self._out / OVERLAY, self._opened.source.fps)
            files.enter_context(table)
            files.enter_context(video)

        def add(index: int, frame: Frame, tracks: Tracks, came: Came) -> None:
            begin = working_time()
            row, draw, observation = self._read(frame, tracks)
            self._clock.add(working_time() - begin)
            row |= {"frame": index, "time_s": frame.time}
            late = time.monotonic() - came.at
            if self._sends:
                message = message_of(
                    row, observation, late_s=late, skipped=came.skipped, columns=self._columns,
                    doubt=self._doubt,
                )  # fmt: skip
                for send in self._sends:
                    send(message, frame)
                late = time.monotonic() - came.at
            self._skipped = came.skipped
            self._keep(row, late)
            if table is not None:
                table.add(row)
            if video is not None:
                video.append(draw())

        return add

    def _keep(self, row: Row, late: float) -> None:
        """Count a frame's row, and keep it without its arrays."""
        row = {key: value for key, value in row.items() if not isinstance(value, np.ndarray)}
        self._rows.append(row)
        self._late.append(late)
        if reason := str(row["no_estimate"]):
            self._reasons[self._firsts.setdefault(kind_of(reason), reason)] += 1
        else:
            self._observable += bool(row.get("mu_observable"))

    def summary(self, method: Method, course: Course) -> EstimateSummary:
        """Write the figure; the summary."""
        if self._out is not None and self._rows:
            draw_figure([*self._rows], self._flat, self._out / "figure.png", self._truth)
        setup, estimates = self._opened.setup, self._estimates()
        return {**method, **setup, **course, **estimates, "versions": versions()}

    def _estimates(self) -> Estimates:
        """Last and median value of each column, and the frames without an estimate."""
        estimated = [row for row in self._rows if not row["no_estimate"]]
        columns: dict[str, Typical] = {}
        for name in VALUES:
            values = [v for row in estimated if (v := _number(row, name)) is not None]
            if values:
                columns[name] = {
                    "last": _number(estimated[-1], name),
                    "last_interval": _interval(estimated[-1], name),
                    "median": float(np.median(values)),
                }
        return {
            "without_estimate": self._reasons.total(),
            "without_estimate_because": dict(self._reasons.most_common()),
            "last_estimate": int(str(estimated[-1]["frame"])) if estimated else None,
            "estimates": columns,
            "truth": dict(_compared(estimated, self._truth)),
            "mu_observable_frames": self._observable,
            "ms_per_estimate": self._clock.milliseconds,
            "published": bool(self._sends),
            "late": lateness(self._late, 1.0 / self._opened.source.fps),
            "skipped": self._skipped,
        }


def _compared(rows: Iterable[Row], truth: Truth) -> Iterator[tuple[str, Compared]]:
    """Compare the rows that have an estimate with the true values."""
    for name in VALUES:
        true, errors, inside = [], [], []
        for row in rows if name in truth else ():
            value, at = _number(row, name), int(str(row["frame"]))
            actual = float(truth[name][at]) if at < len(truth[name]) else math.nan
            if value is None or not math.isfinite(actual):
                continue
            true.append(actual)
            errors.append(value - actual)
            if (ends := _interval(row, name)) is not None:
                inside.append(ends[0] <= actual <= ends[1])
        if true:
            yield (
                name,
                {
                    "last": true[-1],
                    "median": float(np.median(true)),
                    "rms_error": float(np.sqrt(np.mean(np.square(errors)))),
                    "inside_interval": float(np.mean(inside)) if inside else None,
                },
            )


def _number(row: Row, name: str) -> float | None:
    value = row.get(name)
    return value if isinstance(value, float) else None


def _interval(row: Row, name: str) -> tuple[float, float] | None:
    """Interval of a column, whose ends stand before its unit; None where there is none."""
    stem, _, unit = name.rpartition("_")
    parts = (stem, f"_{unit}") if unit in ("n", "nmm") else (name, "")
    low, high = (_number(row, end.join(parts)) for end in ("_low", "_high"))
    return None if low is None or high is None else (low, high)
