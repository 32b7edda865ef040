"""Remake the tables and pictures of the documentation.

    PYTHONPATH=. .venv/bin/python docs/make.py [PART...]

Parts: images, gallery, tutorials, columns, studies, bodies, loop, speed, dataset, control, model,
render, track, force, force-dome, loop-dome, control-pinch, ranges, tolerances, charts, limit,
limit-dome, stability, stability-track, stability-force, stability-loop, stability-loop-dome,
stability-loop-pinch, appendix-b, reproduction.
Without arguments all of them are made, which takes some hours alone on two cores. Nothing in
docs/images/ is written by hand, nor what docs/appendix/ has after the first lines of its pages, nor
what other pages have between two marks of `fill`.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, get_args

import cv2
from website.gallery import GALLERY
from website.notebook import executed, with_outputs

from benchmarks.__main__ import load
from benchmarks.model.bodies import engine_rows
from benchmarks.model.side_by_side import COMPARED, FRICTION, GRIP, side_by_side, side_table
from benchmarks.model.side_by_side_figure import draw_side_by_side
from chromagrip.calibrate.first_use import EPOCHS, HISTORIES, NOISE
from chromagrip.calibrate.readout import VARIATIONS
from chromagrip.calibrate.training_ranges import range_lines, training_ranges
from chromagrip.loop.column import Mechanics
from chromagrip.loop.columns import columns_of
from chromagrip.measure.engine import measure
from chromagrip.measure.reproduce.parts import PARTS as THESIS
from chromagrip.measure.reproduce.parts import Plan, reproduce
from chromagrip.measure.reproduce.statements import Section
from chromagrip.measure.study import Asked, studies
from chromagrip.output.figure import png
from chromagrip.output.report import Table, machine, markdown, number, report_markdown

DOCS = Path(__file__).parent
IMAGES = DOCS / "images"
APPENDIX = DOCS / "appendix"
#: Width of a page [px].
PAGE = 1000
TITLES = {
    "loop": "The closed loop, measured",
    "control": "Controllers, measured",
    "model": "The node models, measured",
    "render": "The renderers, measured",
    "track": "The trackers, measured",
    "force": "Forces and friction, measured",
    "force-dome": "Forces from pictures of domes, measured",
    "loop-dome": "Built domes in the closed loop, measured",
    "control-pinch": "Controllers with two fingers, measured",
    "dataset": "Datasets, measured",
    "speed": "Speed, memory and start-up, measured",
}


@contextmanager
def made_by(*words: str) -> Iterator[Path]:
    """Folder that a command of ours writes with `--out`."""
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "made"
        command = [sys.executable, "-P", "-m", "chromagrip", *words, "--out", str(made)]
        subprocess.run(command, check=True)
        yield made


def keep(words: str, files: Mapping[str, Path]) -> None:
    """Copy files of a command's folder into the documentation."""
    with made_by(*words.split()) as folder:
        for name, target in files.items():
            shutil.copy(folder / name, target)


def write(page: str, title: str, command: str, lines: Iterable[str]) -> None:
    """Write a page of results with the command and the machine that they come from.

    What stands between the title and the line of the command is written by hand, and is kept.
    """
    path = APPENDIX / f"{page}.md"
    before = path.read_text(encoding="utf-8") if path.exists() else ""
    lead = before.partition("\n")[2].partition("Printed by `docs/make.py`")[0].strip()
    system = ", ".join(f"{key} {value}" for key, value in machine().items())
    printed = f"Printed by `docs/make.py` from `{command}` on: {system}."
    text = "\n".join([f"# {title}", "", *([lead, ""] if lead else []), printed, "", *lines])
    path.write_text(text.rstrip() + "\n", encoding="utf-8")


def fill(page: str, name: str, lines: Iterable[str]) -> None:
    """Write what a page has between `<!-- NAME -->` and `<!-- end of NAME -->`."""
    path, marks = DOCS / f"{page}.md", (f"<!-- {name} -->", f"<!-- end of {name} -->")
    before, rest = path.read_text(encoding="utf-8").split(marks[0])
    _, after = rest.split(marks[1])
    inner = "\n".join([marks[0], "", *lines, "", marks[1]])
    path.write_text(before + inner + after, encoding="utf-8")


