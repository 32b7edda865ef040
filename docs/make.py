"""Remake what the documentation shows: `.venv/bin/python docs/make.py [PART...]` in a checkout.

Parts: images, loop, model, render, stability, appendix-b; all of them without arguments, forty
minutes alone on two cores. Nothing in docs/images/ and docs/bench-*.md is typed by hand.
"""

import shutil
import sys
import tempfile
from pathlib import Path

import av
import cv2

from chromagrip import run
from chromagrip.appendix_b import appendix_b
from chromagrip.bench import bench
from chromagrip.chart_render import chart_render
from chromagrip.poses import Pose
from chromagrip.render_poses import render_poses
from chromagrip.scene import load_scene
from chromagrip.stability_model import stability_model

DOCS = Path(__file__).parent
TITLES = {
    "loop": "The closed loop, measured",
    "model": "The node models, measured",
    "render": "The renderers, measured",
}


def images() -> None:
    """The default run's figure and one frame of its tactile video."""
    with tempfile.TemporaryDirectory() as folder:
        run("camera-100hz", folder)
        shutil.copy(Path(folder) / "figure.png", DOCS / "images" / "figure.png")
        with av.open(str(Path(folder) / "tactile.mp4")) as video:
            frames = list(video.decode(video=0))
        frames[150].to_image().save(DOCS / "images" / "tactile.png", optimize=True)


def table(part: str) -> None:
    """Every row of `chromagrip bench PART`."""
    report = bench(part, quick=False, progress=print)
    machine = ", ".join(f"{key} {value}" for key, value in report["machine"].items())
    lines = [
        f"# {TITLES[part]}",
        "",
        f"Printed by `docs/make.py` from `chromagrip bench {part}` on: {machine}.",
        "",
        "| figure | value | unit | target | met |",
        "|---|---|---|---|---|",
    ]
    for row in report["rows"]:
        value = "–" if row["value"] is None else f"{row['value']:.4g}"
        met = "yes" if row["met"] else "no"
        lines.append(f"| {row['name']} | {value} | {row['unit']} | {row['target']} | {met} |")
    (DOCS / f"bench-{part}.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def render() -> None:
    """The renderers' table and chart, a pose's preview, a real-looking frame beside an ideal."""
    table("render")
    with tempfile.TemporaryDirectory() as folder:
        chart_render(False, Path(folder), True, print)
        shutil.copy(Path(folder) / "chart.png", DOCS / "images" / "chart-render.png")
    with tempfile.TemporaryDirectory() as folder:
        render_poses(load_scene("camera-100hz"), [Pose(grip=2.0, load=0.6)], Path(folder), True)
        preview = cv2.imread(str(Path(folder) / "preview-000.png"))
        options = [cv2.IMWRITE_PNG_COMPRESSION, 9]
        cv2.imwrite(str(DOCS / "images" / "render-preview.png"), preview, options)
    pictures = []
    for defects in ({}, REAL):
        scene = load_scene("camera-100hz", {"sensor": "dome-2020", "seed": 3} | defects)
        with tempfile.TemporaryDirectory() as folder:
            render_poses(scene, [Pose(grip=15.0, load=4.0)], Path(folder), True)
            image = cv2.imread(str(Path(folder) / "image-000.png"))
        pictures.append(image[30:450, 110:530])
    cv2.imwrite(str(DOCS / "images" / "dome-2020.png"), cv2.hconcat(pictures))


#: Dials that make a frame look like one of the real dome.
REAL = {
    "defects.misalignment_mm": 0.7,
    "defects.misplacement_mm": 0.12,
    "defects.seam_tint": 0.7,
    "defects.dust": 25,
    "defects.specular": 4,
    "defects.uneven_leds": 0.15,
    "defects.vignette": 0.3,
    "defects.defocus_px": 0.6,
    "defects.shot_noise_electrons": 8000,
    "defects.read_noise_electrons": 12,
    "defects.bayer": True,
    "defects.jpeg_quality": 85,
}


def stability() -> None:
    """The full stability map, picture and table."""
    with tempfile.TemporaryDirectory() as folder:
        _, sentences = stability_model(False, Path(folder), True, print)
        shutil.copy(Path(folder) / "map.png", DOCS / "images" / "stability-model.png")
        shutil.copy(Path(folder) / "map.csv", DOCS / "stability-model.csv")
    print(*sentences, sep="\n")


def figures_of_appendix_b() -> None:
    """Two of the appendix's figures."""
    with tempfile.TemporaryDirectory() as folder:
        appendix_b(Path(folder), True, print)
        for name in ("fig22.png", "fig24.png"):
            shutil.copy(Path(folder) / name, DOCS / "images" / f"appendix-b-{name}")


PARTS = {
    "images": images,
    "loop": lambda: table("loop"),
    "model": lambda: table("model"),
    "render": render,
    "stability": stability,
    "appendix-b": figures_of_appendix_b,
}

if __name__ == "__main__":
    (DOCS / "images").mkdir(exist_ok=True)
    for part in sys.argv[1:] or PARTS:
        PARTS[part]()
