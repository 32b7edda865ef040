"""Figures of datasets: how fast they are made, what takes the time, and what a kill does."""

import dataclasses
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from msgspec.structs import replace

from benchmarks.parts import Part, parts_study
from benchmarks.timing import clock, run_child
from chromagrip.dataset.folder import file_digest, keep_recipe
from chromagrip.dataset.make import make
from chromagrip.dataset.recipe import Recipe, load_recipe
from chromagrip.dataset.sequence import sequence, shots, write_sequence
from chromagrip.measure.study import Asked, Study, study
from chromagrip.output.png import encode_png
from chromagrip.output.report import Row, at_least, at_most, reported, within
from chromagrip.render.drawing import gl_problem

#: Sequences of a measurement, for each process.
_SEQUENCES = 24
#: Sequences of a quick measurement.
_QUICK = 2
#: Sequences that a process makes before it is timed.
_WARM = 2
#: Pairs of runs with one and two processes.
_PAIRS = 5
#: Runs that are killed and resumed.
_KILLS = 50
#: Frames through the mesh renderer.
_MESHED = 4
#: Sequences of the short run, whose memory is compared with the long one's.
_SHORT = 10
#: Sequences of the long run.
_LONG = 60
#: Parts of making a sequence that are timed alone.
_PARTS = ("model", "picture and labels", "encoding")


@study("project", "dataset")
def dataset_study(asked: Asked) -> Study[Part, tuple[Row, ...]]:
    """Datasets `force` and `contact-3d`: 640×480 px, 400 markers in two layers, lossless, written.

    A quick run has two sequences and the speed alone.
    """
    count = _QUICK if asked.quick else _SEQUENCES
    force, contact = load_recipe("force"), load_recipe("contact-3d")
    parts: dict[str, Callable[[Path], Iterator[Row]]] = {
        "speed": lambda folder: _speed_rows(force, folder, count),
        "domes": lambda folder: _dome_rows(folder, count),
    }
    if not asked.quick:
        parts |= {
            "processes": lambda folder: _process_rows("dataset", force, folder),
            "processes, domes": lambda folder: _process_rows("contact-3d", contact, folder),
            "resuming": _resume_rows,
            "memory": _memory_rows,
        }
    return parts_study({name: partial(_in_folder, part) for name, part in parts.items()}, asked)


def _in_folder(part: Callable[[Path], Iterator[Row]], quick: bool) -> list[Row]:
    with tempfile.TemporaryDirectory() as folder:
        return list(part(Path(folder)))


def _speed_rows(recipe: Recipe, folder: Path, count: int) -> Iterator[Row]:
    out = folder / "speed"
    out.mkdir()
    keep_recipe(recipe, out)
    write_sequence(recipe, count, out)  # compiled, and the skin's light computed
    frames = 0
    spent = dict.fromkeys((*_PARTS, "whole"), 0.0)
    for index in range(count):
        with clock(spent, "model"):
            made = sequence(recipe, index)
        with clock(spent, "picture and labels"):
            images = [shot.image for shot in shots(recipe, made)[1]]
        with clock(spent, "encoding"):
            for image in images:
                encode_png(image)
        with clock(spent, "whole"):
            write_sequence(recipe, index, out)
        frames += len(images)
    yield at_least(("dataset", "speed"), frames / spent["whole"], "frames/s", 220.0)
    for part in _PARTS:
        yield reported(("dataset", "share", part), 100.0 * spent[part] / spent["whole"], "%")
    rest = 2.0 * spent["whole"] - sum(spent.values())
    share = 100.0 * rest / spent["whole"]
    yield reported(("dataset", "share", "tables, checksums, disk"), share, "%")
    if (problem := gl_problem()) is not None:
        yield at_least(("dataset", "over_pyrender_and_png"), None, "×", 6.0, problem)
        return
    mesh = replace(recipe, scene={**recipe.scene, "renderer": "pyrender"})
    made = sequence(mesh, 0)
    meshed = shots(mesh, dataclasses.replace(made, samples=made.samples[: _MESHED + 1]))[1]
    next(meshed)
    begin = time.perf_counter()
    for shot in meshed:
        cv2.imwrite(str(folder / "mesh.png"), shot.image[..., ::-1])
    ratio = (time.perf_counter() - begin) / _MESHED * frames / spent["whole"]
    yield at_least(("dataset", "over_pyrender_and_png"), ratio, "×", 6.0)