def columns_table(body: Mechanics) -> list[str]:
    """Columns of a trace: of a dome what a chain lacks, of a pinch what its fingers lack."""
    lines = [
        (f"`{name}`", column.meaning, column.unit)
        for name, column in columns_of(body).items()
        if not (body == "dome" and "chain" in column.bodies)
        and not name.startswith(("first_", "second_"))
    ]
    return list(markdown(Table(("column", "content", "unit"), tuple(lines))))


def columns() -> None:
    """Columns of the traces of a chain, what a dome has more, and those of a pinch."""
    for body in get_args(Mechanics):
        fill("file-formats", f"columns of a {body}", columns_table(body))


def studies_table() -> Iterator[str]:
    """Studies of the command line and of the checkout, from their table."""
    load()
    starts = {"bench": "chromagrip bench", "chart": "chromagrip chart"}
    starts |= {"stability": "chromagrip stability", "project": "./run bench"}
    lines = [
        (
            ", ".join(
                f"`--world {world}`"
                if "" in one.worlds and world
                else f"`{start} {part}{f' --world {world}' if world else ''}`"
                for world in one.worlds
            ),
            one.text,
            f"`--{one.method}`" if one.method else "",
        )
        for verb, start in starts.items()
        for part, entries in studies(verb).items()
        for one in sorted(entries, key=lambda entry: "" not in entry.worlds)
    ]
    return markdown(Table(("command", "what", "methods of one's own"), tuple(lines)))


def list_of_studies() -> None:
    """What can be measured."""
    fill("measuring", "studies", studies_table())


def table(part: str) -> None:
    """The report of `chromagrip bench PART`."""
    report = measure("bench", part, progress=print)
    write(f"bench-{part}", TITLES[part], f"chromagrip bench {part}", report_markdown(report))


def table_of_the_project(part: str) -> None:
    """The report of `./run bench PART`."""
    load()
    report = measure("project", part, progress=print)
    write(f"bench-{part}", TITLES[part], f"./run bench {part}", report_markdown(report))


def keep_of_the_project(part: str, files: Mapping[str, Path]) -> None:
    """Copy files that `./run bench PART` writes into the documentation."""
    load()
    with tempfile.TemporaryDirectory() as folder:
        measure("project", part, out=Path(folder) / "made", progress=print)
        for name, target in files.items():
            shutil.copy(Path(folder) / "made" / name, target)


def draw_chart(part: str) -> None:
    """The chart of `chromagrip chart PART`."""
    keep(f"chart {part}", {f"{part}.png": IMAGES / f"chart-{part}.png"})


def draw_charts() -> None:
    """Charts of parts whose bench draws none."""
    for part in ("loop", "track"):
        draw_chart(part)
    keep_of_the_project("chart-dome", {"model-dome.png": IMAGES / "chart-model-dome.png"})


def images() -> None:
    """Figure and a frame of the default run, a frame of a pinch, the dome's traction."""
    example = [str(DOCS.parent / "examples/dome_contact.py"), "twist"]
    subprocess.run([sys.executable, "-P", *example, str(IMAGES / "dome-twist.png")], check=True)
    with made_by("grasp") as folder:
        shutil.copy(folder / "figure.png", IMAGES / "figure.png")
        video = cv2.VideoCapture(str(folder / "tactile.mp4"))
        video.set(cv2.CAP_PROP_POS_FRAMES, 150)
        cv2.imwrite(str(IMAGES / "tactile.png"), video.read()[1])
    with made_by("grasp", "--scene", "pinch-offcentre") as folder:
        cv2.imwrite(str(IMAGES / "pinch.png"), frame_at(folder / "tactile.mp4", 7.5))


