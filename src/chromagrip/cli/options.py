"""Options, tables, progress and interruption that the commands share."""

import json
import math
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)
from rich.status import Status
from rich.table import Table

from ..errors import UserError, meant
from ..folders import make_folder
from ..strict_toml import Values

Flag = tyro.conf.FlagCreatePairsOff[bool]
#: Processors of this machine.
CORES = os.cpu_count() or 1
#: Shortest time between two lines on progress where there is no terminal [s].
EVERY_S = 10.0


def option(text: str, metavar: str | None = None, name: str | None = None) -> Any:
    """Help, placeholder and name of an option."""
    return tyro.conf.arg(help=text, metavar=metavar, name=name, help_behavior_hint=_default)


def _default(value: str) -> str:
    """Mention of a default in a help page; none for options that are off or empty."""
    return "" if value in ("None", "False", "", "''") else f"(default: {value})"


Quick = Annotated[Flag, option("shorter run; the results are labelled as such")]
Out = Annotated[
    Path | None, option("folder of the results; by default a new one under runs/", "DIR")
]
Overwrite = Annotated[Flag, option("overwrite an earlier result in --out")]
FollowLinks = Annotated[
    Flag,
    option("follow links out of the folder, as in caches of Hugging Face", name="follow-links"),
]
SceneName = Annotated[
    str, option("shipped scene, see `chromagrip list scenes`, or a .toml file", "NAME|FILE.toml")
]
Changes = Annotated[
    tuple[str, ...],
    tyro.conf.UseAppendAction,
    option(
        "change one value of the scene, such as object.friction=0.3; may be repeated",
        "KEY=VALUE",
        "set",
    ),
]
Allow = Annotated[
    tuple[str, ...],
    tyro.conf.UseAppendAction,
    option("module whose classes the file may use; may be repeated; others are refused", "MODULE"),
]
Rest = Annotated[
    str,
    tyro.conf.Positional,
    option(
        "unloaded sensor: a picture, or a folder or video whose first frames are averaged; first "
        "or first:N for the first frames of SOURCE; auto for its frame whose two layers match best",
        "REST",
    ),
]
SourceName = Annotated[
    str,
    tyro.conf.Positional,
    option(
        "frames to read: folder, video file, picture, camera:0, or another of `chromagrip list "
        "sources`",
        "SOURCE",
    ),
]
TrackerName = Annotated[
    str, option("tracker of the markers, see `chromagrip list trackers`", "NAME|MODULE:CLASS")
]
Noise = Annotated[
    float | None,
    option(
        "standard deviation of the camera noise in levels of 0 to 255; by default estimated at "
        "rest",
        "LEVELS",
    ),
]
Crop = Annotated[
    str | None,
    option("part of the picture with the sensor, in px; by default found", "LEFT,TOP,WIDTH,HEIGHT"),
]
Mask = Annotated[
    Path | None,
    option("picture, white on the sensor and black elsewhere", "IMAGE"),
]
Fps = Annotated[
    float | None,
    option("frame rate in Hz; by default 30 for pictures, and the video's own for a video", "HZ"),
]
MaxMegapixels = Annotated[
    float, option("largest picture in megapixels; a larger one is refused", "MP")
]
ValueRange = Annotated[
    str | None, option("values of black and white of pictures above 8 bits", "BLACK,WHITE")
]
Frames = Annotated[int | None, option("largest number of frames", "N")]
Workers = Annotated[int, option("number of processes", "N")]
Json = Annotated[Flag, option("print one JSON object", name="json")]
JsonOnly = Annotated[
    Flag, option("print one JSON object; write a folder only with --out", name="json")
]


def print_list(entries: Mapping[str, str], json_only: bool) -> int:
    """Print names, each with one line about it."""
    if json_only:
        print(json.dumps(dict(entries), ensure_ascii=False))
        return 0
    width = max(map(len, entries))
    for name, text in entries.items():
        print(f"{name:<{width}}  {text}")
    return 0


def print_values(values: Mapping[str, object], json_only: bool) -> None:
    """Print the values of a result by their names."""
    if json_only:
        print(json.dumps(dict(values), ensure_ascii=False))
        return
    print_list({name: in_words(value) for name, value in values.items()}, json_only=False)


def in_words(value: object) -> str:
    """Value of a result as text for a reader: lists and tables without brackets."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {in_words(each)}" for name, each in value.items()) or "none"
    if isinstance(value, list | tuple):
        return ", ".join(map(in_words, value)) or "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "–" if value is None else str(value)


def print_table(table: Table) -> None:
    """Print a table to the screen as it is, without markup."""
    Console(markup=False, highlight=False).print(table)


def value_table() -> Table:
    """Table with a name and a value in each line."""
    return Table(show_header=False, box=None, padding=(0, 2))


def check_least(**options: tuple[float | None, float]) -> None:
    """Refuse options that are given and lie below their lowest value.

    Parameters
    ----------
    options: value and lowest value, by the name of the option
    """
    for name, (value, least) in options.items():
        if value is not None and not (math.isfinite(value) and value >= least):
            raise UserError(f"--{name.replace('_', '-')} {value}: expected {least:g} or more")


def changes_of(
    texts: Iterable[str], shortcuts: Mapping[str, object] | None = None, flag: str = "--set"
) -> Values:
    """Values by key of texts KEY=VALUE; a key that is given twice is refused.

    Parameters
    ----------
    texts: as typed
    shortcuts: values of options that stand for a key, by the key
    flag: option that the texts are of
    """
    from ..scene.scene import parse_change

    changes, typed = Values(), dict.fromkeys(shortcuts or (), "an option of its own")
    for text in texts:
        key, value = parse_change(text)
        if key in typed:
            raise UserError(f"{key} is given twice: by {typed[key]} and {flag} {text}")
        changes[key], typed[key] = value, f"{flag} {text}"
    return changes


def refuse_arguments(flag: str, keys: Iterable[str], controllers: Iterable[str | None]) -> None:
    """Refuse an argument of a controller of one's own where a key of a scene is wanted."""
    from ..scene.scene import Scene
    from ..strict_toml import all_keys

    if not any(":" in name for name in controllers if name):
        return
    for key in keys:
        if "." not in key and key not in Scene.__struct_fields__:
            raise UserError(
                f"{flag} {key}: a scene has no such key{meant(key, all_keys(Scene))}; for an "
                f"argument of your controller give --arg {key}=VALUE" + ",…" * (flag == "--vary")
            )


