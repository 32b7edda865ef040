"""What the commands of the command line share: options, tables, progress, interruption."""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import tyro

from .errors import UserError

Flag = tyro.conf.FlagCreatePairsOff[bool]

_interrupted = threading.Event()


def option(text: str, metavar: str | None = None, name: str | None = None) -> Any:
    """Help, placeholder and name of an option."""
    return tyro.conf.arg(help=text, metavar=metavar, name=name)


Quick = Annotated[Flag, option("a smaller run, labelled so")]
Out = Annotated[Path | None, option("folder; by default a new one under runs/", "DIR")]
Force = Annotated[Flag, option("write over an earlier result in --out")]
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
