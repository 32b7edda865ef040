"""The one reader of run folders; damage is refused in one sentence with the file and the place.

The folder may be a stranger's. Links out of it are refused, and sizes are checked before reading.
"""

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from ...errors import UserError
from ...scene.scene import Mechanics, PathName, Scene, load_scene
from ...sources import open_source
from ...strange_files import inside
from ..columns import columns_of
from ..trace import Summary
from .expected_error import ExpectedError
from .trace_file import LARGEST, MEND, MOST_ROWS, TRACE, VIDEO, read_trace

Array = NDArray[np.float64]

#: Files that a finished run has.
NEEDED = ("summary.json", "scene.toml", TRACE)
#: Largest text that is read whole [bytes].
LARGEST_TEXT = 2**24
#: Largest video or picture that is read whole [bytes].
LARGEST_FILE = 2**28
#: Endings of the names of columns that older traces lack, by the number of fingers.
_LATER = {1: (), 2: ("_deviation_n", "_deviation_nmm", "limit_margin_low", "limit_margin_high")}

#: What makes a folder with a file that no run has, and what reads it, by the file.
_OTHERS = {
    "estimates.parquet": "`chromagrip estimate`: open its figure.png and overlay.mp4",
    "tracks.parquet": "`chromagrip track`: `chromagrip score` reads it",
    "manifest.json": "`chromagrip dataset make`: `chromagrip dataset info` reads it",
    "files.json": "`chromagrip dataset make`, as a sequence: `chromagrip estimate` reads it",
    "poses.json": "`chromagrip render`: `chromagrip estimate` reads it",
    "leaderboard.html": "`chromagrip score`: open leaderboard.html",
    "limit.json": "`chromagrip limit`: open its limit.png",
    "index.html": "a study: open index.html",
}

_Number = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
_Value = _Number | None
_Text = str | None
_Count = Annotated[int, Meta(ge=0, le=10**9)]


class _Known(msgspec.Struct, kw_only=True):
    """Keys of a summary that its readers use; a summary may have more.

    Keys without a default are in every summary.
    """

    controller: str
    path: PathName
    mechanics: Mechanics
    complete: bool
    frames: _Count
    duration_s: _Number
    without_estimate: _Count
    without_estimate_because: dict[str, _Count]
    sensor: _Text = None
    second_sensor: _Text = None
    reconstructor: _Text = None
    outcome: _Text = None
    seed: int | None = None
    recorded_live_from_s: _Value = None
    frames_per_second: _Value = None
    final_mass_g: _Value = None
    final_margin_true: _Value
    final_limit_margin_true: _Value = None
    final_limit_margin_estimated: _Value = None
    smallest_margin_true: _Value = None
    smallest_limit_margin_true: _Value = None
    margin_rmse: _Value = None
    margin_error_expected: ExpectedError | None = None
    final_mu_true: _Value = None
    final_mu_estimated: _Value = None
    rigid_slip_mm: _Value = None
    max_grip_n: _Value = None
    final_grip_n: _Value = None
    grip_ceiling_n: _Value = None
    left_table: bool | None = None
    max_pressure_n_per_m: _Value = None


class _One(_Known, kw_only=True):
    """Keys of a run with one finger."""

    final_margin_estimated: _Value
    lateral_displacement_mm: _Value
    gross_slip: bool | None


class _Two(_Known, kw_only=True):
    """Keys of a run with two fingers."""

    outcome: Literal["held", "turned", "crushed", "dropped"]
    final_limit_margin_true: _Value
    lifted: bool
    slide_mm: _Number
    largest_turn_deg: _Number
    max_pressure_kpa: _Number


#: Summary of runs with one finger, or with two.
_SUMMARIES: dict[int, type[_Known]] = {1: _One, 2: _Two}


