"""Reports of finished runs, of one finger or two, and comparisons of several runs."""

import os
from collections.abc import Sequence
from pathlib import Path

from ...errors import UserError
from ...folders import disk_errors
from ...output.logs.write import LogFormat, require_logs, write_logs
from ...output.run_page import write_run_page
from .log import log_of
from .report import REPORT, run_on_page
from .run_folder import read_run
from .trace_file import MOST_ROWS


def write_reports(
    folders: Sequence[Path],
    out: Path | None = None,
    follow_links: bool = False,
    max_rows: int = MOST_ROWS,
) -> Path:
    """Write the report of a run, or one that compares several runs; returns its path.

    Parameters
    ----------
    folders: run folders, 1 to 6, which can be told apart
    out: file of the page (default: report.html in the only folder)
    follow_links, max_rows: as in `read_run`

    Raises
    ------
    UserError
        For a folder without a finished run, too many folders, and several without `out`.
    """
    if not 1 <= len(folders) <= 6:
        raise UserError(f"a report has 1 to 6 runs, not {len(folders)}")
    if out is None and len(folders) > 1:
        raise UserError("a report of several runs needs a file of its own: give --out FILE.html")
    path = folders[0] / REPORT if out is None else out
    named = zip(folders, _names(folders), strict=True)
    read = ((read_run(folder, follow_links, max_rows), name) for folder, name in named)
    runs = [run_on_page(run, name) for run, name in read]
    title = runs[0].name if len(runs) == 1 else f"{len(runs)} runs side by side"
    with disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_run_page(path, runs, title)
    return path


def write_logs_again(
    folders: Sequence[Path],
    formats: Sequence[LogFormat],
    follow_links: bool = False,
    max_rows: int = MOST_ROWS,
) -> list[Path]:
    """Write the logs of finished runs into their folders; returns their paths.

    Parameters
    ----------
    folders: run folders
    formats: formats of the logs
    follow_links, max_rows: as in `read_run`

    Raises
    ------
    UserError
        For a folder without a finished run, a missing extra, and a log that cannot be written.
    """
    require_logs(formats)
    paths: list[Path] = []
    for folder in folders if formats else ():
        run = read_run(folder, follow_links, max_rows)
        paths += write_logs(log_of(run), folder, formats)
    return paths


def _names(folders: Sequence[Path]) -> list[str]:
    """Names of folders, with as much of their paths as distinguishes them."""
    parts = [Path(os.path.realpath(folder)).parts for folder in folders]
    for depth in range(1, max(map(len, parts)) + 1):
        names = ["/".join(part[-depth:]) for part in parts]
        if len(set(names)) == len(names):
            return names
    raise UserError("the same folder is given twice")
