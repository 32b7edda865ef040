"""Run grasps, list what there is, measure it, and compare it with the thesis.

Exit codes: 0 done, 1 something is missing (doctor), 2 asked for the impossible, 130 interrupted,
141 nobody reads on.
"""

import json
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from ..errors import UserError
from ..output.report import print_report
from ..scene.controllers import CONTROLLERS
from ..scene.scene import (
    DEFAULT_SCENE,
    PathName,
    RendererName,
    load_scene,
    parse_change,
    scene_names,
)
from .calibrate import calibrate, calibrate_sensor
from .dataset import COMMANDS as DATASET
from .estimate import estimate
from .limit import limit
from .options import (
    Flag,
    Force,
    JsonOnly,
    Out,
    Quick,
    check_least,
    interrupt,
    new_folder,
    option,
    print_rows,
    stop_if_interrupted,
    telling,
)
from .plan import plan
from .render import render
from .reproduce import reproduce
from .track import detect, palettes, track, trackers
from .train import train

NAME = "chromagrip"

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


def grasp(
    *,
    scene: Annotated[
        str, option("shipped scene, see `chromagrip scenes`, or a .toml file", "NAME|FILE.toml")
    ] = DEFAULT_SCENE,
    controller: Annotated[
        str | None,
        option("instead of the scene's; see `chromagrip controllers`", "NAME|MODULE:CLASS"),
    ] = None,
    path: Annotated[
        PathName | None,
        option("what the controller is fed: pixels, or the model's own forces", "camera|truth"),
    ] = None,
    renderer: Annotated[
        RendererName | None, option("instead of the scene's", "painter|pyrender")
    ] = None,
    fps: Annotated[float | None, option("camera rate, short for camera.rate_hz", "HZ")] = None,
    latency: Annotated[
        int | None, option("frames between an image and the command from it", "FRAMES")
    ] = None,
    seed: Annotated[int | None, option("of the camera noise", "N")] = None,
    changes: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        option("change one scene value, such as object.friction=0.3", "KEY=VALUE", "set"),
    ] = (),
    out: Annotated[
        Path | None, option("run folder; by default a new one under runs/", "DIR")
    ] = None,
    force: Annotated[Flag, option("write over an earlier run in --out")] = False,
    json_only: Annotated[
        Flag,
        option("print the summary alone, as JSON; writes a folder only with --out", name="json"),
    ] = False,
) -> int:
    """Run a grasp and leave summary, trace, figure and video in a folder."""
    shortcuts = {
        "controller": controller,
        "path": path,
        "renderer": renderer,
        "camera.rate_hz": fps,
        "camera.latency_frames": latency,
        "seed": seed,
    }
    changed: dict[str, Any] = {k: v for k, v in shortcuts.items() if v is not None}
    changed |= dict(parse_change(text) for text in changes)
    resolved = load_scene(scene, changed)
    if out is None and not json_only:
        out = new_folder(f"{Path(scene).stem}-{resolved.controller.replace(':', '-')}")

    from ..loop.run_folder import (
        run,  # OpenCV, matplotlib and FFmpeg load only when something is run
    )

    console = Console(stderr=True)
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("frames"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    ) as bar:
        task = bar.add_task(f"{resolved.controller}, {resolved.path}", total=resolved.frames)
        result = run(
            resolved,
            out,
            force=force,
            progress=lambda done, total: _advance(bar, task, done, total),
        )
    if json_only:
        print(json.dumps(result.summary))
    else:
        print_summary(result.summary, result.folder)
    return 0


def _advance(bar: Progress, task: Any, done: int, total: int) -> None:
    bar.update(task, completed=done, total=total)
    stop_if_interrupted()


