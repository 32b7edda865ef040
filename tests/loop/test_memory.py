"""Long work takes no more memory than short work."""

import math
from collections.abc import Iterator
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

#: Largest growth [MB], and the first part that may grow [1].
MOST, WARM = 5.0, 0.4


def growth(steps: Iterator[Any]) -> float:
    """Growth of this process [MB] between the first and the last steps after a warm-up."""
    process = psutil.Process()
    sizes = [process.memory_info().rss / 1e6 for _ in steps]
    sizes = sizes[round(WARM * len(sizes)) :]
    tenth = max(len(sizes) // 10, 1)
    return max(sizes[-tenth:]) - max(sizes[:tenth])


@pytest.mark.parametrize(("name", "frames"), [("margin-60hz", 500), ("pinch-lift", 120)])
def test_a_long_grasp_takes_no_more_memory(name: str, frames: int) -> None:
    duration = frames / load_scene(name).camera.rate_hz
    scene = load_scene(name, {"path": "camera", "duration_s": duration})
    with closing(Rig(scene)) as rig, one_thread():
        assert growth(gripped(rig, math.inf)) < MOST


def test_a_large_dataset_takes_no_more_memory(tmp_path: Path) -> None:
    recipe = replace(load_recipe("tiny"), sequences=1000)
    assert growth(write_sequence(recipe, number, tmp_path) for number in range(60)) < MOST
