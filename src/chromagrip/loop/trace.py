"""Time series of a run, truth beside estimate, and its summary."""

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..control import GripObservation
from ..model import GROSS_SLIP, ForceField, margin_within, pressure
from ..scene.scene import Body, Scene
from ..tracking import Tracks
from ..tracking.forces import CameraPose
from ..tracking.forces.chain import Used
from .sample import Sample

Array = NDArray[np.float64]

#: Columns of a trace, in order, with their meaning.
COLUMNS = {
    "time_s": "instant of the frame",
    "load_n": "lateral load on the object",
    "grip_n": "grip force commanded from this frame on",
    "applied_n": "force of the gripper's drive at this frame",
    "normal_true_n": "ΣFn",
    "friction_true_n": "ΣFf",
    "mu_true": "Σµᵢ·Fn,i/ΣFn, the object's µ over the contact",
    "margin_true": "Γ with the object's µ; NaN without contact",
    "normal_estimated_n": "ΣFn as estimated",
    "friction_estimated_n": "ΣFf as estimated",
    "normal_deviation_n": "standard deviation of the estimated ΣFn",
    "friction_deviation_n": "standard deviation of the estimated ΣFf",
    "mu_estimated": "µ as estimated; all estimates are NaN of a dropped frame",
    "mu_low": "lower end of the 90 % interval of µ",
    "mu_high": "upper end",
    "margin_estimated": "Γ as estimated",
    "margin_low": "lower end of the 90 % interval of Γ",
    "margin_high": "upper end",
    "pressure_n_per_m": "ΣFn over the contact's width",
    "pressure_pitch_n_per_m": "the same with one node pitch added to the width",
    "lateral_displacement_mm": "of the object over the fingertip, largest so far",
    "rigid_slip_mm": "sliding of the whole contact, summed so far",
    "object_mm": "position of the object along x",
    "rigid_part_mm": "indentation, position of the rigid part along z",
    "contact_nodes": "nodes in contact",
    "markers_visible": "marker pairs tracked; NaN on the truth path",
    "object_y_mm": "position of the object along y; 0 on a chain",
    "object_turn_deg": "turn of the object about z; 0 on a chain",
    "limit_margin_true": "margin of force and torsion together; NaN on a chain",
    "limit_margin_estimated": "the same as estimated",
    "limit_margin_low": "lower end of its 90 % interval",
    "limit_margin_high": "upper end",
    "force_x_true_n": "force of the object on the dome along x",
    "force_y_true_n": "along y",
    "force_z_true_n": "along z; a press is negative",
    "torque_true_nmm": "torque of the object on the dome about z",
    "force_x_estimated_n": "the same forces and torque as estimated",
    "force_y_estimated_n": "along y",
    "force_z_estimated_n": "along z",
    "torque_estimated_nmm": "about z",
    "force_x_deviation_n": "standard deviations of these",
    "force_y_deviation_n": "along y",
    "force_z_deviation_n": "along z",
    "torque_deviation_nmm": "about z",
}
#: Columns from here on are written of a dome only; a chain has no third dimension.
FIRST_OF_DOME = "limit_margin_estimated"


def columns_of(body: Body) -> tuple[str, ...]:
    """Names of the columns that the trace of a body is written with."""
    names = tuple(COLUMNS)
    return names if body == "dome" else names[: names.index(FIRST_OF_DOME)]


def row(sample: Sample) -> tuple[float, ...]:
    """One line of the trace."""
    visible = math.nan if sample.tracks is None else float(sample.tracks.visible.all(axis=0).sum())
    return (
        sample.time,
        sample.load,
        sample.grip,
        sample.applied,
        sample.field.total_normal,
        sample.field.total_friction,
        sample.friction,
        sample.field.safety_margin(sample.friction),
        *_observed(sample.observation),
        pressure(sample.field),
        pressure(sample.field, sample.contact.pitch),
        sample.slip.lateral_displacement * 1e3,
        sample.slip.rigid_slip * 1e3,
        sample.contact.place[0] * 1e3,
        sample.contact.indentation * 1e3,
        float(sample.field.contact.sum()),
        visible,
        sample.contact.place[1] * 1e3,
        math.degrees(sample.contact.turn),
        margin_within(sample.field, sample.friction),
        *_of_dome(sample),
    )


