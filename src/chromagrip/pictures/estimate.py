"""Forces, friction and margin from a source of frames, into a folder that stays readable."""

import math
import re
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..control import GripObservation
from ..errors import UserError, located
from ..loop.observers import ForceObserver
from ..output.parquet import DISPLACEMENTS, FORCES, VALUES, EstimateTable
from ..render import Frame, View
from ..tracking import (
    CAMERA_RULE,
    DEFAULT_TRACKER,
    FRICTION,
    Z90,
    FrictionRule,
    Palette,
    Tracks,
    check_reconstructor,
    load_calibration,
)
from ..tracking.forces import DisplacementGains, check_rest, skin_displacement
from .figure import draw_figure, draw_forces
from .overlay import OverlayVideo, draw_tracks
from .track import Add, Outcome, Progress, Tracking, follow, open_folder, open_tracking

#: What each frame gives: a row of the table, and what draws it.
Draw = Callable[[], NDArray[np.uint8]]
Read = Callable[[Frame, Tracks], tuple[dict[str, Any], Draw]]

FORMAT = "chromagrip estimate 1"
#: What a folder of estimates holds; the summary is written last.
FILES = ("summary.json", "estimates.parquet", "figure.png", "overlay.mp4")
#: Moving average of the friction estimate [s].
DEFAULT_WINDOW = 0.3
#: A single marker's error must not stand for the whole.
_DEEPEST = 0.95


def estimate_source(
    rest: str,
    source: str,
    *,
    calibration: str,
    reconstructor: str,
    friction: str | None = None,
    tracker: str,
    window: float = DEFAULT_WINDOW,
    noise: float | None = None,
    fps: float | None = None,
    frames: int | None = None,
    out: Path | None = None,
    force: bool = False,
    tell: Callable[[str], None] = lambda _: None,
    progress: Progress = lambda _, __: None,
) -> Outcome:
    """Estimate forces, µ and Γ in every frame, or displacements where there is no force model.

    With `out`, leave estimates, figure, overlay and summary in that folder. Interruptions and
    sources that break off leave what there is, see `track_source`.

    Parameters
    ----------
    calibration: name or file, see `load_calibration`
    reconstructor: name or module:Class, see `load_reconstructor`; not used on a flat pad
    friction: name of a reading of µ, see `FRICTION`; None is what grasps use
    window: moving average of the friction estimate [s]
    rest, source, tracker, noise, fps, frames, out, force, tell, progress: see `track_source`

    Raises
    ------
    UserError
        When there is nothing to estimate, or the calibration is another sensor's.
    """
    with located(f"calibration {calibration}"):
        known = load_calibration(calibration)
        rule = _friction_rule(friction)
        palette = Palette.of_sensor(known.sensor)
        flat = known.sensor.shape.flat
        gains = known.displacement if flat else None
        if flat and gains is None:
            raise UserError(
                f"calibration {calibration} is of a flat pad, which has no force model, and has no "
                "gains for displacements; get them from presses with `chromagrip calibrate sensor`"
            )
        if not flat:
            check_reconstructor(reconstructor, known)  # before the work
        tracking = open_tracking(
            rest, source, palette=palette, tracker=tracker, noise=noise, fps=fps, tell=tell
        )
        misfit = check_rest(known.sensor, tracking.resting)
        if gains is not None:
            read = _read_displacements(gains, tracking)
        else:
            _check_tracker(tracking)
            observer = ForceObserver(known, tracking.resting, reconstructor, window, rule)
            read = _read_forces(observer, rule, tracking, known.sensor.view)
    if out is not None:
        open_folder(out, force, FILES)
    table_columns = DISPLACEMENTS if flat else FORCES
    kept: list[dict[str, Any]] = []
    seconds = 0.0

    def open_files(files: ExitStack) -> Add:
        table = video = None
        if out is not None:
            table = files.enter_context(EstimateTable(out / "estimates.parquet", table_columns))
            video = files.enter_context(OverlayVideo(out / "overlay.mp4", tracking.source.fps))

        def add(index: int, frame: Frame, tracks: Tracks) -> None:
            nonlocal seconds
            begin = time.perf_counter()
            row, draw = read(frame, tracks)
            seconds += time.perf_counter() - begin
            row |= {"frame": index, "time_s": frame.time}
            kept.append({name: v for name, v in row.items() if not isinstance(v, np.ndarray)})
            if table is not None and video is not None:
                table.add(row)
                video.append(draw())

        return add

    def results() -> dict[str, Any]:
        if out is not None and kept:
            draw_figure(kept, flat, out / "figure.png")
        return _summary(kept, seconds)

    told = {
        "format": FORMAT,
        "calibration": calibration,
        "reconstructor": None if flat else reconstructor,
        "friction": friction,
        "rest_misfit_px": misfit,
        "friction_window_s": window,
        **tracking.told,
    }
    return follow(tracking, told, open_files, frames, out, progress, results)


