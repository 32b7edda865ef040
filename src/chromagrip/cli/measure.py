"""The commands that measure this project: `bench`, `chart`, `stability` and `reproduce`."""

import json
from pathlib import Path
from typing import Annotated, Literal, get_args

import tyro

from ..errors import UserError
from ..output.report import Report, print_report
from .options import (
    CORES,
    Flag,
    FollowLinks,
    Json,
    JsonOnly,
    Out,
    Overwrite,
    Quick,
    Workers,
    check_least,
    new_folder,
    option,
    status,
    stem_of,
)

Trackers = Annotated[
    tuple[str, ...],
    tyro.conf.UseAppendAction,
    option("of track: only this one; may be repeated", "NAME|MODULE:CLASS", "tracker"),
]
Reconstructors = Annotated[
    tuple[str, ...],
    tyro.conf.UseAppendAction,
    option("of force: only this one; may be repeated", "NAME|MODULE:CLASS", "reconstructor"),
]
Controllers = Annotated[
    tuple[str, ...],
    tyro.conf.UseAppendAction,
    option("of control: only this one; may be repeated", "NAME|MODULE:CLASS", "controller"),
]
World = Annotated[
    Literal["", "matched", "mismatched", "beyond", "dome", "pinch"],
    option(
        "of force: only this world, without the speed; of loop: dome; of control: pinch",
        "matched|mismatched|beyond|dome|pinch",
    ),
]
Groups = Annotated[
    tuple[str, ...],
    tyro.conf.UseAppendAction,
    option("of force --world beyond|dome: only this group; may be repeated", "NAME", "group"),
]
TrackScenes = Annotated[
    tuple[str, ...],
    tyro.conf.UseAppendAction,
    option("of track: only this scene; may be repeated", "NAME", "scene"),
]
BenchPart = Literal["control", "dataset", "force", "loop", "model", "render", "track"]
StabilityPart = Literal["force", "loop", "model", "track"]
ChartPart = Literal["all", "force", "loop", "model", "render", "track"]
ThesisPart = Literal[
    "all",
    "figure-9",
    "figure-10",
    "figure-11",
    "figure-13",
    "figure-14",
    "figure-15",
    "figure-16",
    "table-2",
    "figure-17",
    "appendix-b",
]
#: Parts of the thesis that can be run through the camera too.
CAMERA_PARTS = ("all", "table-2", "figure-13", "figure-14", "figure-15")


def bench(
    part: Annotated[
        BenchPart, tyro.conf.Positional, option("what is measured", "|".join(get_args(BenchPart)))
    ],
    *,
    trackers: Trackers = (),
    reconstructors: Reconstructors = (),
    controllers: Controllers = (),
    world: World = "",
    groups: Groups = (),
    scenes: TrackScenes = (),
    quick: Quick = False,
    json_only: Json = False,
) -> int:
    """Measure one part and print each figure beside its target.

    Example: chromagrip bench track --tracker fit --quick
    """
    from ..measure.bench.parts import bench as measure

    with status() as report:
        result = measure(
            part, quick, report, trackers, reconstructors, controllers, world, groups, scenes
        )
    return print_result(result, None, json_only)


def chart(
    part: Annotated[
        ChartPart, tyro.conf.Positional, option("what is charted", "|".join(get_args(ChartPart)))
    ] = "all",
    *,
    reconstructors: Reconstructors = (),
    update: Annotated[
        Flag, option("of loop: measure the table again that `chromagrip plan` chooses from")
    ] = False,
    quick: Quick = False,
    out: Out = None,
    overwrite: Overwrite = False,
    json_only: JsonOnly = False,
) -> int:
    """Draw the speed of every method of a stage against its error.

    Example: chromagrip chart render --quick
    """
    if update:
        return _update(part)
    if reconstructors and part != "force":
        raise UserError(f"--reconstructor goes with chart force, not with chart {part}")

    from ..measure.charts.page import PARTS, charts

    if out is None and not json_only:
        out = new_folder(f"chart-{part}")
    parts = list(PARTS) if part == "all" else [part]
    with status() as report:
        result = charts(parts, quick, out, overwrite, report, reconstructors)
    return print_result(result, out, json_only)


def _update(part: str) -> int:
    if part not in ("all", "loop"):
        raise UserError(f"--update goes with chart loop, not with chart {part}")

    from ..loop.fidelity import TABLE
    from ..measure.worlds.fidelity_table import update

    with status() as report:
        measured = update(TABLE, report)
    print(f"{len(measured)} measurements in {TABLE}")
    return 0


