"""The commands `grasp`, `report` and `plan`: run a scene, show runs, and choose the methods."""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import msgspec
import tyro

from ..compiled import cold
from ..errors import UserError
from ..folders import prepared
from ..output.frames import FrameFormat
from ..output.logs.write import KINDS, LogFormat, require_logs
from ..output.report import Table, table_lines
from ..scene import load_scene
from ..scene.fingers import fingers, need_one_finger
from ..scene.scene import DEFAULT_SCENE, Body, PathName, Scene, dump_scene, grasp_command
from .options import (
    CORES,
    Allow,
    Changes,
    Flag,
    FollowLinks,
    Overwrite,
    SceneName,
    changes_of,
    check_file,
    check_least,
    counting,
    new_folder,
    option,
    refuse_arguments,
)
from .readouts import prepare, prepare_scene
from .summary import print_summary

MaxRows = Annotated[int, option("largest number of rows of a trace that is read", "N")]
Logs = Annotated[
    tuple[LogFormat, ...] | None,
    option(
        "also write run.mcap for Foxglove and PlotJuggler (extra ros), or run.rrd for Rerun "
        "(extra viz)",
        "mcap|rerun [...]",
    ),
]


def grasp(
    scene_name: Annotated[
        str | None,
        tyro.conf.Positional,
        option("shipped scene, see `chromagrip list scenes`, or a .toml file", "SCENE"),
    ] = None,
    *,
    scene: Annotated[str | None, option("same as SCENE", "NAME|FILE.toml")] = None,
    controller: Annotated[
        str | None,
        option(
            "controller, instead of the scene's; see `chromagrip list controllers`",
            "NAME|MODULE:CLASS",
        ),
    ] = None,
    arguments: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        option(
            "argument of the controller's class, such as gain=2; may be repeated",
            "NAME=VALUE",
            "arg",
        ),
    ] = (),
    path: Annotated[
        PathName | None,
        option(
            "input of the controller: the camera's pictures, or the true forces", "camera|truth"
        ),
    ] = None,
    body: Annotated[
        Body | None,
        option("fingertip: the thesis's chain, or a dome of silicone in 3D", "chain|dome"),
    ] = None,
    renderer: Annotated[
        str | None,
        option(
            "renderer, instead of the scene's; see `chromagrip list renderers`",
            "NAME|MODULE:CLASS",
        ),
    ] = None,
    sensor: Annotated[
        str | None,
        option(
            "sensor, instead of the scene's; see `chromagrip list sensors`, or a .toml file",
            "NAME|FILE",
        ),
    ] = None,
    fps: Annotated[
        float | None, option("camera rate in Hz, short for camera.rate_hz", "HZ")
    ] = None,
    latency: Annotated[
        int | None, option("number of frames between a picture and its command", "FRAMES")
    ] = None,
    seed: Annotated[int | None, option("seed of the camera noise", "N")] = None,
    changes: Changes = (),
    allow: Allow = (),
    out: Annotated[
        Path | None, option("run folder; by default a new one under runs/", "DIR")
    ] = None,
    overwrite: Overwrite = False,
    frames: Annotated[
        FrameFormat | None,
        option("also keep the camera's raw pictures, lossless, in DIR/frames", "png|ffv1"),
    ] = None,
    log: Logs = None,
    answer_within: Annotated[
        float,
        option("longest time in s for an answer of a module:Class; inf is no limit", "SECONDS"),
    ] = 60.0,
    source: Annotated[
        str | None,
        option(
            "real frames instead of the simulation: camera:0, a folder, a video, or another of "
            "`chromagrip list sources`; the first ones must show the unloaded sensor",
            "SOURCE",
        ),
    ] = None,
    gripper: Annotated[
        str | None,
        option(
            "gripper for --source, see `chromagrip list grippers`, or a class with command(force); "
            "by default a simulated one",
            "NAME|MODULE:CLASS",
        ),
    ] = None,
    gripper_arguments: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        option("argument of the gripper's class; may be repeated", "NAME=VALUE", "gripper-arg"),
    ] = (),
    frame_within: Annotated[
        float | None, option("longest time in s to the next frame of --source", "SECONDS")
    ] = None,
    json_only: Annotated[
        Flag,
        option("print the summary as JSON; write a folder only with --out", name="json"),
    ] = False,
) -> int:
    """Run a grasp; write summary, trace, figure and video into a folder.

    Example: chromagrip grasp --scene margin-60hz --set object.friction=0.3 --out runs/slippery
    """
    shortcuts = {
        "controller": controller,
        "path": path,
        "body": body,
        "renderer": renderer,
        "sensor": sensor,
        "camera.rate_hz": fps,
        "camera.latency_frames": latency,
        "seed": seed,
    }
    changed: dict[str, Any] = {key: v for key, v in shortcuts.items() if v is not None}
    for name, value in _arguments("--arg", arguments).items():
        changed[f"controller_arguments.{name}"] = value
    keys = changes_of(changes, changed)
    refuse_arguments("--set", keys, (controller,))
    changed |= keys
    if scene is not None and scene_name is not None:
        raise UserError(f"a scene is given twice: {scene_name} and --scene {scene}")
    scene = scene_name or scene or DEFAULT_SCENE
    resolved = load_scene(scene, changed, allow=allow)
    if not answer_within > 0.0:
        raise UserError(f"--answer-within {answer_within}: expected more than 0; inf is no limit")
    if frames is not None and out is None and json_only:
        raise UserError(f"--frames {frames} needs a folder: give --out as well as --json")
    logs = _asked(log)
    if logs and out is None and json_only:
        raise UserError(f"--log {logs[0]} needs a folder: give --out as well as --json")
    outside: dict[str, Any] = {
        "gripper": gripper,
        "gripper_arguments": _arguments("--gripper-arg", gripper_arguments) or None,
        "frame_within_s": frame_within,
    }
    chosen = {name: value for name, value in outside.items() if value is not None}
    if source is None and chosen:
        flag = next(iter(chosen)).removesuffix("_s").replace("_", "-").removesuffix("uments")
        raise UserError(f"--{flag} is an option of --source: give a --source, or leave it out")
    if source is not None and frames is not None:
        raise UserError(
            f"--frames {frames} is for simulated pictures; those of --source exist already"
        )
    if frame_within is not None and not frame_within > 0.0:
        raise UserError(f"--frame-within {frame_within}: expected more than 0; inf is no limit")
    if out is None and not json_only:
        out = new_folder(f"{Path(scene).stem}-{resolved.controller.replace(':', '-')}")

    if source is not None:
        need_one_finger(resolved, "--source is for")

    from ..loop.run import run  # OpenCV loads only when something is run

    helped = cold() and CORES > 1 and source is None and resolved.path == "camera"
    shared: dict[str, Any] = {
        "overwrite": overwrite,
        "log": logs,
        "answer_within_s": answer_within,
    }
    counted = counting(f"{resolved.controller}, {resolved.path}", "frames")
    with prepared(out, overwrite):  # a folder that is refused costs no solved tables
        pass
    with _second_compiler(resolved) if helped else nullcontext(), counted as progress:
        for finger in fingers(resolved):
            prepare_scene(finger, pictures=out is not None or resolved.path == "camera")
        if source is not None:
            from ..outside.grasp import run_outside

            result = run_outside(resolved, source, out, progress=progress, **shared, **chosen)
        else:
            result = run(resolved, out, progress=progress, frames=frames, **shared)
    if json_only:
        print(json.dumps(result.summary))
    else:
        print_summary(result, Path(scene).stem)
    return 0


