"""Every example of a help page runs as it is printed, on inputs that the project makes itself."""

import json
import re
import shlex
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from contextlib import chdir
from itertools import chain, pairwise
from pathlib import Path

import cv2
import numpy as np
import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from chromagrip.cli.app import COMMANDS, STUDIES, commands_of, run
from chromagrip.output.video import VideoFile

from ..calibrate.test_calibrate import BOARD, FISHEYE, take

Typed = Callable[..., subprocess.CompletedProcess[str]]

pytestmark = pytest.mark.loops


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Folder with every input that an example names."""
    folder = tmp_path_factory.mktemp("inputs")
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with chdir(folder):
        make_datasets()
        make_presses()
        take(Path("photos"), BOARD, FISHEYE, 0.75, 11e-3, 0.45)
        for name, friction in (("before", 0.5), ("after", 0.3)):
            grasp = "grasp margin-60hz --path truth --set duration_s=0.1"
            made(f"{grasp} --set object.friction={friction} --out runs/{name}")
    yield folder
    for number, handler in before.items():
        signal.signal(number, handler)


def made(line: str) -> None:
    """Run a command that makes inputs."""
    assert run(shlex.split(line)) == 0, line


def make_datasets() -> None:
    """A dataset, another in two shards, and pictures, a video and tracks of one sequence."""
    made("dataset make tiny --out data --workers 1")
    for part in (1, 2):
        made(f"dataset make tiny --n 2 --shard {part}/2 --out shard-{part} --workers 1")
    sequence = Path("data/sequence-000000")
    shutil.copy(sequence / "rest.png", "rest.png")
    frames = sorted(sequence.glob("frame-*.png"))
    shutil.copy(frames[-1], "press.png")
    with VideoFile(Path("press.mp4"), rate=60, quality=4) as video:
        for frame in frames:
            picture = cv2.imread(str(frame))
            assert picture is not None
            video.append(np.ascontiguousarray(picture[..., ::-1]))
    made(f"track rest.png {sequence} --palette thesis --out tracked")
    pyarrow.csv.write_csv(pq.read_table("tracked/tracks.parquet"), "mine.csv")


def make_presses() -> None:
    """Presses of a hard plate on a dome with their list, and a calibration of another sensor."""
    Path("presses").mkdir()
    lines = ["file,normal_n,lateral_n"]
    for k, normal in enumerate((1.0, 3.0, 6.0, 10.0)):
        plate = "--object plane --set object.stiffness_kpa=20000"
        made(f"render --sensor dome-2020 {plate} --force 0 0 {normal} --out pressed --overwrite")
        (pose,) = json.loads(Path("pressed/poses.json").read_text(encoding="utf-8"))["poses"]
        shutil.move(f"pressed/{pose['image']}", f"presses/press-{k}.png")
        shutil.move("pressed/rest.png", f"presses/rest-{k}.png")
        lines.append(f"press-{k}.png,{pose['normal_n']},0")
    Path("presses/presses.csv").write_text("\n".join([*lines, ""]), encoding="utf-8")
    text = "format = 'chromagrip calibration 1'\nsensor = 'thesis'\nstiffness_deviation = 0.02\n"
    Path("mine.toml").write_text(text, encoding="utf-8")


def example_of(page: str) -> list[str]:
    """Words of the example in a page of help, without `chromagrip`."""
    (line,) = re.findall(r"^Example: chromagrip (.+)$", page, re.MULTILINE)
    return shlex.split(line)


def take_inputs(words: list[str], inputs: Path, folder: Path) -> None:
    """Copy the inputs that an example names; what follows `--out` is made by the example."""
    named = [word for flag, word in pairwise(["", *words]) if flag != "--out"]
    for name in dict.fromkeys(word.split("/")[0] for word in named):
        if (inputs / name).is_dir():
            shutil.copytree(inputs / name, folder / name)
        elif (inputs / name).exists():
            shutil.copy(inputs / name, folder / name)


@pytest.mark.parametrize("name", [*COMMANDS, *chain(*map(commands_of, STUDIES))])
def test_the_example_of_a_help_page_runs(
    name: str, inputs: Path, typed: Typed, tmp_path: Path
) -> None:
    words = example_of(typed(*name.split(), "--help").stdout)
    assert " ".join(words).startswith(name)
    take_inputs(words, inputs, tmp_path)
    done = typed(*words)
    assert done.returncode == 0, done.stderr
    assert done.stdout