def _dome_rows(folder: Path, count: int) -> Iterator[Row]:
    """Speed of the recipe `contact-3d`, and the size of a frame of either."""
    recipe, out = load_recipe("contact-3d"), folder / "contact-3d"
    out.mkdir()
    keep_recipe(recipe, out)
    write_sequence(recipe, count, out)  # compiled, and the motion inside the silicone computed
    begin = time.perf_counter()
    for index in range(count):
        write_sequence(recipe, index, out)
    spent = time.perf_counter() - begin
    frames = len(list(out.glob("*/frame-*.png")))
    made = frames * count / (count + 1)
    yield at_least(("contact-3d", "speed"), made / spent, "frames/s", 60.0)
    for name, where in (("dataset", folder / "speed"), ("contact-3d", out)):
        size = sum(file.stat().st_size for file in where.rglob("*") if file.is_file())
        pictures = len(list(where.glob("*/frame-*.png")))
        yield reported((name, "frame"), size / pictures / 1e3, "kB")


def _process_rows(name: str, recipe: Recipe, folder: Path) -> Iterator[Row]:
    """Sequences a second of two processes over those of one, in pairs that take turns."""
    ratios = []
    for pair in range(_PAIRS):
        alone, together = (
            _seconds(replace(recipe, seed=pair), folder / f"{name}-{pair}-{workers}", workers)
            for workers in (1, 2)
        )
        ratios.append(2.0 * alone / together)
    yield at_least((name, "two_processes_over_one"), float(np.median(ratios)), "×", 1.9)


def _seconds(recipe: Recipe, folder: Path, workers: int) -> float:
    """Time in which so many processes make _SEQUENCES each, after the first _WARM of each [s]."""
    times: dict[int, float] = {}

    def tell(done: int, total: int) -> None:
        times[done] = time.perf_counter()

    count = workers * (_WARM + _SEQUENCES)
    make(replace(recipe, sequences=count), folder, workers=workers, progress=tell)
    return times[count] - times[workers * _WARM]


def _resume_rows(folder: Path) -> Iterator[Row]:
    """How often a tiny dataset has the same bytes after a kill at a random time and a resume."""
    begin = time.perf_counter()
    _tiny(folder / "tiny").wait()
    duration = time.perf_counter() - begin
    expected = _digests(folder / "tiny")
    rng, same, kills = random.Random(50), 0, 0
    while kills < _KILLS:
        out = folder / f"killed-{kills}"
        process = _tiny(out)
        time.sleep(rng.uniform(0.2, 1.0) * duration)
        if process.poll() is None:  # else it was too late
            process.kill()
            process.wait()
            _tiny(out).wait()
            kills, same = kills + 1, same + (_digests(out) == expected)
        shutil.rmtree(out)
    yield within(("dataset", "resume", "same_bytes"), same, f"of {kills}", kills, kills)


def _tiny(out: Path) -> subprocess.Popen[bytes]:
    words = ["dataset", "make", "tiny", "--workers", "1", "--resume", "--json", "--out", str(out)]
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "chromagrip", *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def _digests(folder: Path) -> dict[str, str]:
    files = (file for file in folder.rglob("*") if file.is_file())
    return {str(file.relative_to(folder)): file_digest(file) for file in files}


def _memory_rows(folder: Path) -> Iterator[Row]:
    """Largest memory of a worker, and how it grows with the number of sequences."""
    peaks = []
    for count in (_SHORT, _LONG):
        words = ["dataset", "make", "force", "--n", str(count), "--workers", "1", "--json"]
        peaks.append(run_child([*words, "--out", str(folder / f"memory-{count}")])[1])
    yield at_most(("dataset", "memory", "worker"), peaks[1], "MB", 500.0)
    growth = f"{_LONG}_over_{_SHORT}_sequences"
    yield at_most(("dataset", "memory", growth), peaks[1] / peaks[0], "×", 1.05)