#: Runs a scene twice: the mechanics first, then what reads markers.
_SECOND_COMPILER = """
import sys
from chromagrip import load_scene, run
for changes in {"path": "truth"}, {"tracker": "detect"}:
    run(load_scene(sys.argv[1], {"controller": "conservative", **changes}))
"""


@contextmanager
def _second_compiler(scene: Scene) -> Iterator[None]:
    """Compile a scene's mechanics in a second process; this one begins with its pictures."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "scene.toml"
        short = msgspec.structs.replace(scene, duration_s=2.0 * scene.period)
        file.write_text(dump_scene(short, Path(folder)), encoding="utf-8")
        process = subprocess.Popen(
            [sys.executable, "-P", "-c", _SECOND_COMPILER, str(file)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            yield
        finally:
            process.terminate()
            process.wait()


def _asked(log: tuple[LogFormat, ...] | None) -> tuple[LogFormat, ...]:
    """Formats of the logs that are asked for, whose extras are installed."""
    if log == ():
        raise UserError(f"--log: expected one or more of {', '.join(KINDS)}")
    require_logs(log or ())
    return log or ()


def _arguments(flag: str, texts: tuple[str, ...]) -> dict[str, Any]:
    """Arguments of a class by name, from texts NAME=VALUE."""
    for text in texts:
        if "=" not in text:
            raise UserError(f"{flag} {text}: expected name=value, such as gain=2")
    return changes_of(texts, flag=flag)


def plan(
    scene: Annotated[SceneName, tyro.conf.Positional] = DEFAULT_SCENE,
    *,
    tolerance: Annotated[
        float | None, option("largest RMS error of the safety margin Γ, a fraction", "SHARE")
    ] = None,
    changes: Changes = (),
    allow: Allow = (),
    json_only: Annotated[Flag, option("print one JSON object", name="json")] = False,
) -> int:
    """Choose the cheapest methods and steps that keep the error of Γ within a tolerance.

    Without --tolerance it lists every choice with its time per frame in ms and its error of Γ. Both
    were measured in situations like the scene's, by default those of `grasp`.

    Example: chromagrip plan margin-60hz --tolerance 0.1
    """
    from ..loop.fidelity import ALIKE, SAFETY, TABLE, choose, expected, read

    loaded = load_scene(scene, changes_of(changes), allow=allow)
    if tolerance is None:
        found = expected(loaded, read(TABLE))
        choices = [
            {
                "changes": one.changes(loaded),
                "milliseconds": one.milliseconds,
                "margin_error_typical": one.typical,
                "margin_error": one.error,
            }
            for one in found
        ]
        if json_only:
            print(json.dumps({"choices": choices}, ensure_ascii=False))
            return 0
        lines = [
            (
                one.fidelity.name,
                f"{one.milliseconds:.2g}",
                f"{one.typical:.3f}",
                f"{one.error:.3f}",
                "yes" if one.milliseconds <= 1e3 * loaded.period else "no",
            )
            for one in found
        ]
        rate = f"keeps {loaded.camera.rate_hz:g} Hz"
        header = ("methods and steps", "ms a frame", "error of Γ", "at most", rate)
        print(*table_lines(Table(header, tuple(lines))), sep="\n")
        print(
            f"error of Γ: RMS, the median of the {ALIKE} measured situations most like this scene; "
            f"at most: {SAFETY:g} times the largest of them.\n"
            "Times are those of the machine on which they were measured.\n"
            "--tolerance gives the cheapest choice whose `at most` keeps within it, as a command."
        )
        return 0
    choice = choose(tolerance, loaded, read(TABLE))
    if json_only:
        report = {
            "changes": choice.changes,
            "milliseconds": choice.milliseconds,
            "margin_error": choice.error,
            "why": list(choice.lines),
        }
        print(json.dumps(report, ensure_ascii=False))
        return 0
    print(*choice.lines, sep="\n")
    kept = dict(text.split("=", 1) for text in changes)
    print(grasp_command(scene, kept | choice.changes))
    return 0


def report(
    folders: Annotated[
        tuple[Path, ...], tyro.conf.Positional, option("one to six run folders", "DIR [DIR ...]")
    ],
    *,
    out: Annotated[
        Path | None,
        option("file of the page; for one run by default report.html in its folder", "FILE"),
    ] = None,
    log: Logs = None,
    follow_links: FollowLinks = False,
    max_rows: MaxRows = 2_000_000,
) -> int:
    """Write the page of a finished run again, or of several runs side by side.

    The page is one file and needs no network. Logs are written into the runs' folders.

    Example: chromagrip report runs/before runs/after --out compared.html
    """
    from ..loop.results.reports import write_logs_again, write_reports

    check_least(max_rows=(max_rows, 1))
    if not folders:
        raise UserError(
            "no run is given: give one to six folders that `chromagrip grasp` made, such as "
            "`chromagrip report runs/thesis-safety-margin-001`"
        )
    if out is not None and out.parent.is_dir():  # a missing folder is made
        check_file(out, {".html"}, overwrite=True)
    if out is None and len(folders) > 1:
        out = new_folder("report") / "report.html"
    logs = _asked(log)
    limits = (follow_links, max_rows)
    for path in (write_reports(folders, out, *limits), *write_logs_again(folders, logs, *limits)):
        print(path)
    return 0


def live(
    scene: Annotated[
        str | None,
        tyro.conf.Positional,
        option("shipped scene, or a .toml file; by default dome-1", "NAME|FILE.toml"),
    ] = None,
    *,
    changes: Changes = (),
    allow: Allow = (),
    run: Annotated[Path | None, option("finished run to show instead", "DIR")] = None,
    source: Annotated[
        str | None,
        option(
            "frames to show instead: camera:0, a folder, a video, or another of `chromagrip list "
            "sources`",
            "SOURCE",
        ),
    ] = None,
    calibration: Annotated[
        str | None,
        option(
            "sensor of --source: file of `chromagrip calibrate sensor`, or a shipped sensor",
            "NAME|FILE",
        ),
    ] = None,
    rest: Annotated[
        str | None,
        option("unloaded sensor of --source, as in `estimate`; by default first:8", "REST"),
    ] = None,
    reconstructor: Annotated[
        str | None,
        option(
            "reconstructor of forces of --source, see `chromagrip list reconstructors`",
            "NAME|MODULE:CLASS",
        ),
    ] = None,
    fps: Annotated[float | None, option("frame rate of --source in Hz", "HZ")] = None,
    record: Annotated[
        Path, option("folder for grasps that the button `record` keeps", "DIR")
    ] = Path("runs/live"),
    host: Annotated[
        str, option("address of this machine; any except for 127.0.0.1 lets others in", "HOST")
    ] = "127.0.0.1",
    port: Annotated[int, option("port of the page", "N")] = 8090,
    token: Annotated[
        str | None, option("token in the page's address; by default a new one", "TEXT")
    ] = None,
    seconds: Annotated[float | None, option("time in s after which the page ends", "S")] = None,
    follow_links: FollowLinks = False,
    max_rows: MaxRows = 2_000_000,
) -> int:
    """Serve a browser page with a running grasp and sliders, a finished run, or a camera.

    It shows the fingertip in 3D, the camera's picture and curves. Ctrl-C ends it.

    Example: chromagrip live dome-1 --set object.friction=0.4 --seconds 10
    """
    from ..live.serve import Address, serve_grasp, token_for
    from ..live.sliders import scene_for, slider_values

    if run is not None and source is not None:
        raise UserError("--run and --source are two pages; give one of them")
    other = "--run" if run is not None else "--source" if source is not None else ""
    if other and (scene is not None or changes):
        raise UserError(f"{other} has a scene of its own; leave out scene and --set")
    of_source = {
        "calibration": calibration,
        "rest": rest,
        "reconstructor": reconstructor,
        "fps": fps,
    }
    for name, value in of_source.items():
        if value is not None and source is None:
            raise UserError(f"--{name} is an option of --source: give a --source, or leave it out")
    check_least(fps=(fps, 1e-3), seconds=(seconds, 0.0), max_rows=(max_rows, 1))
    if record.is_file():
        raise UserError(f"--record {record}: it is a file, not a folder")

    def ready(address: str) -> None:
        print(f"{address}  (Ctrl-C ends)", file=screen, flush=True)

    def waiting(sentence: str) -> None:
        print(sentence, file=screen, flush=True)

    screen = sys.stdout  # which is another one while viser says goodbye
    place = Address(host=host, port=port, token=token_for(token), seconds=seconds, ready=ready)
    if run is not None:
        from ..live.run_page import serve_run
        from ..loop.results.run_folder import read_run

        serve_run(read_run(run, follow_links, max_rows, allow=allow), place)
    elif source is not None:
        from ..live.watch import Looking, serve_source

        if calibration is None:
            raise UserError("--source needs --calibration, of the sensor before the camera")
        looking = Looking(
            source=source,
            rest=rest or "first:8",
            fps=fps,
            calibration=calibration,
            reconstructor=reconstructor or "auto",
        )
        prepare(looking.known, looking.reconstructor)
        serve_source(looking, place)
    else:
        resolved = load_scene(
            scene or "dome-1",
            {"path": "camera"} | changes_of(changes),
            allow=allow,
        )
        scene_for(resolved, slider_values(resolved))  # what cannot be shown is refused at once
        serve_grasp(
            resolved, place, record, lambda: prepare_scene(resolved, pictures=True), waiting
        )
    return 0
