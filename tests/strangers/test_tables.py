"""Tables and archives of strangers: tracks to score, lists of presses and of frames."""

import csv
import zipfile
from collections.abc import Callable
from pathlib import Path
from random import Random

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from chromagrip.calibrate import presses
from chromagrip.measure.score.points import read_points
from chromagrip.sources.frame_list import read_list

from .damages import harmed
from .judged import Judge, Trap, few_and_many, repeated

FRAMES, MARKERS = 4, 6
PRESSES = "file,normal_n,lateral_n,torque_nmm,radius_mm\na.png,1.0,0.5,0,0\nb.png,3,0,,4.5\n"
READERS = {"presses.csv": presses.read_list, "frames.csv": read_list}


def tracks(folder: Path) -> None:
    """Good files of each kind: tracks of markers that move, and lists."""
    frame, marker = (v.ravel() for v in np.mgrid[:FRAMES, :MARKERS])
    x, y = 20.0 * marker + frame, 30.0 * (marker % 3) - 0.5 * frame
    columns = {
        "frame": frame, "marker": marker, "layer": ["magenta"] * len(x), "x_px": x, "y_px": y,
        "visible": [True] * len(x),
    }  # fmt: skip
    pq.write_table(pa.table(columns), folder / "tracks.parquet")
    with (folder / "tracks.csv").open("w", newline="") as file:
        csv.writer(file).writerows([columns, *zip(*columns.values(), strict=True)])
    places = np.stack([x, y], -1).reshape(FRAMES, MARKERS, 2).swapaxes(0, 1)
    np.savez(folder / "tracks.npz", tracks=places, visibles=np.ones((MARKERS, FRAMES), bool))
    (folder / "presses.csv").write_text(PRESSES)
    (folder / "frames.csv").write_text("frame,time_s,file\n0,0.5,a.png\n1,0.51,b.png\n")


def read(judged: Judge, name: str) -> None:
    path = Path("given") / name
    judged.call(lambda: READERS.get(name, read_points)(path), names=name)


@few_and_many(50, 2000)
def test_damaged_tables_are_read_or_refused_in_a_sentence(judged: Judge, count: int) -> None:
    def check(draw: Random) -> None:
        with judged.files() as folder:
            tracks(folder)
            name = draw.choice(sorted(path.name for path in folder.iterdir()))
            harmed(folder / name, draw)
            if name == "frames.csv" and not (folder / name).is_file():  # then there is no list
                return
            read(judged, name)
            if draw.random() < 0.1 and name.startswith("tracks"):
                judged.command("score", f"given/{name}", f"given/{name}", "--json", names=name)

    with judged.files() as folder:
        tracks(folder)
        for name in ("tracks.parquet", "tracks.csv", "tracks.npz", *READERS):
            read(judged, name)
    assert judged.refused == 0
    repeated(check, count)
    assert judged.refused > count // 3


def claiming(path: Path, shape: tuple[int, ...], held: int, kind: str = "<f8") -> None:
    """Archive with an array that claims a shape, and that holds so many bytes."""
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n"
    head = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        file.writestr("tracks.npy", head + bytes(held))
        file.writestr("visibles.npy", b"")


def zeros(path: Path) -> None:
    """A hundred million rows take some kilobytes."""
    rows = pa.array(np.zeros(3_000_000))
    pq.write_table(pa.table(dict.fromkeys(("frame", "marker", "x", "y"), rows)), path)


def text(content: str) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(content.encode())


ROW = "frame,marker,x,y\n0,0,1,1\n"
ATTACKS: dict[str, tuple[Callable[[Path], object], str]] = {
    "claims.npz": (lambda path: claiming(path, (1_000_000, 1_000_000, 2), 100), "16000000000000"),
    "minus.npz": (lambda path: claiming(path, (-5, 2, 2), 100), "claims"),
    "bomb.npz": (lambda path: claiming(path, (1_000, 2000, 2), 32_000_000), "too many to read"),
    "pickle.npz": (lambda path: claiming(path, (1,), 8, "|O"), "cannot be read"),
    "trap.npz": (lambda path: np.savez(path, tracks=[Trap()], visibles=[1]), "cannot be read"),
    "zeros.parquet": (zeros, "3000000 rows, more than 1000000; give --max-rows"),
    "frame.csv": (text(f"{ROW}99999999,0,1,1\n"), "give --max-rows"),
    "large.csv": (text(f"{ROW}1e300,0,1,1\n"), "row 2, column frame: '1e300' is no whole number"),
    "wide.csv": (lambda path: path.write_bytes(ROW.encode("utf-16")[:-1]), "cannot be read"),
    "long.csv": (text(f"{ROW}{'9' * 200_000},0,1,1\n"), "long.csv"),
    "semicolons.csv": (text(ROW.replace(",", ";")), "separated by semicolons"),
    "twice.csv": (text(f"{ROW}0,0,2,2\n"), "1 rows repeat another one, first of marker 0"),
}  # fmt: skip


@pytest.mark.parametrize("name", ATTACKS)
def test_each_kind_of_attack_is_a_sentence(judged: Judge, name: str) -> None:
    write, told = ATTACKS[name]
    with judged.files() as folder:
        write(folder / name)
        judged.call(lambda: read_points(Path("given") / name, most=1_000_000), names=told)
    assert judged.refused == 1
