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
from chromagrip.render import FisheyeCamera

Typed = Callable[..., subprocess.CompletedProcess[str]]

#: Commands whose example cannot run in a test, with the reason.
NOT_RUN: dict[str, str] = {}
#: The camera that takes the photographs of the board.
CAMERA = FisheyeCamera(
    width=640,
    height=480,
    focal=(152.8, 152.4),
    centre=(318.2, 243.7),
    distortion=(0.03, -0.01, 0.004, -0.001),
)
#: Side of a square of the board [m].
SQUARE = 3e-3

pytestmark = pytest.mark.loops


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Folder with every input that an example names."""
    folder = tmp_path_factory.mktemp("inputs")
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with chdir(folder):
        make_datasets()
        make_presses()
        make_photographs()
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


def make_photographs() -> None:
    """Photographs of the printed board, all around the middle of the picture."""
    made("calibrate camera --print-board board.png")
    board = cv2.imread("board.png", cv2.IMREAD_GRAYSCALE)
    assert board is not None
    fine = board.shape[1] / 9 / SQUARE  # [px/m]
    size = np.array(board.shape[::-1]) / fine
    x, y = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    rays = CAMERA.rays(np.column_stack([x.ravel(), y.ravel()])).reshape(*x.shape, 3)
    rng = np.random.default_rng(1)
    Path("photos").mkdir()
    for k in range(12):
        off, azimuth = (0.75, 0.45)[k % 2], k * np.pi / 6
        turn = off * np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        aside, tilted = (cv2.Rodrigues(v)[0] for v in (turn, rng.uniform(-0.4, 0.4, 3)))
        rotation = aside @ tilted
        corner = 11e-3 * aside[:, 2] - rotation[:, :2] @ size / 2
        # A ray s·d meets the plane of the board where n·(s·d − corner) = 0.
        normal = rotation[:, 2]
        facing = rays @ normal
        reach = np.where(facing > 1e-6, normal @ corner / np.maximum(facing, 1e-6), np.nan)
        places = (reach[..., None] * rays - corner) @ rotation[:, :2] * fine - 0.5
        places = np.nan_to_num(places, nan=-9.0).clip(-9.0, 1e4).astype(np.float32)
        # A pixel of the photograph covers many of the printed board.
        smooth = cv2.GaussianBlur(board, (0, 0), 12.0)
        photo = cv2.remap(smooth, places, None, cv2.INTER_LINEAR, borderValue=200)
        noisy = (photo + rng.normal(0.0, 2.0, photo.shape)).clip(0, 255).astype(np.uint8)
        assert cv2.imwrite(f"photos/{k:02}.png", noisy)


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
    if name in NOT_RUN:
        pytest.skip(NOT_RUN[name])
    words = example_of(typed(*name.split(), "--help").stdout)
    assert " ".join(words).startswith(name)
    take_inputs(words, inputs, tmp_path)
    done = typed(*words)
    assert done.returncode == 0, done.stderr
    assert done.stdout


def test_few_examples_are_left_out() -> None:
    assert len(NOT_RUN) <= 3
