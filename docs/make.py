"""Remake what the documentation shows: `.venv/bin/python docs/make.py [PART...]` in a checkout.

Parts: images, loop, dataset, control, model, render, track, force, charts, limit,
stability, stability-track, stability-loop, appendix-b, reproduction; all of them without arguments,
some hours alone on two cores. Nothing in docs/images/, docs/bench-*.md and docs/reproduction.md is
typed by hand.
"""

import os
import shutil
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import av
import cv2

from chromagrip import run
from chromagrip.cli.limit import limit
from chromagrip.loop.pose_folder import render_poses
from chromagrip.loop.poses import Pose
from chromagrip.measure.bench import control as bench_control
from chromagrip.measure.bench import force as bench_force
from chromagrip.measure.bench.parts import bench
from chromagrip.measure.bench.track import asked, matrix, refusals
from chromagrip.measure.charts.page import charts
from chromagrip.measure.reproduce.appendix_b import appendix_b
from chromagrip.measure.reproduce.page import HEADING, cells
from chromagrip.measure.reproduce.parts import PARTS as THESIS
from chromagrip.measure.reproduce.parts import Plan, reproduce
from chromagrip.measure.stability.loop import stability_loop
from chromagrip.measure.stability.maps import maps
from chromagrip.measure.stability.model import stability_model
from chromagrip.measure.stability.track import stability_track
from chromagrip.measure.worlds.force_scores import READ
from chromagrip.measure.worlds.grasps import WORLDS
from chromagrip.measure.worlds.scorecard import NOTES
from chromagrip.measure.worlds.track_scenes import SCENES
from chromagrip.scene.scene import load_scene