def print_summary(summary: dict[str, Any], folder: Path | None) -> None:
    """Short table of a run."""

    def number(key: str, digits: int = 3) -> str:
        value = summary[key]
        return "–" if value is None else f"{value:.{digits}f}"

    table = Table(show_header=False, box=None, padding=(0, 2))
    table.add_row("controller", f"{summary['controller']}, {summary['path']} path")
    table.add_row(
        "safety margin at the end",
        f"{number('final_margin_true')} true, {number('final_margin_estimated')} observed",
    )
    table.add_row("error of the margin, RMS", number("margin_rmse"))
    table.add_row(
        "lateral displacement",
        f"{number('lateral_displacement_mm')} mm, "
        f"{'gross slip' if summary['gross_slip'] else 'no gross slip'}",
    )
    for event in summary["slip_reactions"]:
        table.add_row(
            "reacted to slip at",
            f"{event['time_s']:.3f} s, {event['lateral_displacement_mm']:.3f} mm",
        )
    table.add_row("largest grip force", f"{number('max_grip_n')} N")
    table.add_row("largest pressure", f"{number('max_pressure_n_per_m', 0)} N/m")
    table.add_row("speed", f"{number('frames_per_second', 1)} frames/s")
    if folder is not None:
        table.add_row("folder", str(folder))
    Console().print(table)


def scenes() -> int:
    """List the shipped scenes."""
    return _list({name: load_scene(name).description for name in scene_names()})


def sensors() -> int:
    """List the shipped sensor designs."""
    from ..render import load_sensor, sensor_names

    return _list({name: load_sensor(name).description for name in sensor_names()})


def controllers() -> int:
    """List the controllers."""
    return _list(CONTROLLERS.descriptions())


def renderers() -> int:
    """List the renderers."""
    from ..render import RENDERERS

    return _list(RENDERERS)


def doctor() -> int:
    """Name every missing part and the command that mends it."""
    from .doctor import report

    return report()


def bench(
    part: Annotated[
        Literal["control", "dataset", "force", "loop", "model", "render", "track"],
        tyro.conf.Positional,
        option("what to measure", "control|dataset|force|loop|model|render|track"),
    ],
    *,
    trackers: Trackers = (),
    reconstructors: Reconstructors = (),
    controllers: Controllers = (),
    quick: Quick = False,
    json_only: Annotated[Flag, option("one JSON object", name="json")] = False,
) -> int:
    """Measure a part and print each figure beside its target."""
    from ..measure.bench.parts import bench as measure

    with Console(stderr=True).status("starting") as status:
        report = measure(part, quick, telling(status), trackers, reconstructors, controllers)
    if json_only:
        print(json.dumps(report))
        return 0
    rows = report["rows"]
    if part == "track":
        from ..measure.bench.track import asked, matrix, matrix_lines, refusals

        print(*matrix_lines(matrix(rows)), *refusals(rows), sep="\n")
        rows = asked(rows)
    if part == "force":
        from ..measure.bench.force import NOTES, readings
        from ..measure.bench.force import asked as asked_of_force
        from ..measure.bench.force import matrix as errors
        from ..measure.bench.force import matrix_lines as lines

        print(*lines(errors(rows)), "", *lines(readings(rows)), "", *NOTES, "", sep="\n")
        rows = asked_of_force(rows)
    if part == "control":
        from ..measure.bench.control import asked as asked_of_control
        from ..measure.bench.control import matrix as cards
        from ..measure.bench.force import matrix_lines as lines
        from ..measure.worlds.scorecard import NOTES as SCORED

        print(*lines(cards(rows)), "", *SCORED, "", sep="\n")
        rows = asked_of_control(rows)
    print_rows(rows)
    return 0


def stability(
    part: Annotated[
        Literal["loop", "model", "track"],
        tyro.conf.Positional,
        option("what to map", "loop|model|track"),
    ],
    *,
    trackers: Trackers = (),
    workers: Annotated[
        int | None, option("of loop: processes; by default one for each core", "N")
    ] = None,
    quick: Quick = False,
    out: Out = None,
    force: Force = False,
    json_only: JsonOnly = False,
) -> int:
    """Map where each integrator is true and where it is lost, or each tracker, or the grip."""
    from ..measure.stability.parts import stability_loop, stability_model, stability_track

    if trackers and part != "track":
        raise UserError(f"--tracker goes with stability track, not with stability {part}")
    if workers is not None and part != "loop":
        raise UserError(f"--workers goes with stability loop, not with stability {part}")
    check_least(workers=(workers, 1))
    if out is None and not json_only:
        out = new_folder(f"stability-{part}")
    with Console(stderr=True).status("starting") as status:
        if part == "loop":
            processes = workers or os.cpu_count() or 1
            report = stability_loop(quick, out, force, telling(status), processes)
        elif part == "track":
            report = stability_track(quick, out, force, telling(status), trackers)
        else:
            report = stability_model(quick, out, force, telling(status))
    if json_only:
        print(json.dumps(report.as_json()))
        return 0
    print_report(report)
    print(f"folder {out}")
    return 0


