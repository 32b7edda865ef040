"""Long work takes no more memory than short work."""

import math
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import psutil
import pytest
from msgspec.structs import replace

from chromagrip.dataset import load_recipe
from chromagrip.dataset.sequence import write_sequence
from chromagrip.loop.grasp import gripped
from chromagrip.loop.rig import Rig
from chromagrip.output.processes import one_thread
from chromagrip.scene import load_scene

pytestmark = [pytest.mark.loops, pytest.mark.skipif(psutil.WINDOWS, reason="counts pages of Linux")]

#: Frame from which on nothing may grow, and the largest growth [MB].
WARM, MOST = 500, 5.0


def growth(steps: Iterator[Any], warm: int) -> float:
    """Growth of this process after some steps [MB]: between the medians of both halves' ends."""
    process = psutil.Process()
    sizes = [process.memory_info().rss / 1e6 for _ in steps][warm:]
    tenth = max(len(sizes) // 10, 1)
    return max(sizes[-tenth:]) - max(sizes[:tenth])


@pytest.mark.parametrize(
    ("name", "frames", "changes"),
    [
        ("margin-60hz", 1500, {"path": "camera"}),
        ("pinch-lift", 700, {"path": "camera"}),
    ],
)
def test_a_long_grasp_takes_no_more_memory(
    name: str, frames: int, changes: dict[str, object]
) -> None:
    rate = load_scene(name).camera.rate_hz
    scene = load_scene(name, {**changes, "duration_s": frames / rate})
    with closing(Rig(scene)) as rig, one_thread():
        assert growth(gripped(rig, math.inf), WARM if frames > 1000 else WARM // 2) < MOST


def test_a_large_dataset_takes_no_more_memory(tmp_path: Path) -> None:
    recipe = replace(load_recipe("tiny"), sequences=1000)
    make: Callable[[int], int] = lambda number: write_sequence(recipe, number, tmp_path)  # noqa: E731
    frames = len(list((tmp_path / f"sequence-{make(0):06d}").glob("frame-*.png")))
    count = math.ceil(1200 / frames)
    assert growth(map(make, range(1, count)), math.ceil(WARM / frames)) < MOST