DOCS = Path(__file__).parent
TITLES = {
    "loop": "The closed loop, measured",
    "control": "Controllers, measured",
    "model": "The node models, measured",
    "render": "The renderers, measured",
    "track": "The trackers, measured",
    "force": "Forces and friction, measured",
    "dataset": "Datasets, measured",
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
    write(part, report, figures(report["rows"]))


def write(part: str, report: dict[str, Any], lines: list[str]) -> None:
    """A page of what a bench measured, and on what."""
    machine = ", ".join(f"{key} {value}" for key, value in report["machine"].items())
    printed = f"Printed by `docs/make.py` from `chromagrip bench {part}` on: {machine}."
    text = "\n".join([f"# {TITLES[part]}", "", printed, "", *lines])
    (DOCS / f"bench-{part}.md").write_text(text + "\n", encoding="utf-8")


def figures(rows: list[dict[str, Any]]) -> list[str]:
    """Rows as a table."""
    lines = ["| figure | value | unit | target | met |", "|---|---|---|---|---|"]
    for row in rows:
        value = "–" if row["value"] is None else f"{row['value']:.4g}"
        met = "yes" if row["met"] else "no"
        lines.append(f"| {row['name']} | {value} | {row['unit']} | {row['target']} | {met} |")
    return lines


def track() -> None:
    """Trackers over scenes, what is asked of them, and every score in the plain scene."""
    report = bench("track", quick=False, progress=print)
    rows = report["rows"]
    heading, *body = matrix(rows)
    plain = [row for row in rows if row["name"].startswith("clean/")]
    trackers = list(dict.fromkeys(row["name"].split("/")[1] for row in plain))
    scores = {row["name"]: row for row in plain}
    names = list(dict.fromkeys(name.split("/")[2] for name in scores))
    names = [name for name in names if name != "refused"]
    each = [["score", *trackers]]
    for name in names:
        values = [scores.get(f"clean/{tracker}/{name}") for tracker in trackers]
        unit = next(row["unit"] for row in values if row)
        cells = ["–" if v is None or v["value"] is None else f"{v['value']:.3g}" for v in values]
        each.append([f"{name} [{unit}]" if unit else name, *cells])
    lines = [
        "RMS error of the worse layer over the Cramér–Rao bound of single frames; s: some identity",
        "swapped, l: some visible marker lost, f: some absent one reported.",
        "",
        *grid(["scene", *(line[0] for line in body)], list(zip(heading, *body, strict=True))[1:]),
        "",
        *(f"- `{name}`: {scene.text}" for name, scene in SCENES.items()),
        "",
        *(f"- {sentence}" for sentence in refusals(rows)),
        "",
        "What is asked of the default, of speed, and of the bound:",
        "",
        *figures(asked(rows)),
        "",
        "Every score in the scene `clean`; the others' are printed with `--json`:",
        "",
        *grid(each[0], each[1:]),
    ]
    write("track", report, lines)


def force() -> None:
    """Reconstructors in both worlds, what is asked of the best, every score of the libraries."""
    report = bench("force", quick=False, progress=print)
    rows = report["rows"]
    heading, *body = bench_force.matrix(rows)
    readings = bench_force.readings(rows)
    lines = [
        *bench_force.NOTES,
        "",
        *grid(heading, body),
        "",
        "µ read off single fields, matched / mismatched sensor:",
        "",
        *grid(readings[0], readings[1:]),
        "",
        "What is asked of the best, and speed:",
        "",
        *figures(bench_force.asked(rows)),
    ]
    found = {row["name"]: row for row in rows}
    for name, read in ((world, read) for world in WORLDS for read in READ):
        start = f"{name}/{read}/"
        mine = [key.removeprefix(start).split("/") for key in found if key.startswith(start)]
        who = list(dict.fromkeys(one for one, _ in mine if "+" not in one))
        each = []
        for score in dict.fromkeys(score for _, score in mine):
            cells = [found[f"{start}{one}/{score}"] for one in who]
            values = ["–" if c["value"] is None else f"{c['value']:.3g}" for c in cells]
            unit = cells[0]["unit"]
            each.append([f"{score} [{unit}]" if unit else score, *values])
        lines += ["", f"Every score, {name}, {read}:", "", *grid(["score", *who], each)]
    write("force", report, lines)
    draw_charts("force")


def draw_charts(*parts: str) -> None:
    """The chart of `chromagrip chart PART` of each part."""
    for part in parts:
        with tempfile.TemporaryDirectory() as folder:
            charts([part], False, Path(folder), True, print)
            shutil.copy(Path(folder) / f"{part}.png", DOCS / "images" / f"chart-{part}.png")


def control() -> None:
    """Every controller's scorecard, and what is asked of them."""
    report = bench("control", quick=False, progress=print)
    heading, *body = bench_control.matrix(report["rows"])
    asked_of_them = figures(bench_control.asked(report["rows"]))
    lines = [*NOTES, "", *grid(heading, body), "", "What is asked:", "", *asked_of_them]
    write("control", report, lines)


def grid(heading: Sequence[str], body: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table."""
    return ["| " + " | ".join(line) + " |" for line in (heading, ["---"] * len(heading), *body)]


def render() -> None:
    """The renderers' table and chart, a pose's preview, a real-looking frame beside an ideal."""
    table("render")
    draw_charts("render")
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


def stability_of_trackers() -> None:
    """The trackers' breakdown curves."""
    with tempfile.TemporaryDirectory() as folder:
        _, sentences = stability_track(False, Path(folder), True, print)
        shutil.copy(Path(folder) / "map.png", DOCS / "images" / "stability-track.png")
        shutil.copy(Path(folder) / "map.csv", DOCS / "stability-track.csv")
    print(*sentences, sep="\n")


def stability_of_the_loop() -> None:
    """Maps of the closed loop and its predicted boundaries."""
    with tempfile.TemporaryDirectory() as folder:
        _, sentences = stability_loop(False, Path(folder), True, print, os.cpu_count() or 1)
        for name in maps(False):
            shutil.copy(
                Path(folder) / f"{name}.png", DOCS / "images" / f"stability-loop-{name}.png"
            )
        shutil.copy(Path(folder) / "boundaries.csv", DOCS / "stability-loop.csv")
    print(*sentences, sep="\n")


def what_an_image_tells() -> None:
    """What one image can tell, for two designs."""
    with tempfile.TemporaryDirectory() as folder:
        limit(sensor=("thesis", "fovea"), out=Path(folder), force=True)
        shutil.copy(Path(folder) / "limit.png", DOCS / "images" / "limit.png")


def figures_of_appendix_b() -> None:
    """Two of the appendix's figures."""
    with tempfile.TemporaryDirectory() as folder:
        appendix_b(Path(folder), True, print)
        for name in ("fig22.png", "fig24.png"):
            shutil.copy(Path(folder) / name, DOCS / "images" / f"appendix-b-{name}")


#: How much of the thesis the documentation shows.
REPRODUCED = Plan(quick=False, camera="thesis")


def reproduction(plan: Plan = REPRODUCED) -> None:
    """The thesis's results beside ours; an interrupted run goes on in runs/reproduction."""
    folder = Path("runs") / "reproduction"
    command = "chromagrip reproduce" + (" --quick" if plan.quick else "")
    command += f" --camera {plan.camera}" if plan.camera else ""
    parts = [name for name in THESIS if name != "appendix-b"]
    report, sections = reproduce(parts, plan, folder, True, os.cpu_count() or 1, print)
    machine = ", ".join(f"{key} {value}" for key, value in report["machine"].items())
    lines = [
        "# The thesis, reproduced",
        "",
        f"Printed by `docs/make.py` from `{command}` on: {machine}.",
        "",
        "What the thesis prints is in `src/chromagrip/measure/reproduce/printed.toml`;",
        "it has no data of its",
        "figures: numbers and sentences are compared, and curves by their shape only.",
        "`chromagrip reproduce appendix-b` is about Figs. 20 to 27: see `node-models.md`.",
        "",
        *grid(["", "verdict", ""], [[s.heading, s.verdict, s.sentence] for s in sections]),
    ]
    for section in sections:
        name = f"{section.part}.png"
        shutil.copy(folder / name, DOCS / "images" / f"reproduced-{name}")
        lines += ["", f"## {section.heading}: {section.title}, {section.verdict}", ""]
        lines += [f"![{section.title}](images/reproduced-{name})", ""]
        lines += grid(HEADING, [cells(check) for check in section.checks])
        for heading, *body in section.tables:
            lines += ["", *grid(heading, body)]
        if section.rows:
            lines += ["", *figures([asdict(row) for row in section.rows])]
        lines += ["", *(f"- {note}" for note in section.notes)]
    (DOCS / "reproduction.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


PARTS = {
    "images": images,
    "loop": lambda: table("loop"),
    "dataset": lambda: table("dataset"),
    "control": control,
    "model": lambda: table("model"),
    "render": render,
    "track": track,
    "force": force,
    "charts": lambda: draw_charts("loop", "track", "model"),
    "limit": what_an_image_tells,
    "stability": stability,
    "stability-track": stability_of_trackers,
    "stability-loop": stability_of_the_loop,
    "appendix-b": figures_of_appendix_b,
    "reproduction": reproduction,
}

if __name__ == "__main__":
    (DOCS / "images").mkdir(exist_ok=True)
    for part in sys.argv[1:] or PARTS:
        PARTS[part]()
