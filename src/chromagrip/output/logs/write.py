"""Writing logs into a folder."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ...extras import require
from .entries import Log
from .mcap_file import write_mcap
from .rerun_file import write_rerun

#: Formats of a log.
LogFormat = Literal["mcap", "rerun"]


@dataclass(frozen=True)
class Kind:
    """A format of logs.

    Attributes
    ----------
    file: name of the log in a run folder
    extra: that it needs
    write: writes a log to a path, as a file that is whole or not there
    """

    file: str
    extra: str
    write: Callable[[Log, Path], None]


KINDS: dict[LogFormat, Kind] = {
    "mcap": Kind("run.mcap", "ros", write_mcap),
    "rerun": Kind("run.rrd", "viz", write_rerun),
}
#: Names of the logs in a run folder.
LOG_FILES = tuple(kind.file for kind in KINDS.values())


def require_logs(formats: Sequence[LogFormat]) -> None:
    """Refuse before anything is computed where a log cannot be written.

    Raises
    ------
    UserError
        When the extra of one is not installed.
    """
    require(*(KINDS[each].extra for each in formats))


def write_logs(log: Log, folder: Path, formats: Sequence[LogFormat]) -> list[Path]:
    """Write a log in these formats into a folder; the files, which are whole or not there.

    Raises
    ------
    UserError
        When one cannot be written, as where the disk is full, or its extra is missing.
    """
    paths = []
    for each in dict.fromkeys(formats):
        paths.append(folder / KINDS[each].file)
        KINDS[each].write(log, paths[-1])
    return paths