def _friction_rule(name: str | None) -> FrictionRule:
    if name is None:
        return CAMERA_RULE
    if name not in FRICTION:
        raise UserError(f"no friction reading {name!r}; there is {', '.join(FRICTION)}")
    return replace(CAMERA_RULE, read=FRICTION[name])


def _read_forces(
    observer: ForceObserver, rule: FrictionRule, tracking: Tracking, view: View
) -> Read:
    def read(frame: Frame, tracks: Tracks) -> tuple[dict[str, Any], Draw]:
        seen = observer.observe(frame.time, tracks)
        row = _force_row(seen, rule)
        row["markers_seen"] = int(tracks.visible.all(axis=0).sum())
        return row, lambda: draw_forces(frame.image, view, tracks, tracking.resting, seen)

    return read


def _force_row(seen: GripObservation, rule: FrictionRule) -> dict[str, Any]:
    """What an observation says; null what it does not."""
    if seen.no_estimate:
        return {"no_estimate": seen.no_estimate}
    field = seen.field
    row: dict[str, Any] = {"no_estimate": ""}
    told = [("mu", "", seen.friction, seen.friction_interval)]
    told.append(("margin", "", seen.margin, seen.margin_interval))
    for k, (name, total) in enumerate(
        (("normal", field.total_normal), ("friction", field.total_friction))
    ):
        half = Z90 * math.sqrt(field.totals_covariance[k, k])
        # In this order a NaN stays one.
        told.append((name, "_n", total, (max(total - half, 0.0), total + half)))
    for name, unit, value, (low, high) in told:
        for end, number in (("", value), ("_low", low), ("_high", high)):
            row[f"{name}{end}{unit}"] = number if math.isfinite(number) else None
    row["mu_observable"] = rule.read(field).observable
    row["node_normal_n"] = field.normal.astype(np.float32)
    row["node_friction_n"] = field.friction.astype(np.float32)
    return row


def _read_displacements(gains: DisplacementGains, tracking: Tracking) -> Read:
    def read(frame: Frame, tracks: Tracks) -> tuple[dict[str, Any], Draw]:
        moved, covariance = skin_displacement(gains, tracking.resting, tracks)
        row: dict[str, Any] = {"markers_seen": int(tracks.visible.all(axis=0).sum())}
        known = moved[np.isfinite(moved).all(axis=1)]
        if len(known):
            deep = float(np.quantile(known[:, 2], _DEEPEST))
            shift = known[known[:, 2] >= min(0.5 * deep, deep), :2].mean(axis=0)
            typical = float(np.sqrt(np.nanmedian(covariance[:, 2, 2])))
            for name, value in zip(
                ("depth_mm", "shift_x_mm", "shift_y_mm", "deviation_mm"),
                (deep, *shift.tolist(), typical),
                strict=True,
            ):
                row[name] = 1e3 * value
            row["no_estimate"] = ""
            for name, column in zip(["x_mm", "y_mm", "depth_mm"], moved.T, strict=True):
                row[f"marker_{name}"] = (1e3 * column).astype(np.float32)
        else:
            row["no_estimate"] = "no marker of the outer layer is seen with its hue or size"
        radius = tracking.start.radius
        return row, lambda: draw_tracks(
            frame.image, tracking.palette, tracks, tracking.resting, radius
        )

    return read


def _check_tracker(tracking: Tracking) -> None:
    """Refuse tracks that no forces can be read from."""
    rest = tracking.resting
    pairs = rest.visible.all(axis=0) if len(rest.visible) == 2 else np.zeros(0, dtype=bool)
    if not pairs.any() or not np.isfinite(rest.covariance[pairs]).all():
        raise UserError(
            f"tracker {tracking.name!r} does not tell how certain places and sizes are, which "
            f"forces are read from; wanted: {DEFAULT_TRACKER}"
        )


def _summary(rows: list[dict[str, Any]], seconds: float) -> dict[str, Any]:
    """Last and median value of what was estimated, and the frames that say nothing."""
    silent = [row for row in rows if row["no_estimate"]]
    told = [row for row in rows if not row["no_estimate"]]
    numbers = {}
    for name in VALUES:
        values = [row[name] for row in told if row.get(name) is not None]
        if values:
            last = told[-1].get(name)
            numbers[name] = {"last": last, "median": float(np.median(values))}
    reasons = Counter(re.sub(r"\d[\d.]*", "…", row["no_estimate"]) for row in silent)
    return {
        "without_estimate": len(silent),
        "without_estimate_because": dict(reasons.most_common()),
        "estimates": numbers,
        "mu_observable_frames": sum(bool(row.get("mu_observable")) for row in told),
        "ms_per_estimate": 1e3 * seconds / len(rows) if rows else None,
    }
