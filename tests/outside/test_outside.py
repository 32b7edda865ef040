"""The loop on frames from outside: a camera in another process, and what fails there."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import numpy as np
import pyarrow.parquet as pq
import pytest

from chromagrip import UserError, load_scene, run
from chromagrip.control import GripCommand, GripObservation
from chromagrip.outside.grasp import run_outside
from chromagrip.sources.picture_files import read_picture

Typed = Callable[..., CompletedProcess[str]]
CHANGES = {"duration_s": 0.12, "camera.rest_frames": 2, "camera.latency_frames": 0}
SCENE = load_scene("camera-100hz", CHANGES)

#: A camera in another process: it writes a frame, and reads the force under which the next is.
CAMERA = """
import sys
import chromagrip
from chromagrip.loop import open_camera
from chromagrip.sources.pipe import pipe_bytes

scene = chromagrip.load_scene("camera-100hz", {"path": "truth", **eval(sys.argv[3])})
with chromagrip.open(scene) as rig, open(sys.argv[1], "wb") as pictures:
    def send(frame):
        pictures.write(pipe_bytes(frame))
        pictures.flush()

    rig.reset()
    for frame in open_camera(scene).expose_rest(rig.truth.state, scene.camera.rest_frames):
        send(frame)
    with open(sys.argv[2]) as forces:
        assert float(forces.readline()) == 0.0  # before the first frame
        while True:
            send(rig.picture())
            if rig.done:
                break
            rig.step(float(forces.readline()))
        forces.readline()
"""


class Line:
    """A gripper at the end of a pipe, which waits for no other end."""

    def __init__(self, path: str) -> None:
        self._pipe = os.open(path, os.O_RDWR)

    def command(self, force: float) -> None:
        os.write(self._pipe, f"{force!r}\n".encode())


@pytest.mark.skipif(sys.platform == "win32", reason="no named pipes")
def test_a_camera_in_another_process_closes_the_same_loop(tmp_path: Path) -> None:
    pictures, forces = tmp_path / "pictures", tmp_path / "forces"
    os.mkfifo(pictures)
    os.mkfifo(forces)
    words = [sys.executable, "-c", CAMERA, str(pictures), str(forces), repr(CHANGES)]
    with subprocess.Popen(words) as camera:
        try:
            result = run_outside(
                SCENE,
                f"pipe:{pictures}",
                tmp_path / "run",
                gripper=Line(str(forces)),
                frame_within_s=60.0,
            )
            assert camera.wait(60.0) == 0
        finally:
            camera.kill()
    expected = run(SCENE).trace
    for name in ("time_s", "grip_n", "normal_estimated_n", "margin_low", "markers_visible"):
        np.testing.assert_array_equal(result.trace[name], expected[name])
    assert np.isnan(result.trace["margin_true"]).all()
    kept = pq.read_table(tmp_path / "run/trace.parquet").to_pydict()
    assert kept["grip_n"] == expected["grip_n"].tolist()
    summary = json.loads((tmp_path / "run/summary.json").read_text())
    assert (summary["complete"], summary["frames"]) == (True, 13)
    assert summary["source"] == f"pipe:{pictures}"
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
def taken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the pictures of a grasp, the one at rest first, twice."""
    folder = tmp_path_factory.mktemp("taken")
    run(SCENE, folder / "run", frames="png")
    frames = folder / "run/frames"
    (frames / "frames.csv").unlink()  # it does not list those at rest
    pictures = sorted(frames.glob("frame-*.png"))
    for number, picture in reversed([*enumerate(pictures, 2)]):
        picture.rename(frames / f"frame-{number:05d}.png")
    (frames / "rest.png").rename(frames / "frame-00000.png")
    (frames / "frame-00001.png").write_bytes((frames / "frame-00000.png").read_bytes())
    return frames


def test_a_folder_is_a_source(taken: Path) -> None:
    gripper = Kept()
    result = run_outside(SCENE, str(taken), gripper=gripper, fps=100.0)
    assert result.summary["complete"]
    assert len(result.trace) == 13
    assert gripper.forces == [0.0, *result.trace["grip_n"]]
    assert result.trace["normal_estimated_n"][-1] > 0.05
    again = run_outside(SCENE, str(taken), fps=100.0)
    np.testing.assert_array_equal(again.trace["grip_n"], result.trace["grip_n"])


class Played:
    """A source of one's own that plays a folder at 100 Hz; it fails as it is asked to."""

    live = False

    def __init__(self, folder: str, fails: str = "", missing: tuple[int, ...] = ()) -> None:
        files = sorted(Path(folder).glob("*.png"))
        self._left = [(k, file) for k, file in enumerate(files) if k not in missing]
        self._fails, self.closed = fails, False

    def read(self) -> tuple[np.ndarray, float] | None:
        if not self._left:
            return None
        index, file = self._left.pop(0)
        image = read_picture(file)
        if index == 8 and self._fails == "vanishes":
            raise OSError("unplugged")
        return (image[:400] if index == 8 and self._fails == "size" else image), 0.01 * index

    def close(self) -> None:
        self.closed = True


def test_frames_come_from_a_source_of_ones_own(taken: Path, tmp_path: Path) -> None:
    source = Played(str(taken), missing=(9, 10))
    result = run_outside(SCENE, source, tmp_path)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["source"] == f"{__name__}:Played"
    assert summary["delivery"] == {"repeated": 1, "dropped": 2, "stalled": 0, "late": None}
    assert summary["frames"] == 11
    assert source.closed
    whole = run_outside(SCENE, str(taken), fps=100.0)
    assert whole.summary["delivery"]["dropped"] is None
    for name in ("grip_n", "normal_estimated_n"):
        np.testing.assert_array_equal(result.trace[name][:7], whole.trace[name][:7])


