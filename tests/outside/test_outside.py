"""The loop on frames from outside: a source and a gripper of one's own, and what fails there."""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue
from subprocess import CompletedProcess
from types import ModuleType

import numpy as np
import pyarrow.parquet as pq
import pytest

from chromagrip import Rig, UserError, load_scene, run
from chromagrip.control import GripCommand, GripObservation
from chromagrip.loop import open_camera
from chromagrip.outside.grasp import run_outside
from chromagrip.sources.picture_files import read_picture

Typed = Callable[..., CompletedProcess[str]]
CHANGES = {"duration_s": 0.06, "camera.rest_frames": 2, "camera.latency_frames": 0}
CHANGES |= {"tracker": "quick"}
SCENE = load_scene("camera-100hz", CHANGES)


class Simulated:
    """A source and a gripper of one's own: its pictures are of a grasp that its forces grip."""

    live = False

    def __init__(self) -> None:
        self._rig = Rig(load_scene("camera-100hz", CHANGES | {"path": "truth"}))
        self._rig.reset()
        camera = open_camera(SCENE)
        self._rest = camera.expose_rest(self._rig.truth.state, SCENE.camera.rest_frames)
        self._forces, self._began = SimpleQueue[float](), False

    def command(self, force: float) -> None:
        self._forces.put(force)

    def read(self) -> tuple[np.ndarray, float] | None:
        """Picture under the last force, for which it waits: frames are read ahead."""
        if self._rest:
            frame = self._rest.pop(0)
            return frame.image, frame.time
        if self._rig.done:
            return None
        force = self._forces.get(timeout=60.0)
        if self._began:
            self._rig.step(force)
        assert self._began or force == 0.0  # before the first frame
        self._began = True
        return self._rig.picture().image, self._rig.time

    def close(self) -> None:
        self._rig.close()


def test_a_camera_and_a_gripper_of_ones_own_close_the_same_loop(tmp_path: Path) -> None:
    outside = Simulated()
    result, expected = run_outside(SCENE, outside, tmp_path, gripper=outside), run(SCENE).trace
    for name in ("time_s", "grip_n", "normal_estimated_n", "margin_low", "markers_visible"):
        np.testing.assert_array_equal(result.trace[name], expected[name])
    assert np.isnan(result.trace["margin_true"]).all()
    kept = pq.read_table(tmp_path / "trace.parquet").to_pydict()
    assert kept["grip_n"] == expected["grip_n"].tolist()
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert (summary["complete"], summary["frames"]) == (True, 7)
    assert summary["source"] == f"{__name__}:Simulated"
    assert summary["camera_pose"]["scale"] == pytest.approx(1.0, abs=1e-3)


class Kept:
    """A gripper that keeps its forces, and raises where it is asked to."""

    def __init__(self, raises_at: int = 1000) -> None:
        self.forces: list[float] = []
        self._raises_at = raises_at

    def command(self, force: float) -> None:
        if len(self.forces) == self._raises_at:
            raise OSError("no route to the gripper")
        self.forces.append(force)


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the pictures of a grasp, the one at rest first, twice."""
    folder = tmp_path_factory.mktemp("taken")
    run(SCENE, folder / "run", frames="png")
    kept, frames = folder / "run/frames", folder / "frames"
    frames.mkdir()
    files = [kept / "rest.png", kept / "rest.png", *sorted(kept.glob("frame-*.png"))]
    for number, file in enumerate(files):
        (frames / f"frame-{number:05d}.png").write_bytes(file.read_bytes())
    return frames


@pytest.mark.loops
def test_a_folder_is_a_source(frames: Path) -> None:
    gripper = Kept()
    result = run_outside(SCENE, str(frames), gripper=gripper, fps=100.0)
    assert result.summary["complete"]
    assert len(result.trace) == 7
    assert result.summary["delivery"]["dropped"] is None
    assert gripper.forces == [0.0, *result.trace["grip_n"]]
    assert result.trace["normal_estimated_n"][-1] > 0.05


class Played:
    """A source of one's own that plays a folder at 100 Hz; it fails as it is asked to."""

    live = False

    def __init__(self, folder: str, fails: bool = False, missing: tuple[int, ...] = ()) -> None:
        files = sorted(Path(folder).glob("*.png"))
        self._left = [(k, file) for k, file in enumerate(files) if k not in missing]
        self._fails, self.closed = fails, False

    def read(self) -> tuple[np.ndarray, float] | None:
        if not self._left:
            return None
        index, file = self._left.pop(0)
        if index == 8 and self._fails:
            raise OSError("unplugged")
        return read_picture(file), 0.01 * index

    def close(self) -> None:
        self.closed = True


