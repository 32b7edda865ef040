"""The command `estimate`: forces, friction and margin from one's own pictures."""

import json
from pathlib import Path
from typing import Annotated, Any

from rich.console import Console
from rich.table import Table

from ..errors import UserError
from .options import (
    Force,
    Fps,
    Frames,
    JsonOnly,
    Noise,
    Out,
    Rest,
    SourceName,
    TrackerName,
    check_least,
    frame_progress,
    new_folder,
    option,
)

# As in tracking, which is not imported before it is used.
_TRACKER, _RECONSTRUCTOR = "fit", "auto"


def estimate(
    rest: Rest,
    source: SourceName,
    *,
    calibration: Annotated[
        str,
        option(
            "file of `chromagrip calibrate sensor`, or a sensor that is as designed", "NAME|FILE"
        ),
    ],
    reconstructor: Annotated[
        str, option("how forces are read off the markers", "NAME|MODULE:CLASS")
    ] = _RECONSTRUCTOR,
    friction: Annotated[
        str | None,
        option(
            "how µ is read off the forces, by default as in grasps",
            "max-ratio|core-quantile|read-out",
        ),
    ] = None,
    tracker: TrackerName = _TRACKER,
    window: Annotated[float, option("moving average of the friction estimate", "S")] = 0.3,
    noise: Noise = None,
    fps: Fps = None,
    frames: Frames = None,
    out: Out = None,
    force: Force = False,
    json_only: JsonOnly = False,
) -> int:
    """Estimate forces, friction and safety margin in pictures, a video or a camera's frames.

    Leaves estimates.parquet (values with 90 % intervals, frame by frame), figure.png, overlay.mp4
    and summary.json. A flat pad has no force model: its displacements are estimated instead.
    """
    check_least(window=(window, 1e-6), noise=(noise, 0.0), fps=(fps, 1e-3), frames=(frames, 1))
    if out is None and not json_only:
        out = new_folder(f"estimate-{Path(source).stem.replace(':', '-')}")

    from ..pictures.estimate import estimate_source

    with frame_progress("estimating") as (tell, progress):
        outcome = estimate_source(
            rest,
            source,
            calibration=calibration,
            reconstructor=reconstructor,
            friction=friction,
            tracker=tracker,
            window=window,
            noise=noise,
            fps=fps,
            frames=frames,
            out=out,
            force=force,
            tell=tell,
            progress=progress,
        )
    if json_only:
        print(json.dumps(outcome.summary))
    else:
        _print_summary(outcome.summary, out)
    if outcome.broken is not None:
        raise UserError(outcome.broken)
    return 0


def _print_summary(summary: dict[str, Any], folder: Path | None) -> None:
    from ..output.estimate_table import VALUES

    frames, silent = summary["frames"], summary["without_estimate"]
    table = Table(show_header=False, box=None, padding=(0, 2))
    table.add_row("frames", f"{frames}, {summary['ended']}")
    table.add_row("rest frame", f"{summary['rest']}, {summary['rest_misfit_px']:.2f} px off")
    table.add_row("noise", f"{summary['noise_levels']:.2f} levels, {summary['noise_from']}")
    for name, (words, unit) in VALUES.items():
        found = summary["estimates"].get(name)
        if found is not None:
            last = "–" if found["last"] is None else f"{found['last']:.3f}{unit}"
            table.add_row(words, f"{last} at the end, median {found['median']:.3f}{unit}")
    if "mu" in summary["estimates"]:
        shown = summary["mu_observable_frames"]
        hint = "" if shown else ": nothing slips, µ and Γ are guesses"
        table.add_row("", f"µ observable in {shown} frames{hint}")
    share = f", {silent / frames:.1%} of the frames" if frames else ""
    table.add_row("without estimate", f"{silent}{share}")
    for reason, count in summary["without_estimate_because"].items():
        table.add_row("", f"{count} times: {reason}")
    if frames:
        table.add_row(
            "speed",
            f"{summary['ms_per_frame']:.1f} ms a frame to track, "
            f"{summary['ms_per_estimate']:.1f} to estimate",
        )
    Console(markup=False, highlight=False).print(table)
    print(f"folder {folder}, see figure.png and overlay.mp4")
