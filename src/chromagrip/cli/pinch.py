"""What `grasp` does with a scene of two fingers."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..output.frames import FrameFormat
from ..output.logs.write import LogFormat
from ..scene.fingers import fingers
from .options import counting, print_table, value_table
from .readouts import prepare_scene

if TYPE_CHECKING:
    from ..loop.trace import Summary
    from ..scene.scene import Scene


def run_two(
    scene: "Scene",
    out: Path | None,
    overwrite: bool,
    answer_within: float,
    frames: FrameFormat | None,
    log: Sequence[LogFormat],
    json_only: bool,
) -> int:
    """Run a pinch, and print its summary."""
    from ..loop.run_folder import run  # OpenCV loads only when something is run

    for finger in fingers(scene):
        prepare_scene(finger, pictures=out is not None or scene.path == "camera")
    with counting(f"{scene.controller}, {scene.path}", "frames") as progress:
        result = run(
            scene, out, overwrite=overwrite, progress=progress, frames=frames,
            log=log, answer_within_s=answer_within,
        )  # fmt: skip
    if json_only:
        print(json.dumps(result.summary))
    else:
        _print_summary(result.summary, result.folder)
    return 0


def _print_summary(summary: "Summary", folder: Path | None) -> None:
    def number(name: str, digits: int = 3) -> str:
        value = summary[name]
        return "–" if value is None else f"{value:z.{digits}f}"

    table = value_table()
    table.add_row("controller", f"{summary['controller']}, {summary['path']} path")
    mass, final = summary["mass_g"], summary["final_mass_g"]
    filled = "" if final in (None, mass) else f", {final:g} g at the end"
    stands = "" if summary["lifted"] else ", on the table at the end"
    table.add_row("the object", f"{mass:g} g{filled}: {summary['outcome']}{stands}")
    table.add_row(
        "smaller margin at the end",
        f"{number('final_margin_true')}, with torsion {number('final_limit_margin_true')}",
    )
    if summary["smallest_limit_margin_true"] is not None:
        smallest = number("smallest_limit_margin_true")
        table.add_row("smallest while lifted", f"{smallest} with torsion")
    table.add_row("error of the margin, RMS", number("margin_rmse"))
    if summary["without_estimate"]:
        because = next(iter(summary["without_estimate_because"]))
        table.add_row("no estimate", f"{summary['without_estimate']} times, mostly: {because}")
    table.add_row("slid by", f"{number('slide_mm', 2)} mm")
    table.add_row(
        "turned by",
        f"{number('largest_turn_deg', 1)}° at most, and the skins by "
        f"{number('largest_elastic_deg', 1)}°",
    )
    table.add_row("largest pressure", f"{number('max_pressure_kpa', 1)} kPa")
    table.add_row(
        "grip", f"{number('max_grip_n', 2)} N at most, {number('final_grip_n', 2)} N at the end"
    )
    table.add_row("speed", f"{number('frames_per_second', 1)} frames/s")
    if folder is not None:
        table.add_row("folder", str(folder))
    print_table(table)
