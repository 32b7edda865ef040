"""Every index of the compiled kernels is checked once, with markers cut at every edge."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

#: Cuts sensors so that windows reach over every edge, at each phase of the markers' distance, and
#: follows their markers across it; then runs each loop once. An index out of bounds raises.
CHECKED = """
import warnings
import cv2, numba, numpy as np
from chromagrip.errors import UserError
from chromagrip.loop.run import run
from chromagrip.render import Frame, load_sensor, open_renderer, rest_membrane
from chromagrip.scene.scene import load_scene
from chromagrip.tracking import Palette, learn_palette, load_tracker, sight, tracker_names
from dataclasses import replace

assert numba.config.BOUNDSCHECK == 1
warnings.simplefilter("error")
rng = np.random.default_rng(7)
followed = 0
for name in ("flat-2019", "dome-2020", "thesis"):
    sensor = load_sensor(name)
    whole = open_renderer("painter", sensor).render(rest_membrane(sensor))
    height, width = whole.shape[:2]
    for k in range(8):
        top, left = rng.integers(0, 60, 2) + np.array([height, width]) // 5
        part = whole[top : top + 3 * height // 5, left : left + 3 * width // 5]
        image = np.ascontiguousarray(part)
        moved = [
            np.ascontiguousarray(np.roll(image, step, (0, 1)))
            for step in ((0, 3), (3, 0), (-3, -3), (0, -40), (40, 0))
        ]
        for tracker in tracker_names():
            try:
                palette = replace(learn_palette(image, sight(image)), seen=sight(image))
                own = load_tracker(tracker)(palette, 1.0)
                own.reset([Frame(image=image, time=0.0)])
                for t, shown in enumerate(moved, 1):
                    followed += int(own.update(Frame(image=shown, time=0.1 * t)).visible.sum())
            except UserError:
                pass
assert followed > 1000, followed
for scene, changes in (
    ("margin-60hz", {}),
    ("thesis", {"controller": "react-to-slip"}),
    ("margin-60hz", {"path": "truth", "controller": "margin-inversion"}),
):
    done = run(load_scene(scene, {**changes, "duration_s": 0.1}))
    assert done.summary["complete"]
print("every index was in bounds")
"""


@pytest.mark.environments
def test_no_index_of_a_kernel_is_out_of_bounds(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-P", "-c", CHECKED], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert "every index was in bounds" in done.stdout
