"""The command `report`: runs as a page with a time slider."""

from pathlib import Path
from typing import Annotated

import tyro

from .options import new_folder, option


def report(
    folders: Annotated[tuple[Path, ...], tyro.conf.Positional, option("run folders", "DIR")],
    *,
    out: Annotated[
        Path | None,
        option("file of the page; of one run by default report.html in its folder", "FILE"),
    ] = None,
) -> int:
    """Write the page of a finished run anew, or of several runs side by side.

    The page holds everything that it shows and needs no network.

    Example: chromagrip report runs/before runs/after --out compared.html
    """
    from ..rig.report import write_reports

    if out is None and len(folders) > 1:
        out = new_folder("report") / "report.html"
    print(write_reports(folders, out))
    return 0