class Rows:
    """Lines of the trace of one finger.

    Parameters
    ----------
    scene: that is run
    """

    columns = COLUMNS

    def __init__(self, scene: Scene) -> None:
        self.names = columns_of(scene.body)

    def line(self, sample: Sample) -> tuple[float, ...]:
        """Line of a frame."""
        return row(sample)


def outside_row(
    time: float, grip: float, observation: GripObservation, tracks: Tracks
) -> tuple[float, ...]:
    """One line of the trace of frames from outside, where the truth is not known."""
    line = dict.fromkeys(COLUMNS, math.nan)
    names = list(COLUMNS)
    first = names.index("normal_estimated_n")
    line |= zip(names[first:], _observed(observation), strict=False)
    line["time_s"], line["grip_n"] = time, grip
    line["markers_visible"] = float(tracks.visible.all(axis=0).sum())
    line |= zip(names[names.index(FIRST_OF_DOME) :], _dome_columns(None, observation), strict=True)
    return tuple(line.values())


def _observed(observation: GripObservation | None) -> tuple[float, ...]:
    """Columns from ΣFn as estimated to the upper end of Γ."""
    if observation is None:
        return (math.nan,) * 10
    deviation = np.sqrt(np.maximum(np.diag(observation.field.totals_covariance), 0.0))
    return (
        observation.field.total_normal,
        observation.field.total_friction,
        float(deviation[0]),
        float(deviation[1]),
        observation.friction,
        *observation.friction_interval,
        observation.margin,
        *observation.margin_interval,
    )


def _of_dome(sample: Sample) -> tuple[float, ...]:
    """Columns from FIRST_OF_DOME on; NaN on a chain."""
    return _dome_columns(sample.field, sample.observation)


def _dome_columns(field: ForceField | None, seen: GripObservation | None) -> tuple[float, ...]:
    out = np.full(15, math.nan)
    if field is not None and field.directions is not None:
        out[3:7] = field.wrench
    if seen is not None:
        out[:3] = seen.limit_margin, *seen.limit_margin_interval
        out[7:] = *seen.force, seen.torque, *seen.force_deviation, seen.torque_deviation
    out[[6, 10, 14]] *= 1e3
    return tuple(out.tolist())


@dataclass(frozen=True)
class Trace:
    """Columns of a run by name, each of one value a frame."""

    columns: dict[str, Array]

    def __getitem__(self, name: str) -> Array:
        """Column of that name."""
        return self.columns[name]

    def __len__(self) -> int:
        """Frames."""
        return len(self.columns["time_s"])


def word_for_read(path: str) -> str:
    """What the controller's values are on a path: estimates, or the truth with noise."""
    return "estimated" if path == "camera" else "observed"


def may_slide(scene: Scene, of: Mapping[str, Array], before: str = "") -> NDArray[np.bool_]:
    """Frames whose interval of the held margin does not exclude sliding, so that the grip rises.

    Parameters
    ----------
    scene: that was run
    of: columns of its trace
    before: what stands before the names of a finger's columns
    """
    smaller = f"{before}limit_margin_low"  # that of a pinch is not in its trace
    held = scene.body == "dome" and scene.held_margin == "smaller" and smaller in of
    low = of[smaller if held else f"{before}margin_low"]
    margin = scene.sliding_margin
    return low <= (-np.inf if margin is None else margin)


class TraceLines:
    """Lines of a trace as text while they come, for a run that is killed.

    Parameters
    ----------
    path: of the file, which gets a line of names first
    names: of the columns
    """

    def __init__(self, path: Path, names: Iterable[str] = COLUMNS) -> None:
        self._path = path
        self._file = path.open("w", encoding="utf-8", newline="\n")
        self._file.write(",".join(names) + "\n")

    def add(self, line: Iterable[float]) -> None:
        """Append a line, so that it is in the file when this returns."""
        self._file.write(",".join(map(repr, line)) + "\n")
        self._file.flush()

    def close(self) -> None:
        """Close the file; closing it again does nothing."""
        self._file.close()

    def drop(self) -> None:
        """Remove the file, once the trace is written."""
        self.close()
        self._path.unlink(missing_ok=True)


def make_trace(
    rows: Sequence[float] | Sequence[tuple[float, ...]], names: Iterable[str] = COLUMNS
) -> Trace:
    """Trace of lines, one by one or one after the other."""
    columns = list(names)
    values = np.array(rows, dtype=float).reshape(-1, len(columns))
    return Trace(dict(zip(columns, values.T, strict=True)))


