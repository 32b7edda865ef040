"""The commands `score`, `sweep` and `reproduce`."""

import json
import re
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import tyro

from ..errors import UserError
from ..output.report import Report, print_report
from ..scene.scene import DEFAULT_SCENE, PathName, parse_change
from ..strict_toml import parse_toml
from .options import (
    CORES,
    Allow,
    Changes,
    FollowLinks,
    JsonOnly,
    Out,
    Overwrite,
    Quick,
    Workers,
    changes_of,
    check_least,
    going_on,
    new_folder,
    option,
    refuse_arguments,
    status,
    stem_of,
)
from .readouts import prepare_scene

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
            "also run Table 2 and Figs. 13 to 15 through the camera: at 1000 Hz with the printed "
            "gains, or at 100 Hz with gains tuned for it",
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
        raise UserError(f"--camera is an option of {', '.join(CAMERA_PARTS)}, not of {part}")

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
            "tracks of one tracker or several, then the truth. Tracks are a file (Parquet, CSV or "
            "TAP-Vid's .npz), a folder with one file for each sequence, or a tracker to run. The "
            "truth is a dataset, one of its sequences, or a file of tracks",
            "TRACKS... TRUTH",
        ),
    ],
    *,
    out: Out = None,
    overwrite: Overwrite = False,
    follow_links: FollowLinks = False,
    max_rows: Annotated[int, option("largest number of rows of a table", "N")] = 20_000_000,
    json_only: JsonOnly = False,
) -> int:
    """Score tracks of any tracker against the truth of a dataset or of a file.

    Means over several sequences have bootstrap intervals of 90 %. The folder has
    leaderboard.html, scores.json and pictures of the worst frames.

    Example: chromagrip score mine.csv fit data/sequence-000000
    """
    if len(files) < 2:
        raise UserError("score needs tracks and a truth: chromagrip score TRACKS... TRUTH")
    *tracks, truth = files
    if out is None and not json_only:
        out = new_folder(f"score-{stem_of(str(truth))}")

    from ..measure.score.score import (
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


def sweep(
    scene_name: Annotated[
        str | None, tyro.conf.Positional, option("scene, same as one --scene", "SCENE")
    ] = None,
    *,
    vary: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        option("values of a key, such as object.friction=0.3,0.5; may be repeated", "KEY=V,V,…"),
    ] = (),
    arguments: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        option(
            "values of an argument of the controller's class; may be repeated", "NAME=V,V,…", "arg"
        ),
    ] = (),
    scenes: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        option(
            "scene, see `chromagrip list scenes`, or a .toml file; may be repeated",
            "NAME|FILE.toml",
            "scene",
        ),
    ] = (),
    controllers: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        option(
            "controller, instead of the scene's; may be repeated", "NAME|MODULE:CLASS", "controller"
        ),
    ] = (),
    path: Annotated[
        PathName | None, option("input of the controller, instead of the scene's", "camera|truth")
    ] = None,
    seeds: Annotated[
        int, option("number of runs of each setting, each with its own seed", "N")
    ] = 3,
    changes: Changes = (),
    allow: Allow = (),
    answer_within: Annotated[
        float,
        option("longest time in s for an answer of a module:Class; inf is no limit", "SECONDS"),
    ] = 60.0,
    workers: Workers = CORES,
    out: Out = None,
    overwrite: Overwrite = False,
    json_only: JsonOnly = False,
) -> int:
    """Run a controller with many settings, in many scenes, with several seeds.

    An interrupted sweep continues when it is called again with the same --out.

    Example: chromagrip sweep --scene thesis --vary object.friction=0.3,0.5 --path truth --seeds 1
    """
    check_least(seeds=(seeds, 1), workers=(workers, 1))
    if scene_name in scenes:
        raise UserError(f"a scene is given twice: {scene_name} and --scene {scene_name}")
    scenes = scenes if scene_name is None else (scene_name, *scenes)
    if not (vary or arguments or scenes or controllers or path or changes):
        raise UserError(
            "nothing is varied: give --vary, --arg, --controller or a scene, such as "
            "`chromagrip sweep thesis --vary object.friction=0.3,0.5`"
        )
    if not answer_within > 0.0:
        raise UserError(f"--answer-within {answer_within}: expected more than 0; inf is no limit")
    axes = [_axis(text, "--vary", "") for text in vary]
    axes += [_axis(text, "--arg", "controller_arguments.") for text in arguments]
    shortcuts = {} if path is None else {"path": path}
    fixed = shortcuts | changes_of(changes, shortcuts)
    for text in changes:
        if _is_several(text):
            raise UserError(f"--set {text}: several values are varied: give --vary {text}")
    if controllers:
        axes.insert(0, ("controller", controllers))
    names = [name for name, _ in axes]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise UserError(f"{twice[0]} is varied twice; give all its values at once")
    refuse_arguments("--vary", names, controllers)
    both = [name for name in names if name in fixed]
    if both:
        raise UserError(f"{both[0]} is both varied and set; give it once")

    from ..measure.engine import UNFINISHED
    from ..measure.sweep.runs import Plan, tasks
    from ..measure.sweep.sweep import sweep as measure_sweep

    plan = Plan(
        scenes=tuple(dict.fromkeys(scenes)) or (DEFAULT_SCENE,),
        axes=tuple(axes),
        seeds=seeds,
        fixed=fixed,
        answer_within_s=answer_within,
        allow=allow,
    )
    wanted = tasks(plan)  # refuses what cannot be run before a folder is made
    kinds = {(one.scene.sensor, one.scene.path, one.scene.body): one.scene for one in wanted}
    for scene in kinds.values():  # once, not in each worker
        prepare_scene(scene, pictures=scene.path == "camera")
    if out is None and not json_only:
        out = new_folder("sweep")
    with status() as progress, going_on(out, UNFINISHED):
        report = measure_sweep(plan, out, overwrite, workers, progress)
    return print_result(report, out, json_only)


def _is_several(text: str) -> bool:
    """Whether the value of KEY=VALUE is several numbers, with commas and without brackets."""
    values = text.partition("=")[2].split(",")
    return len(values) > 1 and all(re.fullmatch(r"\s*[-+.\d][-+.\deE]*\s*", v) for v in values)


def _axis(text: str, flag: str, prefix: str) -> tuple[str, tuple[Any, ...]]:
    """Key and values of KEY=V,V,…; values are TOML, or texts without quotes."""
    key, equals, values = text.partition("=")
    if not equals or not key.strip() or not values.strip():
        raise UserError(f"{flag} {text}: expected values, such as object.friction=0.3,0.5")
    try:
        found = parse_toml(f"values = [{values}]", flag)["values"]
    except UserError:
        found = [parse_change(f"{key}={value}")[1] for value in values.split(",")]
    kept = list(map(_hashable, found))
    if len(set(kept)) < len(kept):
        raise UserError(f"{flag} {text}: a value is given twice")
    return prefix + key.strip(), tuple(kept)


def _hashable(value: Any) -> Any:
    return tuple(map(_hashable, value)) if isinstance(value, list) else value
