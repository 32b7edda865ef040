"""What the commands of the command line share: options, tables, progress, interruption."""

import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from ..errors import UserError

Flag = tyro.conf.FlagCreatePairsOff[bool]

_interrupted = threading.Event()


def option(text: str, metavar: str | None = None, name: str | None = None) -> Any:
    """Help, placeholder and name of an option."""
    return tyro.conf.arg(help=text, metavar=metavar, name=name)


Quick = Annotated[Flag, option("a smaller run, labelled so")]
Out = Annotated[Path | None, option("folder; by default a new one under runs/", "DIR")]
Force = Annotated[Flag, option("write over an earlier result in --out")]
Rest = Annotated[
    str,
    tyro.conf.Positional,
    option(
        "the unloaded sensor: a picture, or a folder or video whose first frames are averaged; "
        "first or first:N frames of the source; auto for its frame whose layers lie best on "
        "each other",
        "REST",
    ),
]
SourceName = Annotated[
    str,
    tyro.conf.Positional,
    option("folder of pictures, video file, picture or camera:0", "SOURCE"),
]
TrackerName = Annotated[str, option("see `chromagrip trackers`, or your own", "NAME|module:Class")]
Noise = Annotated[
    float | None, option("of the camera; by default estimated from the rest", "LEVELS")
]
Fps = Annotated[
    float | None,
    option("frame rate of pictures (by default 30), or instead of a video's own", "HZ"),
]
Frames = Annotated[int | None, option("stop after so many", "N")]
JsonOnly = Annotated[Flag, option("one JSON object; writes a folder only with --out", name="json")]


def print_rows(rows: list[dict[str, Any]]) -> None:
    """Measured figures, one a line."""
    for row in rows:
        value = "–" if row["value"] is None else f"{row['value']:.4g}"
        verdict = "" if row["met"] else "MISSED"
        print(f"{row['name']:<46} {value:>9} {row['unit']:<9} {row['target']:<11} {verdict}")


def telling(status: Any) -> Callable[[str], None]:
    """What long work calls with what it is at: shows it, and stops when interrupted."""

    def tell(text: str) -> None:
        status.update(text)
        stop_if_interrupted()

    return tell


def check_least(**options: tuple[float | None, float]) -> None:
    """Refuse options that are given and are not at least what is told, both by name."""
    for name, (value, least) in options.items():
        if value is not None and not (math.isfinite(value) and value >= least):
            raise UserError(f"--{name} {value}: expected {least:g} or more")


@contextmanager
def frame_progress(
    words: str,
) -> Iterator[tuple[Callable[[str], None], Callable[[int, int | None], None]]]:
    """Bar that counts frames: what tells what is being done, and what is called after each one."""
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f} frames"),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    ) as bar:
        task = bar.add_task("opening", total=None)

        def tell(text: str) -> None:
            bar.update(task, description=text)
            stop_if_interrupted()

        def progress(done: int, total: int | None) -> None:
            bar.update(task, description=words, completed=done, total=total)
            stop_if_interrupted()

        yield tell, progress


def check_file(path: Path, suffixes: set[str], force: bool) -> None:
    """Refuse before the work what could not be written after it."""
    if path.suffix not in suffixes:
        raise UserError(f"file {path} must end in {' or '.join(sorted(suffixes))}")
    if path.is_dir():
        raise UserError(f"{path} is a folder, not a file")
    if not path.parent.is_dir():
        raise UserError(f"file {path} cannot be written: there is no folder {path.parent}")
    if path.exists() and not force:
        raise UserError(f"file {path} exists; choose another or give --force")


def new_folder(stem: str) -> Path:
    """First unused runs/STEM-NNN."""
    for number in range(1, 10_000):
        folder = Path("runs") / f"{stem}-{number:03d}"
        if not folder.exists():
            return folder
    raise UserError(f"runs/ holds 9999 runs named {stem}; choose a folder with --out")


def interrupt(_signal: int, _frame: Any) -> None:
    """Take an interruption, and remember it."""
    _interrupted.set()
    raise KeyboardInterrupt


def stop_if_interrupted() -> None:
    """Stop here if an interruption got lost, as it does while a kernel is being compiled."""
    if _interrupted.is_set():
        raise KeyboardInterrupt
