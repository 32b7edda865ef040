"""Remake what the documentation shows: run from the checkout, `.venv/bin/python docs/make.py`.

Writes docs/images/ and docs/bench-loop.md; nothing in them is typed by hand. Takes three minutes.
"""

import shutil
import tempfile
from pathlib import Path

import av

from chromagrip import run
from chromagrip.bench import bench

DOCS = Path(__file__).parent


def images() -> None:
    """The default run's figure and one frame of its tactile video."""
    with tempfile.TemporaryDirectory() as folder:
        run("camera-100hz", folder)
        shutil.copy(Path(folder) / "figure.png", DOCS / "images" / "figure.png")
        with av.open(str(Path(folder) / "tactile.mp4")) as video:
            frames = list(video.decode(video=0))
        frames[150].to_image().save(DOCS / "images" / "tactile.png", optimize=True)


def table() -> None:
    """Every row of `chromagrip bench loop`."""
    report = bench("loop", quick=False, progress=print)
    machine = ", ".join(f"{key} {value}" for key, value in report["machine"].items())
    lines = [
        "# The closed loop, measured",
        "",
        f"Printed by `docs/make.py` from `chromagrip bench loop` on: {machine}.",
        "",
        "| figure | value | unit | target | met |",
        "|---|---|---|---|---|",
    ]
    for row in report["rows"]:
        value = "–" if row["value"] is None else f"{row['value']:.4g}"
        met = "yes" if row["met"] else "no"
        lines.append(f"| {row['name']} | {value} | {row['unit']} | {row['target']} | {met} |")
    (DOCS / "bench-loop.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    (DOCS / "images").mkdir(exist_ok=True)
    images()
    table()