def stability(
    part: Annotated[
        StabilityPart,
        tyro.conf.Positional,
        option("what is mapped", "|".join(get_args(StabilityPart))),
    ],
    *,
    trackers: Trackers = (),
    world: Annotated[
        Literal["", "dome", "pinch"],
        option("of loop: a dome, or two of them and an object; none is the chain", "dome|pinch"),
    ] = "",
    workers: Annotated[
        int | None, option("of force and loop: processes; by default one for each core", "N")
    ] = None,
    quick: Quick = False,
    out: Out = None,
    overwrite: Overwrite = False,
    json_only: JsonOnly = False,
) -> int:
    """Map where integrators, trackers, reconstructors or controllers stop working.

    Example: chromagrip stability track --tracker lk --quick
    """
    if trackers and part != "track":
        raise UserError(f"--tracker goes with stability track, not with stability {part}")
    if workers is not None and part not in ("force", "loop"):
        raise UserError(f"--workers goes with stability force and loop, not with stability {part}")
    if world and part != "loop":
        raise UserError(f"--world goes with stability loop, not with stability {part}")
    check_least(workers=(workers, 1))
    if out is None and not json_only:
        out = new_folder(f"stability-{part}-{world}" if world else f"stability-{part}")

    from ..measure.stability import parts
    from ..measure.stability.grips.parts import stability_grips

    with status() as report:
        if world:
            result = stability_grips(world, quick, out, overwrite, report, workers or CORES)
        elif part == "loop":
            result = parts.stability_loop(quick, out, overwrite, report, workers or CORES)
        elif part == "force":
            result = parts.stability_force(quick, out, overwrite, report, workers or CORES)
        elif part == "track":
            result = parts.stability_track(quick, out, overwrite, report, trackers)
        else:
            result = parts.stability_model(quick, out, overwrite, report)
    return print_result(result, out, json_only)


def reproduce(
    part: Annotated[
        ThesisPart,
        tyro.conf.Positional,
        option("part of the thesis", "|".join(get_args(ThesisPart))),
    ] = "all",
    *,
    camera: Annotated[
        Literal["thesis", "camera-100hz"] | None,
        option(
            "Table 2 and Figs. 13 to 15 through the camera too: at 1000 Hz with the printed gains, "
            "or at 100 Hz with gains tuned for it",
            "thesis|camera-100hz",
        ),
    ] = None,
    workers: Workers = CORES,
    quick: Quick = False,
    out: Out = None,
    overwrite: Overwrite = False,
    json_only: JsonOnly = False,
) -> int:
    """Compare every result of the thesis with ours, on one page with verdicts.

    An interrupted run continues when it is called again with the same --out.

    Example: chromagrip reproduce figure-13 --quick
    """
    check_least(workers=(workers, 1))
    if part == "appendix-b" and (camera or quick):
        raise UserError("appendix-b has neither a camera nor a quick run")
    if camera and part not in CAMERA_PARTS:
        raise UserError(f"--camera goes with {', '.join(CAMERA_PARTS)}, not with {part}")

    from ..measure.reproduce.parts import PARTS, Plan
    from ..measure.reproduce.parts import reproduce as compare

    if out is None and not json_only:
        out = new_folder("reproduce" if part == "all" else part)
    parts: list[str] = list(PARTS) if part == "all" else [part]
    with status() as report:
        result, _ = compare(parts, Plan(quick, camera), out, overwrite, workers, report)
    return print_result(result, out, json_only)


def print_result(result: Report, folder: Path | None, json_only: bool) -> int:
    """Print a report, and the folder that holds more."""
    if json_only:
        print(json.dumps(result.as_json()))
        return 0
    print_report(result)
    if folder is not None:
        page = folder / "index.html"
        print(f"folder {folder}{', open index.html' if page.exists() else ''}")
    return 0


def score(
    files: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        option(
            "tracks of one maker or several, then the truth. Tracks are a file (Parquet, CSV, or "
            "TAP-Vid's .npz), a folder with one for each sequence, or a tracker to run; the truth "
            "is a dataset, one of its sequences, or such a file",
            "TRACKS... TRUTH",
        ),
    ],
    *,
    out: Out = None,
    overwrite: Overwrite = False,
    follow_links: FollowLinks = False,
    max_rows: Annotated[int, option("rows of a table that are read at most", "N")] = 20_000_000,
    json_only: JsonOnly = False,
) -> int:
    """Score tracks of any tracker against the truth of a dataset or of a file.

    Means over several sequences have bootstrap intervals of 90 %. Leaves leaderboard.html,
    scores.json and pictures of the worst frames.

    Example: chromagrip score mine.csv fit data/tracking
    """
    if len(files) < 2:
        raise UserError("score wants tracks and a truth: chromagrip score TRACKS... TRUTH")
    *tracks, truth = files
    if out is None and not json_only:
        out = new_folder(f"score-{stem_of(str(truth))}")

    from ..measure.scored.score import (
        as_json,
        case_tables,
        interval_note,
        refusals,
        score_table,
        score_tracks,
    )
    from ..output.report import table_lines

    with status() as report:
        outcomes = score_tracks(
            tracks, truth, out, overwrite, report, follow_links=follow_links, most=max_rows
        )
    if json_only:
        print(json.dumps(as_json(outcomes, truth)))
        return 0
    for table in (score_table(outcomes), *case_tables(outcomes)):
        print("\n".join(table_lines(table)))
    print(interval_note(outcomes))
    for sentence in refusals(outcomes):
        print(sentence)
    print(f"folder {out}, see leaderboard.html")
    return 0