@dataclass(frozen=True, kw_only=True)
class RunRead:
    """Contents of a run folder.

    Attributes
    ----------
    folder: path of the folder
    scene: scene that was run
    summary: summary of the run
    columns: columns of its trace, shape (T,) each
    follow_links: whether its files may be links that lead out of it
    """

    folder: Path
    scene: Scene
    summary: Summary
    columns: dict[str, Array]
    follow_links: bool = False

    @property
    def video(self) -> Path | None:
        """Path of its video; None if there is no video."""
        path = self.file(VIDEO)
        return path if path.is_file() else None

    def file(self, name: str) -> Path:
        """Path of a file of the folder, which may be missing.

        Raises
        ------
        UserError
            For a link that leads out of the folder.
        """
        return inside(self.folder, name, self.follow_links)


def read_run(
    folder: Path,
    follow_links: bool = False,
    max_rows: int = MOST_ROWS,
    *,
    allow: Collection[str] = (),
) -> RunRead:
    """Read a run folder.

    Parameters
    ----------
    folder: folder of a finished run
    follow_links: whether its files may be links that lead out of it
    max_rows: largest number of rows of its trace
    allow: modules that its scene may name, see `load_scene`; not needed to show a run

    Raises
    ------
    UserError
        For a folder without a finished run, and for a file in it that is damaged, too large, or a
        link that leads out of it.
    """
    if not folder.is_dir():
        why = "it is a file" if folder.is_file() else "there is no such folder"
        raise UserError(f"{folder} is not a run folder: {why}")
    files = {name: inside(folder, name, follow_links) for name in (*NEEDED, VIDEO)}
    lacks = [name for name in NEEDED if not files[name].is_file()]
    if lacks:
        raise UserError(
            f"{folder} is not a finished run: it has no {lacks[0]}{_other_kind(folder)}"
        )
    check_size(files["scene.toml"], LARGEST_TEXT)
    scene = load_scene(str(files["scene.toml"]), allow=allow)
    summary = _read_summary(files["summary.json"], _SUMMARIES[scene.fingers])
    wanted = list(columns_of(scene.mechanics))
    later = _LATER[scene.fingers]
    columns = read_trace(files[TRACE], wanted, later, max_rows)
    rows = len(columns["time_s"])
    if rows != summary["frames"]:
        raise UserError(
            f"{files[TRACE]} has {rows} rows, and summary.json {summary['frames']} frames; {MEND}"
        )
    _check_video(files[VIDEO])
    return RunRead(
        folder=folder, scene=scene, summary=summary, columns=columns, follow_links=follow_links
    )


def _other_kind(folder: Path) -> str:
    """What made a folder that holds no run, and what reads it; "" where that is not known."""
    known = (text for name, text in _OTHERS.items() if (folder / name).is_file())
    text = next(known, "")
    if not text and any(folder.glob("*/summary.json")):
        return f"; it holds runs: give {folder}/*"
    return text and f"; it was made by {text}"


def _read_summary(path: Path, kind: type[_Known]) -> Summary:
    """Read a summary, and check the types of the keys of `kind`."""
    check_size(path, LARGEST_TEXT)
    try:
        summary = msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
        known = msgspec.convert(summary, kind)
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror}") from None
    except (msgspec.MsgspecError, RecursionError, ValueError) as error:
        raise UserError(f"{path.parent} cannot be read: {path.name}: {error}; {MEND}") from None
    if known.without_estimate and not known.without_estimate_because:
        raise UserError(
            f"{path}: without_estimate is {known.without_estimate}, and without_estimate_because "
            f"gives no reason; {MEND}"
        )
    return summary


def _check_video(path: Path) -> None:
    """Refuse a file or folder that has the name of the video but is not a video."""
    if path.is_dir():
        raise UserError(f"{path} is a folder, not a video; {MEND}")
    if path.is_file():
        check_size(path, LARGEST_FILE)
        open_source(str(path))


def check_size(path: Path, largest: int) -> None:
    """Refuse a file that is too large to be read whole."""
    size = path.stat().st_size
    if size > largest:
        raise UserError(f"{path} has {size} bytes, more than {largest}; move it out of the folder")