#: Results of a run by name; None where a value is unknown.
Summary = dict[str, Any]


def summarise(
    scene: Scene,
    trace: Trace,
    seconds: float,
    used: Used | None = None,
    pose: CameraPose | None = None,
    reasons: Sequence[str] = (),
) -> Summary:
    """Summary of a run; every key is a promise.

    Parameters
    ----------
    scene, trace: that was run, and what was recorded until its end or an interruption
    seconds: wall-clock time of the loop from the second frame on, without writing anything
    used: what forces were read with; None on the truth path
    pose: of the camera against the sensor's design; None where no rest frame tells it
    reasons: why a frame has no estimate, one for each such frame
    """
    both = np.isfinite(trace["margin_true"]) & np.isfinite(trace["margin_estimated"])
    error = (trace["margin_estimated"] - trace["margin_true"])[both]
    late = trace["margin_true"][trace["time_s"] > scene.duration_s - 0.3 - 1e-9]
    values: Summary = {
        "controller": scene.controller,
        "path": scene.path,
        "renderer": scene.renderer,
        "sensor": scene.sensor,
        **(used or dict.fromkeys(Used.__annotations__)),
        "mechanics": scene.body,
        "camera_pose": None if pose is None else pose.table(),
        "without_estimate": len(reasons),
        "without_estimate_because": counted_kinds(reasons),
        "seed": scene.seed,
        "complete": len(trace) == scene.frames,
        "frames": len(trace),
        "duration_s": float(trace["time_s"][-1]) if len(trace) else 0.0,
        "frames_per_second": (len(trace) - 1) / seconds if seconds > 0 else math.nan,
        "final_margin_true": _last(trace["margin_true"]),
        "final_margin_estimated": _last(trace["margin_estimated"]),
        "final_limit_margin_true": _last(trace["limit_margin_true"]),
        "final_limit_margin_estimated": _last(trace["limit_margin_estimated"]),
        "final_turn_deg": _last(trace["object_turn_deg"]),
        "smallest_margin_true": _smallest(trace["margin_true"]),
        "margin_true_min_last_300ms": float(late.min()) if len(late) else math.nan,
        "margin_true_max_last_300ms": float(late.max()) if len(late) else math.nan,
        "margin_rmse": float(np.sqrt((error**2).mean())) if len(error) else math.nan,
        "final_mu_true": _last(trace["mu_true"]),
        "final_mu_estimated": _last(trace["mu_estimated"]),
        "max_pressure_n_per_m": _largest(trace["pressure_n_per_m"]),
        "max_pressure_pitch_n_per_m": _largest(trace["pressure_pitch_n_per_m"]),
        "lateral_displacement_mm": _last(trace["lateral_displacement_mm"]),
        "rigid_slip_mm": _last(trace["rigid_slip_mm"]),
        "gross_slip": bool(_last(trace["lateral_displacement_mm"]) > GROSS_SLIP * 1e3),
        "max_grip_n": _largest(trace["grip_n"]),
        "final_grip_n": _last(trace["grip_n"]),
        "slip_reactions": _reactions(scene, trace),
    }
    # JSON has no NaN: an unknown value is null.
    return {
        k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()
    }


def counted_kinds(reasons: Iterable[str]) -> dict[str, int]:
    """How often sentences occur that differ by numbers alone, the most frequent first."""
    kinds = Counter(re.sub(r"\d[\d.]*", "…", reason) for reason in reasons)
    return dict(kinds.most_common())


def _reactions(scene: Scene, trace: Trace) -> list[dict[str, float]]:
    """Steps of the grip with which React To Slip answered a slip."""
    if scene.controller != "react-to-slip":
        return []
    steps = np.flatnonzero(np.diff(trace["grip_n"]) > 0.9 * scene.react_to_slip.step_n)
    names = ("time_s", "lateral_displacement_mm")
    return [{name: float(trace[name][k + 1]) for name in names} for k in steps]


def _last(column: Array) -> float:
    return float(column[-1]) if len(column) else math.nan


def _smallest(column: Array) -> float:
    return -_largest(-column)


def _largest(column: Array) -> float:
    finite = column[np.isfinite(column)]
    return float(finite.max()) if len(finite) else math.nan
