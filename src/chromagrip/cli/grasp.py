"""The commands `grasp` and `plan`: run a scene, and choose how finely it is computed."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from ..errors import UserError, located
from ..output.frames import FrameFormat
from ..scene import load_scene
from ..scene.scene import DEFAULT_SCENE, Body, PathName, grasp_command, parse_change
from .options import (
    Changes,
    Flag,
    JsonOnly,
    Overwrite,
    SceneName,
    counting,
    new_folder,
    option,
    print_table,
    value_table,
)
from .pinch import run_two
from .readouts import make_dome_tables, train_if_missing

if TYPE_CHECKING:
    from ..loop.trace import Summary


def grasp(
    *,
    scene: SceneName = DEFAULT_SCENE,
    controller: Annotated[
        str | None,
        option("instead of the scene's; see `chromagrip controllers`", "NAME|MODULE:CLASS"),
    ] = None,
    arguments: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        option("argument of a controller's class, such as gain=2", "NAME=VALUE", "arg"),
    ] = (),
    path: Annotated[
        PathName | None,
        option(
            "input of the controller: the camera's pictures, or the true forces", "camera|truth"
        ),
    ] = None,
    body: Annotated[
        Body | None,
        option("fingertip: the thesis's slice, or silicone in three dimensions", "chain|dome"),
    ] = None,
    renderer: Annotated[
        str | None,
        option("instead of the scene's; see `chromagrip renderers`", "NAME|MODULE:CLASS"),
    ] = None,
    sensor: Annotated[
        str | None,
        option("instead of the scene's; see `chromagrip sensors`, or a .toml file", "NAME|FILE"),
    ] = None,
    fps: Annotated[float | None, option("camera rate, short for camera.rate_hz", "HZ")] = None,
    latency: Annotated[
        int | None, option("frames between an image and the command from it", "FRAMES")
    ] = None,
    seed: Annotated[int | None, option("of the camera noise", "N")] = None,
    changes: Changes = (),
    out: Annotated[
        Path | None, option("run folder; by default a new one under runs/", "DIR")
    ] = None,
    overwrite: Overwrite = False,
    frames: Annotated[
        FrameFormat | None,
        option("keep the camera's raw pictures too, lossless, in DIR/frames", "png|ffv1"),
    ] = None,
    json_only: Annotated[
        Flag,
        option("print the summary as JSON; a folder is written only with --out", name="json"),
    ] = False,
) -> int:
    """Run a grasp and leave summary, trace, figure and video in a folder.

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
    for text in arguments:
        if "=" not in text:
            raise UserError(f"--arg {text}: expected name=value, such as gain=2")
        name, value = parse_change(text)
        changed[f"controller_arguments.{name}"] = value
    changed |= dict(parse_change(text) for text in changes)
    resolved = load_scene(scene, changed)
    if frames is not None and out is None and json_only:
        raise UserError(f"--frames {frames} needs a folder: give --out beside --json")
    if out is None and not json_only:
        out = new_folder(f"{Path(scene).stem}-{resolved.controller.replace(':', '-')}")

    if resolved.pinch.mass_g:
        if frames is not None:
            raise UserError("--frames keeps the pictures of one finger; this scene is a pinch")
        return run_two(resolved, out, overwrite, json_only)

    from ..loop.methods import reconstructor_for  # OpenCV loads only when something is run
    from ..loop.observers import known_sensor
    from ..loop.run_folder import run

    make_dome_tables(resolved, pictures=out is not None or resolved.path == "camera")
    if resolved.path == "camera" and not resolved.build_sensor().shape.flat:
        with located(f"sensor {resolved.sensor}"):
            name = reconstructor_for(resolved.body, resolved.reconstructor)
            train_if_missing(known_sensor(resolved), name)
    with counting(f"{resolved.controller}, {resolved.path}", "frames") as progress:
        result = run(resolved, out, overwrite=overwrite, progress=progress, frames=frames)
    if json_only:
        print(json.dumps(result.summary))
    else:
        _print_summary(result.summary, result.folder)
    return 0


def _print_summary(summary: "Summary", folder: Path | None) -> None:
    from ..render import load_sensor
    from ..tracking.forces import pose_words

    def number(value: float | None, digits: int = 3) -> str:
        return "–" if value is None else f"{value:z.{digits}f}"

    table = value_table()
    table.add_row("controller", f"{summary['controller']}, {summary['path']} path")
    table.add_row(
        "safety margin at the end",
        f"{number(summary['final_margin_true'])} true, "
        f"{number(summary['final_margin_estimated'])} estimated",
    )
    if summary["mechanics"] == "dome":
        table.add_row(
            "the same with torsion",
            f"{number(summary['final_limit_margin_true'])} true, "
            f"{number(summary['final_limit_margin_estimated'])} estimated; "
            f"the object turned by {number(summary['final_turn_deg'], 1)}°",
        )
    if summary["without_estimate"]:
        because = next(iter(summary["without_estimate_because"]))
        frames = f"{summary['without_estimate']} of {summary['frames']} frames"
        table.add_row("no estimate in", f"{frames}, mostly: {because}")
    table.add_row("error of the margin, RMS", number(summary["margin_rmse"]))
    if summary["camera_pose"] and summary["camera_pose"]["notable"]:
        table.add_row("camera", pose_words(summary["camera_pose"]))
    table.add_row(
        "lateral displacement",
        f"{number(summary['lateral_displacement_mm'])} mm, "
        f"{'gross slip' if summary['gross_slip'] else 'no gross slip'}",
    )
    for event in summary["slip_reactions"]:
        table.add_row(
            "reacted to slip at",
            f"{event['time_s']:.3f} s, {event['lateral_displacement_mm']:.3f} mm",
        )
    markers = load_sensor(summary["sensor"]).markers
    if summary["mechanics"] == "chain" and (markers.swell_mm or markers.stretch):
        table.add_row("mechanics", "those of the chain, not of this dome's silicone")
    table.add_row("largest grip force", f"{number(summary['max_grip_n'])} N")
    table.add_row("largest pressure", f"{number(summary['max_pressure_n_per_m'], 0)} N/m")
    table.add_row("speed", f"{number(summary['frames_per_second'], 1)} frames/s")
    if folder is not None:
        table.add_row("folder", str(folder))
    print_table(table)


def plan(
    scene: Annotated[SceneName, tyro.conf.Positional],
    *,
    tolerance: Annotated[float, option("of the safety margin Γ, RMS", "SHARE")] = 0.05,
    changes: Changes = (),
    json_only: JsonOnly = False,
) -> int:
    """Choose the cheapest methods and steps that keep Γ of a scene within a tolerance.

    The choice uses what `chromagrip chart loop --update` measured in situations like the scene's.

    Example: chromagrip plan margin-60hz --tolerance 0.1
    """
    from ..loop.fidelity import Fidelity

    choice = Fidelity.auto(tolerance, load_scene(scene, dict(map(parse_change, changes))))
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