def test_frames_that_a_source_repeats_or_drops_are_counted(frames: Path) -> None:
    source = Played(str(frames), missing=(6, 7))
    summary = run_outside(SCENE, source).summary
    assert summary["delivery"] == {"repeated": 1, "dropped": 2, "stalled": 0, "late": None}
    assert summary["frames"] == 5
    assert source.closed


def test_a_source_that_breaks_off_keeps_grip_and_trace(frames: Path, tmp_path: Path) -> None:
    gripper, words = Kept(), r"^source .*:Played failed after 8 frames: OSError: unplugged .*"
    with pytest.raises(UserError, match=rf"{words}; the grip stays at [\d.]+ N$"):
        run_outside(SCENE, Played(str(frames), fails=True), tmp_path, gripper=gripper)
    assert len(pq.read_table(tmp_path / "trace.parquet")) == 6  # without the two at rest
    assert gripper.forces[-1] == gripper.forces[-2]


class Stiff(Kept):
    """Takes forces but for one, which it never takes."""

    def command(self, force: float) -> None:
        if force > 0.0:
            time.sleep(20.0)


@pytest.mark.parametrize(
    ("gripper", "words", "rows"),
    [
        (Kept(raises_at=4), r"failed at t = 0\.03 s, frame 3: OSError: no route to the .*; the", 3),
        (Stiff(), r"did not answer within 0\.2 s at t = 0 s, frame 0; the", 0),
    ],
)
def test_a_gripper_that_fails_ends_the_loop(
    gripper: Kept, words: str, rows: int, frames: Path, tmp_path: Path
) -> None:
    words = rf"^gripper .*:{type(gripper).__name__} {words} grip stays at [\d.]+ N$"
    with pytest.raises(UserError, match=words):
        run_outside(SCENE, str(frames), tmp_path, gripper=gripper, fps=100.0, answer_within_s=0.2)
    assert (tmp_path / "trace.parquet").exists() == (rows > 0)
    if rows:
        assert len(pq.read_table(tmp_path / "trace.parquet")) == rows
        assert json.loads((tmp_path / "summary.json").read_text())["complete"] is False


class Fails:
    """A controller that fails at 0.05 s."""

    error: BaseException

    def reset(self) -> None: ...

    def command(self, observation: GripObservation) -> GripCommand:
        if observation.time > 0.045:
            raise self.error
        return GripCommand(force=1.0 + observation.time)


@pytest.mark.parametrize("error", [ZeroDivisionError(), KeyboardInterrupt()])
def test_the_last_safe_grip_is_commanded_again(
    error: BaseException, frames: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failing = ModuleType("failing")
    failing.__dict__["Fails"] = type("Fails", (Fails,), {"error": error})
    monkeypatch.setitem(sys.modules, "failing", failing)
    scene, gripper = load_scene("camera-100hz", CHANGES | {"controller": "failing:Fails"}), Kept()
    with pytest.raises((KeyboardInterrupt, UserError)):
        run_outside(scene, str(frames), gripper=gripper, fps=100.0)
    assert gripper.forces == pytest.approx([0.0, 1.0, 1.01, 1.02, 1.03, 1.04, 1.04])


def test_sources_that_do_not_fit_are_refused(frames: Path, tmp_path: Path) -> None:
    picture = np.zeros((4, 5, 3), np.uint8)
    for count in (1, 3):
        with (tmp_path / f"{count}").open("wb") as file:
            for array in [np.float64(0.0), picture] * count:
                np.save(file, array)
    one, small = (f"pipe:{tmp_path}/{count}" for count in (1, 3))
    truth = load_scene("camera-100hz", {"path": "truth"})
    for scene, source, words in (
        (SCENE, small, r"has frames of 5 × 4 pixels; sensor thesis has 640 × 480"),
        (SCENE, one, r"ended after 1 frames; the first 2 must show the unloa"),
        (truth, str(frames), 'set path = "camera"'),
    ):
        with pytest.raises(UserError, match=words):
            run_outside(scene, source)
