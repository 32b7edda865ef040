"""Methods from Python: objects, classes and arguments in place of what a scene names."""

import json
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from chromagrip import UserError, load_scene, run
from chromagrip.control import GripCommand, GripObservation
from chromagrip.loop.methods import Methods, choose
from chromagrip.loop.trace import counted_kinds
from chromagrip.render import Frame, Membrane, SensorDesign, open_renderer
from chromagrip.tracking import MarkerTracker, Tracks, load_reconstructor

QUICK = {"path": "truth", "duration_s": 0.1}
SEEN = {"duration_s": 0.03, "camera.rest_frames": 2}


class Scaled:
    """A controller with an argument, whose command is constant."""

    def __init__(self, gain: float = 1.0) -> None:
        self.gain = gain

    def reset(self) -> None:
        """Nothing to forget."""

    def command(self, observation: GripObservation) -> GripCommand:
        """Grip force."""
        return GripCommand(force=0.5 * self.gain)


class Leaving(Scaled):
    """A controller that ends the process as if all were well."""

    def command(self, observation: GripObservation) -> GripCommand:
        """End the process."""
        sys.exit(0)


class Callable(Scaled):
    """A controller that can be called, too."""

    def __call__(self) -> None:
        raise AssertionError


@pytest.fixture(autouse=True)
def plugin(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both, in a module that can be imported."""
    module = ModuleType("plugin")
    module.__dict__.update(Scaled=Scaled, Leaving=Leaving)
    monkeypatch.setitem(sys.modules, "plugin", module)


@pytest.mark.loops
@pytest.mark.parametrize(
    "controller", [Scaled(gain=4.0), Callable(gain=4.0), partial(Scaled, gain=4.0)]
)
def test_a_controller_may_be_an_object_or_a_factory(controller: Any, tmp_path: Path) -> None:
    result = run(load_scene("camera-100hz", QUICK), tmp_path, controller=controller)
    assert (result.trace["grip_n"] == 2.0).all()
    kind = type(controller) if isinstance(controller, Scaled) else Scaled
    name = f"{kind.__module__}:{kind.__qualname__}"
    assert result.summary["controller"] == name
    scene = load_scene(str(tmp_path / "scene.toml"), allow=(kind.__module__,))
    assert scene.controller == name
    assert json.loads((tmp_path / "summary.json").read_text())["controller"] == name


def test_a_class_is_made_without_arguments() -> None:
    assert (run(load_scene("camera-100hz", QUICK), controller=Scaled).trace["grip_n"] == 0.5).all()
    named = run(load_scene("camera-100hz", QUICK), controller="conservative")
    assert (named.trace["grip_n"] == 5.0).all()


def test_arguments_of_a_controller_are_kept_in_the_scene(tmp_path: Path) -> None:
    changes = QUICK | {"controller": "plugin:Scaled", "controller_arguments.gain": 3}
    first = run(load_scene("camera-100hz", changes), tmp_path / "run")
    assert (first.trace["grip_n"] == 1.5).all()
    again = run(load_scene(str(tmp_path / "run/scene.toml"), allow=("plugin",)))
    assert again.scene == first.scene
    assert (again.trace["grip_n"] == 1.5).all()
    # A controller in place of the scene's does not get its arguments.
    other = run(again.scene, controller="plugin:Scaled")
    assert (other.trace["grip_n"] == 0.5).all()


def test_arguments_that_a_controller_does_not_take_are_refused() -> None:
    changes = QUICK | {"controller": "plugin:Scaled", "controller_arguments.speed": 3}
    with pytest.raises(UserError, match="has no argument speed"):
        run(load_scene("camera-100hz", changes))


@pytest.mark.parametrize(
    ("controller", "words"),
    [
        ("plugin:Leaving", "controller plugin:Leaving failed at t = 0 s, sample 0: SystemExit: 0"),
        (object(), "controller 'builtins:object' has no reset"),
        (dict, "controller 'builtins:dict' has no reset"),
        ("pid", "no controller 'pid'; there is"),
    ],
)
def test_what_is_no_controller_is_refused(controller: Any, words: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=words):
        run(load_scene("camera-100hz", QUICK), tmp_path / "run", controller=controller)


class Grey:
    """A renderer that darkens the painter's picture."""

    def __init__(self, sensor: SensorDesign, share: float = 1.0) -> None:
        self._painter = open_renderer("painter", sensor)
        self._share = share

    def render(self, membrane: Membrane) -> NDArray[np.uint8]:
        """Darker picture."""
        return (self._share * self._painter.render(membrane)).astype(np.uint8)

    def close(self) -> None:
        """Nothing is held."""


def test_tracker_reconstructor_and_renderer_may_be_classes_too() -> None:
    scene = load_scene("camera-100hz", SEEN)
    plain = run(scene)
    same = run(
        scene,
        tracker=MarkerTracker,
        reconstructor=load_reconstructor("sequential"),
        renderer=Grey,
    )
    for name, column in plain.trace.columns.items():
        np.testing.assert_array_equal(column, same.trace[name])
    assert same.scene.renderer == f"{__name__}:Grey"
    dark = run(scene, renderer=partial(Grey, share=0.9))
    assert (dark.trace["normal_estimated_n"] != plain.trace["normal_estimated_n"]).any()


def test_summary_and_scene_name_the_reconstructor_that_auto_is(tmp_path: Path) -> None:
    scene = load_scene("camera-100hz", SEEN)
    assert scene.reconstructor == "auto"
    result = run(scene, tmp_path)
    assert result.summary["reconstructor"] == "way"
    assert load_scene(str(tmp_path / "scene.toml")).reconstructor == "way"
    assert result.summary["camera_pose"]["roll_deg"] == pytest.approx(0.0, abs=0.05)
    truth = run(load_scene("camera-100hz", QUICK)).summary
    assert truth["reconstructor"] is truth["camera_pose"] is None


@pytest.mark.loops
def test_the_summary_counts_frames_without_an_estimate_by_their_reasons() -> None:
    """Reasons that differ by their numbers alone are one kind."""
    reasons = ["1.2 N of 3 N", "0.9 N of 4 N", "no pair"]
    assert counted_kinds(reasons) == {"1.2 N of 3 N": 2, "no pair": 1}
    hidden = {**SEEN, "defects.jpeg_quality": 15, "safety_margin.grip_first.ceiling_n": 3.0}
    summary = run(load_scene("camera-100hz", hidden)).summary
    assert summary["without_estimate"] == sum(summary["without_estimate_because"].values())
    assert 0 < summary["without_estimate"] <= summary["frames"]
    assert "compressed too much" in next(iter(summary["without_estimate_because"]))
    truth = run(load_scene("camera-100hz", QUICK)).summary
    assert (truth["without_estimate"], truth["without_estimate_because"]) == (0, {})


SWEEP = """
from joblib import Parallel, delayed

import chromagrip
from chromagrip.control import GripCommand


class Mine:
    def __init__(self, gain):
        self.gain = gain

    def reset(self):
        pass

    def command(self, observation):
        return GripCommand(force=0.5 * self.gain)


def last(controller):
    scene = chromagrip.load_scene("camera-100hz", {"path": "truth", "duration_s": 0.05})
    return chromagrip.run(scene, controller=controller).summary["final_grip_n"]


if __name__ == "__main__":
    gains = (1, 2, 3)
    print(*[last(Mine(gain=gain)) for gain in gains])
    print(*Parallel(n_jobs=2)(delayed(last)(Mine(gain=gain)) for gain in gains))
"""


@pytest.mark.loops
def test_a_script_sweeps_over_gains_in_this_process_and_in_others(tmp_path: Path) -> None:
    script = tmp_path / "sweep.py"
    script.write_text(SWEEP, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["0.5 1.0 1.5", "0.5 1.0 1.5"]


@pytest.mark.parametrize(("body", "name"), [("chain", "way"), ("dome", "contact")])
def test_auto_is_the_reconstructor_of_the_body_and_not_of_the_sensor(body: str, name: str) -> None:
    changes = {"sensor": "dome-2020", "body": body}
    scene = load_scene("camera-100hz", changes)
    assert Methods.of_scene(scene).reconstructor == name
    with pytest.raises(UserError, match=f'does not read body = "{body}"'):
        choose(scene, reconstructor="contact" if body == "chain" else "sequential")


class Slow(MarkerTracker):
    """A tracker that takes longer than a frame lasts in every third frame."""

    seen = 0

    def update(self, frame: Frame) -> Tracks:
        """Markers in a frame."""
        self.seen += 1
        time.sleep(0.025 if self.seen % 3 == 0 else 0.0)
        return super().update(frame)


def test_frames_that_are_read_too_late_are_counted() -> None:
    scene = load_scene("camera-100hz", {"duration_s": 0.15, "camera.rest_frames": 2})
    summary = run(scene, tracker=Slow, controller=Scaled()).summary
    reading = summary["reading_ms"]
    assert summary["late_frames"] >= summary["frames"] // 3  # of 10 ms each
    assert reading["worst"] >= reading["p99"] >= reading["p95"] >= 25.0
    assert reading["median"] <= reading["p95"]
    true = run(load_scene("camera-100hz", QUICK)).summary
    assert true["reading_ms"] is None
    assert true["late_frames"] is None