def bodies() -> None:
    """Chain and dome side by side, and the chain by two engines."""
    sides = side_by_side(False)
    (IMAGES / "bodies.png").write_bytes(png(draw_side_by_side(sides)))
    load = COMPARED * FRICTION * GRIP
    grasp = f"Grip {GRIP:g} N, then a load of {load:g} N, µ {FRICTION:g}:"
    fill("node-models", "side by side", [grasp, "", *markdown(side_table(sides))])
    found: dict[str, dict[str, str]] = {}
    for row in engine_rows(False):
        found.setdefault(row.subject[-1], {})[row.score] = number(row.value, ".1e")
    scores = {
        "normal": "ΣFn",
        "friction": "ΣFf",
        "nodal": "force of a node, over the largest",
        "nodal_friction": "friction of the nodes",
    }
    lines = [
        (name.replace("_", " "), *(values[score] for score in scores))
        for name, values in found.items()
        if scores.keys() <= values.keys()
    ]
    fill("node-models", "engines", markdown(Table(("", *scores.values()), tuple(lines))))


def force() -> None:
    """The report of reconstructors."""
    table("force")


def tolerances() -> None:
    """What silicone that is not as told costs."""
    command = [sys.executable, "-P", str(DOCS.parent / "examples" / "dome_tolerances.py")]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    fill("forces", "tolerances", printed.splitlines())


def limits_of_domes() -> None:
    """Chart of designs of domes, and a table of all of them at three margins."""
    drawn = " ".join(f"--sensor {name}" for name in ("dome-2020", "dome-2022", "chromatouch-next"))
    keep(f"limit --body dome {drawn}", {"limit.png": IMAGES / "limit-dome.png"})
    found = []
    for force in ("1.35", "1.05", "0.6"):
        words = ["limit", "--body", "dome", "--load", force, "--json"]
        command = [sys.executable, "-P", "-m", "chromagrip", *words]
        printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        found.append(json.loads(printed)["sensors"])
    lines = []
    for name, entry in found[1].items():
        told = [each[name]["deviations"] for each in found]
        noises = ("bound", "bound plus misfit")
        margins = [
            " / ".join(number(one["contact"][noise]["margin"], ".2g") for one in told)
            for noise in noises
        ]
        forces = [
            " / ".join(_whole(1e3 * one[noise]["normal_n"]) for noise in noises)
            for one in told[1].values()
        ]
        read = ", ".join(f"`{one}`" for one in entry["read_by"])
        lines.append((f"`{name}`", str(entry["moving_layers"]), read, *margins, *forces))
    header = ("design", "moving layers", "read by", "Γ, bound", "Γ, plus misfit")
    zones = ("contact", "zone known", "open zone")
    header = (*header, *(f"F_n [mN], {zone}, bound / plus misfit" for zone in zones))
    fill("what-the-image-tells", "dome limits", markdown(Table(header, tuple(lines))))


def _whole(value: float) -> str:
    """Two digits, or all of a large number."""
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}"


def of_world(part: str, world: str) -> None:
    """The report of `chromagrip bench PART --world WORLD`."""
    report = measure("bench", part, Asked(world=world), progress=print)
    name, command = f"{part}-{world}", f"chromagrip bench {part} --world {world}"
    write(f"bench-{name}", TITLES[name], command, report_markdown(report))


def ranges() -> None:
    """The ranges of a training."""
    lines = range_lines(training_ranges(VARIATIONS, NOISE, HISTORIES, EPOCHS))
    told = Table(("range", "unit", "from", "to", ""), tuple(lines))
    write(
        "training-ranges",
        "What a read-out is trained on",
        "chromagrip calibrate readout",
        markdown(told),
    )


def render() -> None:
    """The renderers' report and chart, a pose's preview, and domes as printed and as built."""
    table_of_the_project("render")
    keep_of_the_project("chart-render", {"render.png": IMAGES / "chart-render.png"})
    keep("render --grip 2 --load 0.6", {"previews/preview-000.png": IMAGES / "render-preview.png"})
    keep_domes()


