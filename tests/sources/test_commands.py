"""`track` on sources that fail or deliver badly: what was read is kept, and it is said."""

import functools
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any, ClassVar

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.spatial import KDTree

Typed = Callable[..., CompletedProcess[str]]
RNG = np.random.default_rng(5)
#: Dark dots, not in a row so that no two are alike [px].
DOTS = np.stack(np.meshgrid(np.arange(20, 150, 30), np.arange(20, 110, 30)), -1).reshape(-1, 2)
DOTS = DOTS + RNG.uniform(-3.0, 3.0, DOTS.shape)


@functools.cache
def dots(index: int, height: int = 120) -> np.ndarray:
    """Dots that are moved by 0.3 px a frame, with noise 1; RGB."""
    y, x = np.mgrid[:height, :160]
    far = KDTree(DOTS + np.array([0.3 * index, 0.0])).query(np.stack([x, y], axis=-1))[0]
    covered = 1.0 / (1.0 + np.exp((far - 6.0) / 0.5))
    grey = np.random.default_rng(index).normal(200.0 * (1.0 - 0.7 * covered), 1.0)
    return np.repeat(np.rint(grey).astype(np.uint8)[..., None], 3, axis=2)


class Camera:
    """A camera that vanishes after 9 frames, or becomes another size."""

    vanishes: ClassVar[bool] = True

    def __init__(self, number: int) -> None:
        self.count = -1

    def isOpened(self) -> bool:  # noqa: N802
        return True

    def get(self, key: int) -> float:
        return 0.0

    def read(self) -> tuple[bool, Any]:
        self.count += 1
        if self.count == 9 and self.vanishes:
            return False, None
        return True, dots(self.count, 120 if self.count < 9 else 110)[..., ::-1]

    def release(self) -> None:
        pass


class Replayed:
    """Frames at 50 Hz by their own times: two are missing, one comes twice, one stalls for 1 s."""

    live = False

    def __init__(self) -> None:
        shown = [*range(8), *range(10, 14), 13, *range(15, 20)]
        self.frames = [(dots(k), 0.02 * n + (n > 17)) for n, k in
                       zip([*range(8), *range(10, 20)], shown, strict=True)]  # fmt: skip

    def read(self) -> tuple[np.ndarray, float] | None:
        return self.frames.pop(0) if self.frames else None


WORDS = ("--palette", "dark-dots", "--tracker", "detect")


@pytest.mark.parametrize(
    ("vanishes", "told"),
    [
        (True, "camera 0 gave no picture after 9 frames"),
        pytest.param(False, "frame 9 of camera:0 is 160×110 pixels, the rest frame 160×120",
                     marks=pytest.mark.data),
    ],
)  # fmt: skip
def test_a_camera_that_breaks_off_keeps_what_it_gave(
    vanishes: bool, told: str, typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cv2, "VideoCapture", Camera)
    monkeypatch.setattr(Camera, "vanishes", vanishes)
    done = typed("track", "first:2", "camera:0", *WORDS)
    assert done.returncode == 2
    assert done.stderr.strip() == f"chromagrip: {told}; the results of the 9 frames before are kept"
    folder = tmp_path / "runs/track-camera-0-001"
    summary = json.loads((folder / "summary.json").read_text())
    assert (summary["frames"], summary["complete"]) == (9, False)
    assert pq.read_table(folder / "tracks.parquet")["frame"].to_numpy().max() == 8


@pytest.mark.data
def test_badly_delivered_frames_are_counted_and_said(
    typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mine", sys.modules[__name__])
    done = typed("track", "first:2", "mine:Replayed", *WORDS, "--out", "out")
    assert done.returncode == 0, done.stderr
    said = r"frames +18, end of the source *\n +1 repeated, 2 dropped, 1 stalled *\n"
    assert re.search(said, done.stdout)
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    assert summary["source"] == "mine:Replayed"
    assert summary["delivery"] == {"repeated": 1, "dropped": 2, "stalled": 1, "late": None}
    times = pq.read_table(tmp_path / "out/tracks.parquet")["time_s"].to_numpy()
    assert np.unique(times)[[0, 7, 8, -1]] == pytest.approx([0.0, 0.14, 0.20, 1.38])


def test_a_rest_picture_is_no_frame_of_a_pattern(tmp_path: Path, typed: Typed) -> None:
    (tmp_path / "shots").mkdir()
    for name in ("rest-a", "1", "2"):
        cv2.imwrite(str(tmp_path / f"shots/{name}.png"), dots(len(name)))
    summary = json.loads(typed("track", "shots/rest-a.png", "shots/*.png", *WORDS, "--json").stdout)
    assert summary["frames"] == 2
    assert summary["rest"] == "shots/rest-a.png, not counted as a frame of the source"