def check_file(path: Path, suffixes: set[str], overwrite: bool) -> None:
    """Refuse before the work a file that could not be written after it."""
    if path.suffix.lower() not in suffixes:
        raise UserError(f"file {path} must end in {' or '.join(sorted(suffixes))}")
    if path.is_dir():
        raise UserError(f"{path} is a folder, not a file")
    if not path.parent.is_dir():
        raise UserError(f"file {path} cannot be written: there is no folder {path.parent}")
    if path.exists() and not overwrite:
        raise UserError(f"file {path} exists; choose another or give --overwrite")


def new_folder(stem: str) -> Path:
    """First unused runs/STEM-NNN, made at once: another command that starts now gets the next.

    Raises
    ------
    UserError
        When all names are used, or it cannot be made.
    """
    for number in range(1, 10_000):
        folder = Path("runs") / f"{stem}-{number:03d}"
        try:
            make_folder(folder, new=True)
        except FileExistsError:
            continue
        except OSError as error:
            raise UserError(f"folder {folder} cannot be written: {error.strerror}") from None
        return folder
    raise UserError(f"runs/ holds 9999 runs named {stem}; choose a folder with --out")


def stem_of(source: str) -> str:
    """Name of a source for a folder: only a file's suffix is left out, what follows other dots not.

    Parameters
    ----------
    source: path of a file or a folder, a pattern, or a name such as camera:0(fps=60)
    """
    path = Path(source)
    if not path.exists():
        path = Path(re.sub(r"\W*[*?[].*", "", source.partition("(")[0]) or "frames")
    if not path.name.strip("."):  # . and .. are folders that have a name of their own
        path = Path(os.path.realpath(path))
    return (path.name if path.is_dir() else path.stem).replace(":", "-")


@contextmanager
def going_on(out: Path | None, unfinished: str) -> Iterator[None]:
    """Say after an interruption how to go on with what is unfinished in a folder."""
    try:
        yield
    except KeyboardInterrupt:
        if out is not None and (out / unfinished).exists():
            print(
                f"chromagrip: what is done is in {out}; call it again with --out {out} to go on",
                file=sys.stderr,
            )
        raise


def _screen() -> Console:
    # A notebook sets FORCE_COLOR, and would get every state of a bar below the one before.
    return Console(stderr=True, force_terminal=sys.stderr.isatty())


class _Log:
    """Lines on the progress of long work where no bar can be drawn, some seconds apart."""

    def __init__(self) -> None:
        self._last = time.monotonic()

    def tell(self, text: str) -> None:
        """Print the current step, unless a line or the beginning was just now."""
        now = time.monotonic()
        if now - self._last >= EVERY_S and not sys.stderr.isatty():
            self._last = now
            print(f"chromagrip: {text}", file=sys.stderr, flush=True)


@contextmanager
def status(text: str = "starting") -> Iterator[Callable[[str], None]]:
    """Show the current step of long work; yields the function that changes it."""
    with _screen().status(text) as line:
        yield _reporter(line)


def _reporter(line: Status) -> Callable[[str], None]:
    log = _Log()

    def report(text: str) -> None:
        line.update(text)
        log.tell(text)
        stop_if_interrupted()

    return report


@contextmanager
def counting(
    text: str, unit: str = "", transient: bool = True, logged: str = ""
) -> Iterator[Callable[..., None]]:
    """Show a bar; yields a function of (done, total or None, text or None) that moves it.

    Parameters
    ----------
    text: of the bar
    unit: of what is counted
    transient: whether the bar goes away at the end
    logged: line for a log, once there is something to count; a bar is for a terminal alone
    """
    console = _screen()
    unsaid, log = bool(logged) and not console.is_terminal, _Log()
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        TaskProgressColumn(text_format="", text_format_no_percentage="", show_speed=True),
        TimeRemainingColumn(),
        console=console,
        transient=transient,
        disable=not console.is_terminal,  # else it leaves a blank line in a log
    ) as bar:
        task = bar.add_task(text, total=None)

        def move(done: int, total: int | None = None, words: str | None = None) -> None:
            nonlocal unsaid
            if unsaid:
                print(f"chromagrip: {logged}", file=sys.stderr, flush=True)
                unsaid = False
            bar.update(task, completed=done, total=total, description=words or text)
            of = "" if total is None else f" of {total}"
            log.tell(f"{words or text}: {done}{of} {unit}".rstrip())
            stop_if_interrupted()

        yield move


_received: list[int] = []
_interrupted = threading.Event()


def take_signals() -> None:
    """End the command in order on Ctrl-C and SIGTERM."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)


def _interrupt(number: int, _frame: object) -> None:
    _received.append(number)
    _interrupted.set()
    raise KeyboardInterrupt(number)


def stop_if_interrupted() -> None:
    """Stop here if an interruption was lost, as it is while a kernel is being compiled."""
    if _interrupted.is_set():
        raise KeyboardInterrupt(*_received[-1:])