def keep_domes() -> None:
    """The dome of 2020 as printed, and two specimens of it as built."""
    pictures = []
    for sensor, seed, grip in (
        ("dome-2020-printed", 3, 15),
        ("dome-2020", 3, 0),
        ("dome-2020", 4, 15),
    ):
        pose = ["render", "--sensor", sensor, f"--seed={seed}", f"--grip={grip}", "--load=0"]
        with made_by(*pose) as folder:
            picture: Any = cv2.imread(str(folder / "image-000.png"))
        if sensor == "dome-2020-printed":
            picture = picture[36:444, 116:524]
        pictures.append(cv2.resize(picture, (420, 420), interpolation=cv2.INTER_AREA))
    cv2.imwrite(str(IMAGES / "dome-2020.png"), cv2.hconcat(pictures))


def stability_of_the_model() -> None:
    """Maps of the chain's integrators and of the dome's steps."""
    for part, name in (("model", "map"), ("dome", "dome")):
        files = {
            f"{name}.png": IMAGES / f"stability-{part}.png",
            f"{name}.csv": APPENDIX / f"stability-{part}.csv",
        }
        keep_of_the_project(f"stability-{part}", files)


def stability_of_the_loop() -> None:
    """Maps of the closed loop and its predicted boundaries."""
    with made_by("stability", "loop") as folder:
        for picture in folder.glob("*.png"):
            shutil.copy(picture, IMAGES / f"stability-loop-{picture.name}")
        shutil.copy(folder / "boundaries.csv", APPENDIX / "stability-loop.csv")


def stability_of_grips(world: str) -> None:
    """Maps of a dome or of two fingers: a picture and a table of each."""
    with made_by("stability", "loop", "--world", world) as folder:
        for picture in folder.glob("*.png"):
            shutil.copy(picture, IMAGES / f"stability-loop-{world}-{picture.name}")
        for table_of in folder.glob("*.csv"):
            shutil.copy(table_of, APPENDIX / f"stability-loop-{world}-{table_of.name}")


#: Amount of the thesis that the documentation shows.
REPRODUCED = Plan(quick=False, camera="thesis")


def reproduction(plan: Plan = REPRODUCED) -> None:
    """The thesis's results beside ours; an interrupted run continues in runs/reproduction."""
    folder = Path("runs") / "reproduction"
    command = "chromagrip reproduce" + (" --quick" if plan.quick else "")
    command += f" --camera {plan.camera}" if plan.camera else ""
    parts = [name for name in THESIS if name != "appendix-b"]
    _, sections = reproduce(parts, plan, folder, True, os.cpu_count() or 1, print)
    verdicts = tuple((s.heading, s.verdict, s.sentence) for s in sections)
    lines = [
        "The values that the thesis prints are in `src/chromagrip/measure/reproduce/printed.toml`.",
        "It has no data of its figures: numbers and sentences are compared, and curves by their",
        "shape only. `chromagrip reproduce appendix-b` is about Figs. 20 to 27: see",
        "`../node-models.md`.",
        "",
        *markdown(Table(("", "verdict", ""), verdicts)),
    ]
    for section in sections:
        name = f"{section.part}.png"
        shutil.copy(folder / name, IMAGES / f"reproduced-{name}")
        lines += ["", f"## {section.heading}: {section.title}, {section.verdict}", ""]
        lines += [f"![{section.title}](../images/reproduced-{name})"]
        for each in section.tables:
            lines += ["", *markdown(each)]
        lines += ["", *(f"- {note}" for note in section.notes)]
    write("reproduction", "The thesis, reproduced", command, lines)
    surfaces_of_table_2(sections)


def surfaces_of_table_2(sections: Iterable[Section]) -> None:
    """Table 2 as printed, and here with surfaces that stay and that travel."""
    found = next(section for section in sections if section.part == "table-2").extra_tables[0]
    fill("node-models", "table 2", markdown(Table(found.header, found.lines[:3])))


