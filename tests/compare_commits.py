"""Compare what this checkout computes with what another commit computes, byte by byte.

    .venv/bin/python tests/compare_commits.py REVISION [--keep FOLDER]

Runs in both: five scenes on the truth path, through the painter and through pyrender, the dataset
`tiny`, and the golden pictures. Prints a line for each file that differs, and for a table the
largest difference of each column. Exit code 1 when anything differs.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

ROOT = Path(__file__).resolve().parents[1]
SCENES = ("camera-100hz", "margin-60hz", "ramp-1", "patchy-1", "worn-1")
#: Entries of a summary that no two runs have in common.
TIMINGS = ("frames_per_second", "versions", "wall_time_s", "first_frame_s", "setup_s")


def commands() -> dict[str, list[str]]:
    """Command lines, by the folder that each one fills."""
    jobs = {}
    for scene in SCENES:
        base = ["grasp", "--scene", scene]
        jobs[f"{scene}-truth"] = [*base, "--path", "truth"]
        jobs[f"{scene}-painter"] = [*base, "--path", "camera"]
        jobs[f"{scene}-pyrender"] = [*base, "--path", "camera", "--renderer", "pyrender"]
    jobs["tiny"] = ["dataset", "make", "tiny"]
    return jobs


def compute(tree: Path, out: Path) -> None:
    """Run every command with the code of a checkout; what is there already is kept."""
    environment = {**os.environ, "PYTHONPATH": str(tree / "src")}
    out.mkdir(parents=True, exist_ok=True)
    for name, words in commands().items():
        if not (out / name).exists():
            command = [sys.executable, "-m", "chromagrip", *words, "--out", str(out / name)]
            subprocess.run(command, cwd=out, env=environment, check=True, stdout=subprocess.DEVNULL)
    golden = out / "golden"
    if not golden.exists():
        golden.mkdir()
        shutil.copy(tree / "fixtures" / "golden" / "make.py", golden)
        subprocess.run([sys.executable, "make.py"], cwd=golden, env=environment, check=True)


def differences(one: Path, other: Path) -> list[str]:
    """What differs between two folders of results, a line each."""
    lines = []
    names = {p.relative_to(f) for f in (one, other) for p in f.rglob("*") if p.is_file()}
    for name in sorted(names):
        pair = (one / name, other / name)
        if not all(file.is_file() for file in pair):
            lines.append(f"{name}: only in {'one' if pair[0].is_file() else 'the other'}")
        elif name.suffix == ".parquet" and "tiny" not in name.parts:
            lines += [f"{name}: {text}" for text in _columns(*pair)]
        elif name.name == "summary.json":
            lines += [f"{name}: {text}" for text in _entries(*pair)]
        elif name.suffix != ".py" and pair[0].read_bytes() != pair[1].read_bytes():
            lines.append(f"{name}: other bytes")
    return lines


def _columns(one: Path, other: Path) -> list[str]:
    tables = [pq.read_table(file) for file in (one, other)]
    if tables[0].column_names != tables[1].column_names:
        return ["other columns"]
    if tables[0].equals(tables[1]):
        return []
    lines = []
    for name in tables[0].column_names:
        left, right = (np.asarray(table[name].to_numpy()) for table in tables)
        if left.shape != right.shape:
            lines.append(f"{name}: {len(left)} and {len(right)} rows")
        elif left.dtype.kind == "f" and not np.array_equal(left, right, equal_nan=True):
            lines.append(f"{name}: up to {np.nanmax(np.abs(left - right)):.2g}")
        elif left.dtype.kind != "f" and list(left) != list(right):
            lines.append(f"{name}: differs")
    return lines


def _entries(one: Path, other: Path) -> list[str]:
    left, right = (json.loads(file.read_text(encoding="utf-8")) for file in (one, other))
    keys = [k for k in {**left, **right} if k not in TIMINGS]
    return [f"{k}: {left.get(k)} and {right.get(k)}" for k in keys if left.get(k) != right.get(k)]


def main() -> int:
    """Compare this checkout with a revision; print and count what differs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("revision", help="commit to compare with")
    parser.add_argument("--keep", type=Path, help="folder for the results, read again if present")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        tree = Path(temporary) / "tree"
        subprocess.run(["git", "clone", "-q", str(ROOT), str(tree)], check=True)
        subprocess.run(["git", "-C", str(tree), "checkout", "-q", arguments.revision], check=True)
        results = arguments.keep or Path(temporary) / "results"
        compute(tree, (results / arguments.revision).absolute())
        compute(ROOT, (results / "here").absolute())
        lines = differences(results / arguments.revision, results / "here")
    print(*lines or ["no difference"], sep="\n")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
