"""Time series of a pinch, truth beside both estimates, and its summary."""

import math
from collections.abc import Sequence

import numpy as np

from ...control import GripObservation
from ...model import margin_within
from ...model.pinch import mean_pressure
from ...scene.fingers import build_pinch
from ...scene.scene import Scene
from ...sensing.contact import Contact
from ..sample import Sample
from ..trace import Summary, Trace, counted_kinds

#: Columns of the whole pinch, with their meaning.
WHOLE = {
    "time_s": "instant of the frame",
    "grip_n": "grip force commanded from this frame on, of each finger",
    "applied_n": "force of the gripper's drive at this frame",
    "table_n": "force of the table on the object",
    "smaller_finger": "finger whose observation goes to the controller, 1 or 2",
    "mass_g": "mass of the object with what has been added to it",
    "object_x_mm": "place of the object's origin in the hand, x is down at the start",
    "object_y_mm": "along y",
    "object_z_mm": "along z, from the first finger to the second",
    "height_mm": "rise of the object's centre of mass against gravity since the start",
    "closing_mm": "way on which each finger has closed",
    "slide_mm": "way of the object in the hand across z, without that of the skins",
    "turn_deg": "turn of the object about z in the hand, without the elastic twist",
    "elastic_deg": "elastic twist of the skins, their mean",
    "pressure_kpa": "mean pressure of the contact that is pressed more",
    "outcome": "0 held, 1 turned, 2 crushed, 3 dropped; the worst so far",
}
#: Columns of each finger; `first_` or `second_` stands before them.
FINGER = {
    "normal_true_n": "ΣFn",
    "friction_true_n": "ΣFf",
    "force_x_true_n": "force of the object on the finger along the finger's x",
    "force_y_true_n": "along its y",
    "force_z_true_n": "along its z; a press is negative",
    "torque_true_nmm": "torque of the object about the finger's axis",
    "mu_true": "the object's µ",
    "margin_true": "Γ with the object's µ; NaN without contact",
    "limit_margin_true": "margin of force and torsion together",
    "normal_estimated_n": "ΣFn as estimated; estimates are NaN of a dropped frame",
    "friction_estimated_n": "ΣFf as estimated",
    "mu_estimated": "µ as estimated",
    "mu_low": "lower end of the 90 % interval of µ",
    "mu_high": "upper end",
    "margin_estimated": "Γ as estimated",
    "margin_low": "lower end of the 90 % interval of Γ",
    "margin_high": "upper end",
    "limit_margin_estimated": "margin of force and torsion as estimated",
    "force_x_estimated_n": "the same forces and torque as estimated",
    "force_y_estimated_n": "along its y",
    "force_z_estimated_n": "along its z",
    "torque_estimated_nmm": "about the finger's axis",
    "lateral_displacement_mm": "of the object over the fingertip, largest so far",
    "rigid_slip_mm": "sliding of the whole contact, summed so far",
    "contact_nodes": "nodes in contact",
    "markers_visible": "marker pairs tracked; NaN on the truth path",
}
FINGERS = ("first", "second")
#: Columns of a pinch's trace, in order, with their meaning.
COLUMNS = WHOLE | {f"{f}_{name}": meaning for f in FINGERS for name, meaning in FINGER.items()}
#: Outcomes in the order of their numbers.
OUTCOMES = ("held", "turned", "crushed", "dropped")


class PinchRows:
    """Lines of a pinch's trace, one a frame; as `trace.Rows`.

    Parameters
    ----------
    scene: that is run
    """

    columns, names = COLUMNS, tuple(COLUMNS)

    def __init__(self, scene: Scene) -> None:
        self._pinch = build_pinch(scene)
        self._limits = scene.pinch.limits
        self._start: float | None = None

    def line(self, sample: Sample) -> tuple[float, ...]:
        """Line of a frame."""
        truth, record = sample.pinch, sample.pinch.record
        height = -float(self._pinch.down @ truth.state.moving.place)
        self._start = height if self._start is None else self._start
        first = truth.fingers[0]
        whole = (
            sample.time,
            sample.grip,
            sample.applied,
            truth.state.support,
            sample.smaller + 1.0,
            1e3 * self._pinch.body_at(sample.time).mass,
            1e3 * first.place[0],
            1e3 * first.place[1],
            1e3 * (truth.state.closing - first.indentation),
            1e3 * (height - self._start),
            1e3 * truth.state.closing,
            1e3 * record.slide,
            math.degrees(record.turn),
            math.degrees(record.elastic),
            1e-3 * self._pressure(truth.fingers),
            float(OUTCOMES.index(record.outcome(self._limits))),
        )
        fingers = [
            value
            for contact, reading in zip(truth.fingers, sample.readings, strict=True)
            for value in (*_true(contact), *_seen(reading.observation), *_slipped(contact),
                          _visible(reading.tracks))
        ]  # fmt: skip
        return (*whole, *fingers)

    def _pressure(self, contacts: tuple[Contact, Contact]) -> float:
        domes = (self._pinch.first, self._pinch.second)
        return max(mean_pressure(d, c.field) for d, c in zip(domes, contacts, strict=True))