def tutorials() -> None:
    """What the commands of the tutorials print."""
    for page in sorted((DOCS / "tutorials").glob("*.md")):
        with tempfile.TemporaryDirectory() as folder:
            book = executed(page, Path(folder))
        page.write_text(with_outputs(page.read_text(encoding="utf-8"), book), encoding="utf-8")


def gallery() -> None:
    """Pictures of the gallery, and its page with the command of each."""
    (IMAGES / "gallery").mkdir(exist_ok=True)
    lines = [
        "# Gallery",
        "",
        "The command below a picture makes it, as the file that is named.",
        "Choose `render` for one picture of a pose, `grasp` for a video and curves over time, and",
        "`dataset make` for labelled sequences. The 12 pictures have three sensors, four contacts,",
        "three grasps and a dataset, at most 1000 px wide; a video is shown by one frame.",
        "All are simulated; [the renderers](bench-render.md) has the errors against a real sensor.",
        "",
    ]
    for section, entries in GALLERY.items():
        lines += [f"## {section}", ""]
        for entry in entries:
            with made_by(*entry.command.split()) as folder:
                picture = picture_of(folder / entry.file, entry.at_s)
            cv2.imwrite(str(IMAGES / "gallery" / f"{entry.name}.jpg"), picture)
            lines += [
                f"![{entry.caption}](../images/gallery/{entry.name}.jpg)",
                "",
                entry.caption,
                "",
            ]
            lines += ["```", f"chromagrip {entry.command}   # {entry.file}", "```", ""]
    (APPENDIX / "gallery.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


def frame_at(file: Path, at_s: float) -> Any:
    """Frame of a video at an instant [s]."""
    video = cv2.VideoCapture(str(file))
    video.set(cv2.CAP_PROP_POS_MSEC, 1e3 * at_s)
    return video.read()[1]


def picture_of(file: Path, at_s: float) -> Any:
    """A picture, or a frame of a video at an instant [s], at most as wide as a page."""
    picture = frame_at(file, at_s) if file.suffix == ".mp4" else cv2.imread(str(file))
    share = min(1.0, PAGE / picture.shape[1])
    return cv2.resize(picture, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)


PARTS: dict[str, Callable[[], None]] = {
    "images": images,
    "gallery": gallery,
    "tutorials": tutorials,
    "columns": columns,
    "bodies": bodies,
    "loop": partial(table, "loop"),
    "studies": list_of_studies,
    "dataset": partial(table_of_the_project, "dataset"),
    "speed": partial(table_of_the_project, "speed"),
    "control": partial(table, "control"),
    "model": partial(table_of_the_project, "model"),
    "render": render,
    "track": partial(table, "track"),
    "force": force,
    "force-dome": partial(of_world, "force", "dome"),
    "loop-dome": partial(of_world, "loop", "dome"),
    "control-pinch": partial(of_world, "control", "pinch"),
    "ranges": ranges,
    "tolerances": tolerances,
    "charts": draw_charts,
    "limit": partial(
        keep, "limit --sensor thesis --sensor fovea", {"limit.png": IMAGES / "limit.png"}
    ),
    "limit-dome": limits_of_domes,
    "stability": stability_of_the_model,
    "stability-track": partial(
        keep,
        "stability track",
        {"map.png": IMAGES / "stability-track.png", "map.csv": APPENDIX / "stability-track.csv"},
    ),
    "stability-force": partial(
        keep,
        "stability force",
        {"map.png": IMAGES / "stability-force.png", "map.csv": APPENDIX / "stability-force.csv"},
    ),
    "stability-loop": stability_of_the_loop,
    "stability-loop-dome": partial(stability_of_grips, "dome"),
    "stability-loop-pinch": partial(stability_of_grips, "pinch"),
    "appendix-b": partial(
        keep,
        "reproduce appendix-b",
        {f"figure-{n}.png": IMAGES / f"appendix-b-fig{n}.png" for n in (22, 24)},
    ),
    "reproduction": reproduction,
}

if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    for part in sys.argv[1:] or PARTS:
        PARTS[part]()
