"""The command `reproduce`: the thesis's results beside ours."""

import json
import os
from typing import Annotated, Literal, get_args

import tyro
from rich.console import Console

from ..errors import UserError
from ..output.report import Report, print_report
from .options import Force, JsonOnly, Out, Quick, check_least, new_folder, option, telling

PartName = Literal[
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
CameraScene = Literal["thesis", "camera-100hz"]


def reproduce(
    part: Annotated[
        PartName, tyro.conf.Positional, option("of the thesis", "|".join(get_args(PartName)))
    ] = "all",
    *,
    camera: Annotated[
        CameraScene | None,
        option(
            "Table 2 and Figs. 13 to 15 through the camera too: at 1000 Hz with the printed gains, "
            "or at 100 Hz with those retuned for it",
            "thesis|camera-100hz",
        ),
    ] = None,
    workers: Annotated[int, option("processes", "N")] = os.cpu_count() or 1,
    quick: Quick = False,
    out: Out = None,
    force: Force = False,
    json_only: JsonOnly = False,
) -> int:
    """Reproduce the thesis: every result beside what it prints, with a verdict, on one page.

    Interrupted, it goes on where it was when it is called again with the same --out.
    """
    check_least(workers=(workers, 1))
    from ..measure.reproduce.parts import PARTS, Plan
    from ..measure.reproduce.parts import reproduce as compare

    if out is None and not json_only:
        out = new_folder("reproduce" if part == "all" else part)
    if camera and part not in ("all", "table-2", "figure-13", "figure-14", "figure-15"):
        raise UserError(f"--camera goes with all, table-2 and figure-13 to -15, not with {part}")
    parts: list[str] = list(PARTS) if part == "all" else [part]
    with Console(stderr=True).status("starting") as status:
        report, _ = compare(parts, Plan(quick, camera), out, force, workers, telling(status))
    if json_only:
        print(json.dumps(report.as_json()))
        return 0
    print_report(Report(rows=(), notes=report.notes))
    print(f"folder {out}, open index.html")
    return 0