@pytest.mark.parametrize(
    ("fails", "words"),
    [
        ("vanishes", r"^source .*:Played failed after 8 frames: OSError: unplugged .*"),
        ("size", r"^frame has shape \(400, 640, 3\) .*, the rest frame had \(480, 640, 3\) .*"),
    ],
)
def test_a_source_that_breaks_off_keeps_grip_and_trace(
    fails: str, words: str, taken: Path, tmp_path: Path
) -> None:
    gripper = Kept()
    with pytest.raises(UserError, match=rf"{words}; the grip stays at [\d.]+ N$"):
        run_outside(SCENE, Played(str(taken), fails), tmp_path, gripper=gripper)
    assert len(pq.read_table(tmp_path / "trace.parquet")) == 6  # without the two at rest
    assert gripper.forces[-1] == gripper.forces[-2]


def test_a_gripper_that_raises_ends_the_loop(taken: Path, tmp_path: Path) -> None:
    gripper = Kept(raises_at=4)
    words = (
        r"^gripper .*:Kept failed at t = 0\.03 s, frame 3: OSError: no route to the gripper .*; "
        r"the grip stays at [\d.]+ N$"
    )
    with pytest.raises(UserError, match=words):
        run_outside(SCENE, str(taken), tmp_path, gripper=gripper, fps=100.0)
    assert len(pq.read_table(tmp_path / "trace.parquet")) == 3
    assert json.loads((tmp_path / "summary.json").read_text())["complete"] is False


class Stiff:
    """Takes forces but for one, which it never takes."""

    def command(self, force: float) -> None:
        if force > 0.0:
            time.sleep(20.0)


def test_a_gripper_that_never_answers_is_left_behind(taken: Path) -> None:
    words = r"Stiff did not answer within 0\.2 s at t = 0 s, frame 0; the grip stays at 0 N"
    with pytest.raises(UserError, match=words):
        run_outside(SCENE, str(taken), gripper=Stiff(), fps=100.0, answer_within_s=0.2)


class Fails:
    """A controller that fails at 0.05 s: raises, or is interrupted."""

    error: BaseException = ZeroDivisionError()

    def reset(self) -> None:
        pass

    def command(self, observation: GripObservation) -> GripCommand:
        if observation.time > 0.045:
            raise self.error
        return GripCommand(force=1.0 + observation.time)


@pytest.mark.parametrize("error", [ZeroDivisionError(), KeyboardInterrupt()])
def test_the_last_safe_grip_is_commanded_again(
    error: BaseException, taken: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Fails, "error", error)
    monkeypatch.setitem(sys.modules, "failing", sys.modules[__name__])
    scene = load_scene("camera-100hz", CHANGES | {"controller": "failing:Fails"})
    gripper = Kept()
    kind = KeyboardInterrupt if isinstance(error, KeyboardInterrupt) else UserError
    with pytest.raises(kind) as caught:
        run_outside(scene, str(taken), tmp_path, gripper=gripper, fps=100.0)
    assert gripper.forces == pytest.approx([0.0, 1.0, 1.01, 1.02, 1.03, 1.04, 1.04])
    if kind is UserError:
        assert str(caught.value).count("the grip stays at 1.04 N") == 1
    assert len(pq.read_table(tmp_path / "trace.parquet")) == 5


def written(path: Path, *arrays: np.ndarray, cut: int | None = None) -> str:
    with path.open("wb") as file:
        for array in arrays:
            np.save(file, array)
    path.write_bytes(path.read_bytes()[:cut])
    return f"pipe:{path}"


def test_sources_that_do_not_fit_are_refused(taken: Path, tmp_path: Path) -> None:
    picture = np.zeros((4, 5, 3), np.uint8)
    small = written(tmp_path / "small", *[np.float64(0.0), picture] * 3)
    with pytest.raises(UserError, match=r"has frames of 5 × 4 pixels; sensor thesis has 640 × 480"):
        run_outside(SCENE, small)
    one = written(tmp_path / "one", np.float64(0.0), picture)
    with pytest.raises(UserError, match=r"ended after 1 frames; the first 2 must show the unloa"):
        run_outside(SCENE, one)
    with pytest.raises(UserError, match="gripper 'nobody'"):
        run_outside(SCENE, str(taken), gripper="nobody")
    with pytest.raises(UserError, match='set path = "camera"'):
        run_outside(load_scene("camera-100hz", {"path": "truth"}), str(taken))


def test_from_the_command_line(typed: Typed, taken: Path, tmp_path: Path) -> None:
    (tmp_path / "my_gripper.py").write_text(
        "class Mine:\n"
        "    def __init__(self, log):\n        self.log = open(log, 'a')\n"
        "    def command(self, force):\n        print(force, file=self.log, flush=True)\n"
    )
    line = ["grasp", "camera-100hz", "--source", taken, "--set", "duration_s=0.05"]
    line += ["--set", "camera.rest_frames=2"]
    mine = ["--gripper", "my_gripper:Mine", "--gripper-arg", "log=forces.txt"]
    done = typed(*line, *mine, "--json")
    assert done.returncode == 0, done.stderr
    forces = [float(text) for text in (tmp_path / "forces.txt").read_text().split()]
    assert forces[0] == 0.0
    assert len(forces) == 1 + json.loads(done.stdout)["frames"]
    done = typed(*line, "--out", "run")
    assert "largest grip force" in done.stdout
    assert {path.name for path in (tmp_path / "run").iterdir()} == {
        "scene.toml",
        "trace.parquet",
        "summary.json",
        "report.html",
    }
    done = typed("grasp", "--gripper", "simulated")
    assert "--gripper is an option of --source" in done.stderr