def _true(contact: Contact) -> tuple[float, ...]:
    field, mu = contact.field, contact.friction
    return (
        field.total_normal,
        field.total_friction,
        *field.wrench[:3].tolist(),
        1e3 * float(field.wrench[3]),
        mu,
        field.safety_margin(mu),
        margin_within(field, mu),
    )


def _seen(observation: GripObservation | None) -> tuple[float, ...]:
    if observation is None:
        return (math.nan,) * 13
    return (
        observation.field.total_normal,
        observation.field.total_friction,
        observation.friction,
        *observation.friction_interval,
        observation.margin,
        *observation.margin_interval,
        observation.limit_margin,
        *observation.force,
        1e3 * observation.torque,
    )


def _slipped(contact: Contact) -> tuple[float, ...]:
    slip = contact.slip
    nodes = float(contact.field.contact.sum())
    return 1e3 * slip.lateral_displacement, 1e3 * slip.rigid_slip, nodes


def _visible(tracks: object) -> float:
    visible = getattr(tracks, "visible", None)
    return math.nan if visible is None else float(visible.all(axis=0).sum())


def summarise(scene: Scene, trace: Trace, seconds: float, reasons: Sequence[str] = ()) -> Summary:
    """Summary of a pinch; every key is a promise.

    Parameters
    ----------
    scene: that was run
    trace: of the frames up to the end or an interruption
    seconds: wall-clock time of the loop from the second frame on
    reasons: why a finger has no estimate of a frame, one for each
    """
    lifted = trace["time_s"] > scene.pinch.lifts_at
    margins = np.stack([trace[f"{f}_margin_true"] for f in FINGERS])
    limits = np.stack([trace[f"{f}_limit_margin_true"] for f in FINGERS])
    seen = np.stack([trace[f"{f}_margin_estimated"] for f in FINGERS])
    error = (seen - margins)[np.isfinite(seen) & np.isfinite(margins)]
    last = -1 if len(trace) else slice(0)
    values: Summary = {
        "controller": scene.controller,
        "path": scene.path,
        "renderer": scene.renderer,
        "sensor": scene.sensor,
        "second_sensor": scene.pinch.second_sensor or scene.sensor,
        "mechanics": "pinch",
        "seed": scene.seed,
        "complete": len(trace) == scene.frames,
        "frames": len(trace),
        "duration_s": _of(trace["time_s"][last]),
        "frames_per_second": (len(trace) - 1) / seconds if seconds > 0 else math.nan,
        "without_estimate": len(reasons),
        "without_estimate_because": counted_kinds(reasons),
        "mass_g": scene.pinch.mass_g,
        "final_mass_g": _of(trace["mass_g"][last]),
        "lifted": bool(len(trace) and not trace["table_n"][-1]),
        "outcome": OUTCOMES[int(trace["outcome"][-1])] if len(trace) else None,
        "final_margin_true": _of(margins[:, last].min()) if len(trace) else math.nan,
        "final_limit_margin_true": _of(limits[:, last].min()) if len(trace) else math.nan,
        "smallest_limit_margin_true": _least(limits[:, lifted]),
        "margin_rmse": float(np.sqrt((error**2).mean())) if len(error) else math.nan,
        "slide_mm": _of(trace["slide_mm"][last]),
        "turn_deg": _of(trace["turn_deg"][last]),
        "elastic_deg": _of(trace["elastic_deg"][last]),
        "largest_turn_deg": _most(abs(trace["turn_deg"])),
        "largest_elastic_deg": _most(abs(trace["elastic_deg"])),
        "max_pressure_kpa": _most(trace["pressure_kpa"]),
        "max_grip_n": _most(trace["grip_n"]),
        "final_grip_n": _of(trace["grip_n"][last]),
        "mean_grip_n": float(trace["applied_n"].mean()) if len(trace) else math.nan,
    }
    # JSON has no NaN: an unknown value is null.
    return {
        k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()
    }


def _of(value: float | np.ndarray) -> float:
    return float(value) if np.ndim(value) == 0 else math.nan


def _least(values: np.ndarray) -> float:
    found = values[np.isfinite(values)]
    return float(found.min()) if len(found) else math.nan


def _most(values: np.ndarray) -> float:
    found = values[np.isfinite(values)]
    return float(found.max()) if len(found) else math.nan