def chart(
    part: Annotated[
        Literal["all", "force", "loop", "model", "render", "track"],
        tyro.conf.Positional,
        option("what to chart", "all|force|loop|model|render|track"),
    ] = "all",
    *,
    reconstructors: Reconstructors = (),
    update: Annotated[
        Flag,
        option("of loop: measure anew the table that `chromagrip plan` chooses from"),
    ] = False,
    quick: Quick = False,
    out: Out = None,
    force: Force = False,
    json_only: JsonOnly = False,
) -> int:
    """Draw the speed of every method of a stage against its error, and the best of them."""
    if update:
        return _update(part)
    from ..measure.charts.page import PARTS, charts

    if reconstructors and part != "force":
        raise UserError(f"--reconstructor goes with chart force, not with chart {part}")
    if out is None and not json_only:
        out = new_folder(f"chart-{part}")
    parts = list(PARTS) if part == "all" else [part]
    with Console(stderr=True).status("starting") as status:
        report = charts(parts, quick, out, force, telling(status), reconstructors)
    if json_only:
        print(json.dumps(report.as_json()))
        return 0
    print_report(report)
    print(f"folder {out}, open index.html")
    return 0


def _update(part: str) -> int:
    from ..loop.fidelity import TABLE
    from ..measure.worlds.fidelity_table import update

    if part not in ("all", "loop"):
        raise UserError(f"--update goes with chart loop, not with chart {part}")
    with Console(stderr=True).status("starting") as status:
        found = update(TABLE, telling(status))
    print(f"{len(found)} measurements in {TABLE}")
    return 0


def _list(entries: dict[str, str]) -> int:
    width = max(map(len, entries))
    for name, text in entries.items():
        print(f"{name:<{width}}  {text}")
    return 0


COMMANDS: dict[str, Callable[..., Any]] = {
    "grasp": grasp,
    "render": render,
    "detect": detect,
    "track": track,
    "estimate": estimate,
    "scenes": scenes,
    "sensors": sensors,
    "controllers": controllers,
    "renderers": renderers,
    "trackers": trackers,
    "palettes": palettes,
    "bench": bench,
    "chart": chart,
    "plan": plan,
    "stability": stability,
    "reproduce": reproduce,
    "calibrate": calibrate,
    "calibrate-sensor": calibrate_sensor,
    "train": train,
    "limit": limit,
    "doctor": doctor,
    **{f"dataset-{name}": command for name, command in DATASET.items()},
}


def main() -> None:
    """Entry point of the command line."""
    signal.signal(signal.SIGINT, interrupt)
    sys.path.append(str(Path.cwd()))  # where a module:Class of one's own lies
    words = sys.argv[1:]
    if words[:1] == ["dataset"] and words[1:] in ([], ["-h"], ["--help"]):
        lines = {f"dataset {k}": (v.__doc__ or "").split("\n")[0] for k, v in DATASET.items()}
        sys.exit(_list(lines))
    # Commands of two words have one name each.
    two = COMMANDS.get("-".join(words[:2])) if len(words) > 1 else None
    try:
        code: int
        if two is not None:
            code = tyro.cli(two, prog=" ".join([NAME, *words[:2]]), args=words[2:])
        elif words[:1] == ["dataset"]:
            raise UserError(f"dataset {words[1]}: there is {', '.join(DATASET)}")
        else:
            code = tyro.extras.subcommand_cli_from_dict(
                COMMANDS, prog=NAME, description=__doc__, args=words
            )
    except UserError as error:
        print(f"{NAME}: {error}", file=sys.stderr)
        code = 2
    except BrokenPipeError:
        # The reader has gone, as with `| head`; nor may the last flush complain of it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 141
    except KeyboardInterrupt:
        print(f"{NAME}: interrupted", file=sys.stderr)
        code = 130
    sys.exit(code)
