"""What the log of a run of two fingers holds, read from its run folder."""

from collections.abc import Iterator

import numpy as np

from ...output.frames import FRAMES
from ...output.logs.entries import ERROR, OK, Condition, Log, Pictures
from ..shown.log import (
    Named,
    condition_of_slip,
    conditions_of,
    ends,
    facts_of_log,
    frames_that_came,
    signals_of,
    target_of,
    wrenches_of,
)
from ..shown.log_pictures import Part, raw_pictures, video_pictures
from ..shown.report import RunRead
from .trace import COLUMNS, FINGERS, OUTCOMES

_WHOLE = (
    Named(topic="/grip_n/commanded", column="grip_n", unit="N"),
    Named(topic="/grip_n/applied", column="applied_n", unit="N"),
    Named(topic="/load_n/table", column="table_n", unit="N"),
    Named(topic="/mass_g/object", column="mass_g", unit="g"),
    Named(topic="/turn_deg/in_hand", column="turn_deg", unit="°"),
    Named(topic="/turn_deg/elastic", column="elastic_deg", unit="°"),
    Named(topic="/slide_mm/in_hand", column="slide_mm", unit="mm"),
    Named(topic="/height_mm/object", column="height_mm", unit="mm"),
    Named(topic="/pressure_kpa/true", column="pressure_kpa", unit="kPa"),
)
_FINGER = (
    Named(topic="/margin/true", column="margin_true"),
    Named(topic="/margin/estimated", column="margin_estimated", interval=ends("margin")),
    Named(topic="/limit_margin/true", column="limit_margin_true"),
    Named(topic="/limit_margin/estimated", column="limit_margin_estimated"),
    Named(topic="/mu/true", column="mu_true"),
    Named(topic="/mu/estimated", column="mu_estimated", interval=ends("mu")),
    Named(topic="/normal_n/true", column="normal_true_n", unit="N"),
    Named(topic="/normal_n/estimated", column="normal_estimated_n", unit="N"),
    Named(topic="/friction_n/true", column="friction_true_n", unit="N"),
    Named(topic="/friction_n/estimated", column="friction_estimated_n", unit="N"),
    Named(topic="/slip_mm/lateral_displacement", column="lateral_displacement_mm", unit="mm"),
    Named(topic="/slip_mm/rigid_slip", column="rigid_slip_mm", unit="mm"),
    Named(topic="/markers/visible", column="markers_visible"),
)


def log_of(run: RunRead) -> Log:
    """Log of a run of two fingers: what is of one finger stands below `/first` and `/second`."""
    of = run.columns
    signals = signals_of(of, _WHOLE, COLUMNS)
    wrenches, conditions = [], [_outcome(run)]
    for finger in FINGERS:
        before = f"{finger}_"
        signals += [*signals_of(of, _FINGER, COLUMNS, before), *target_of(run, before)]
        wrenches += wrenches_of(of, before)
        conditions += conditions_of(run, of, frames_that_came(run, of, before), before)
        way = of[f"{before}lateral_displacement_mm"]
        conditions += condition_of_slip(of["time_s"], way, f"{finger}/slip")
    return Log(
        name=run.folder.resolve().name,
        scene=(run.folder / "scene.toml").read_text(encoding="utf-8"),
        facts=facts_of_log(run),
        signals=signals,
        wrenches=wrenches,
        conditions=conditions,
        pictures=list(_pictures(run)),
    )


def _outcome(run: RunRead) -> Condition:
    """Worst that has happened to the object so far."""
    numbers = run.columns["outcome"].astype(int)
    return Condition(
        name="object",
        times=run.columns["time_s"],
        levels=np.where(numbers == 0, OK, ERROR),
        messages=[OUTCOMES[number] for number in numbers],
        values={"turn_deg": run.columns["turn_deg"], "slide_mm": run.columns["slide_mm"]},
    )


def _pictures(run: RunRead) -> Iterator[Pictures]:
    """Both cameras' raw pictures where they were kept, and the video."""
    for finger in FINGERS:
        yield from raw_pictures(run.folder / FRAMES / finger, f"/{finger}/camera")
    if run.video is not None:
        came = np.logical_and.reduce(
            [frames_that_came(run, run.columns, f"{finger}_") for finger in FINGERS]
        )
        meaning = "both cameras' pictures with the tractions, and the object between the fingers"
        part = Part(topic="/video", meaning=meaning)
        yield video_pictures(run.video, part, run.columns["time_s"][came])
