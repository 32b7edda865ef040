"""Methods from Python: objects, classes and arguments in place of what a scene names."""

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
from chromagrip.scene.scene import dump_scene
from chromagrip.tracking import MarkerTracker, Tracks, load_reconstructor

QUICK = {"path": "truth", "duration_s": 0.1}
SEEN = {"duration_s": 0.02, "camera.rest_frames": 2}


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


class Demanding(Scaled):
    """A controller that cannot be made."""

    def __init__(self, size: float) -> None: ...


@pytest.fixture(autouse=True)
def plugin(monkeypatch: pytest.MonkeyPatch) -> None:
    """All of them, in a module that can be imported."""
    module = ModuleType("plugin")
    module.__dict__.update(Scaled=Scaled, Leaving=Leaving, Demanding=Demanding)
    monkeypatch.setitem(sys.modules, "plugin", module)


@pytest.mark.parametrize(
    ("controller", "force"),
    [
        (Scaled(gain=4.0), 2.0),
        (partial(Scaled, gain=4.0), 2.0),
        (Scaled, 0.5),
        ("plugin:Scaled", 0.5),
        ("conservative", 5.0),
    ],
)
def test_a_controller_may_be_an_object_a_factory_or_a_name(controller: Any, force: float) -> None:
    result = run(load_scene("camera-100hz", QUICK), controller=controller)
    assert (result.trace["grip_n"] == force).all()
    name = controller if isinstance(controller, str) else f"{Scaled.__module__}:Scaled"
    assert result.summary["controller"] == result.scene.controller == name


def test_arguments_of_a_controller_are_kept_in_the_scene(tmp_path: Path) -> None:
    changes = QUICK | {"controller": "plugin:Scaled", "controller_arguments.gain": 3}
    first = run(load_scene("camera-100hz", changes))
    assert (first.trace["grip_n"] == 1.5).all()
    (tmp_path / "scene.toml").write_text(dump_scene(first.scene), encoding="utf-8")
    again = run(load_scene(str(tmp_path / "scene.toml"), allow=("plugin",)))
    assert again.scene == first.scene
    assert (again.trace["grip_n"] == 1.5).all()
    # A controller in place of the scene's does not get its arguments.
    other = run(again.scene, controller="plugin:Scaled")
    assert (other.trace["grip_n"] == 0.5).all()
    changes = QUICK | {"controller": "plugin:Scaled", "controller_arguments.speed": 3}
    with pytest.raises(UserError, match="has no argument speed"):
        run(load_scene("camera-100hz", changes))


@pytest.mark.parametrize(
    ("controller", "words"),
    [
        ("plugin:Leaving", "controller plugin:Leaving failed at t = 0 s, sample 0: SystemExit: 0"),
        (dict, "controller 'builtins:dict' has no reset"),
        ("pid", "no controller 'pid'; there is"),
        ("plugin:Nobody", "controller 'plugin:Nobody': module plugin has no Nobody"),
        ("plugin:Demanding", r"Demanding' needs size \(a number\); it has size"),
    ],
)
def test_what_is_no_controller_is_refused(controller: Any, words: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=words):
        run(load_scene("camera-100hz", QUICK), tmp_path / "run", controller=controller)
    assert not (tmp_path / "run").exists()


class Own:
    """A renderer of one's own, which has the painter paint."""

    def __init__(self, sensor: SensorDesign) -> None:
        self._painter = open_renderer("painter", sensor)

    def render(self, membrane: Membrane) -> NDArray[np.uint8]:
        """Picture."""
        return self._painter.render(membrane)

    def close(self) -> None:
        """Nothing is held."""


class Slow(MarkerTracker):
    """A tracker that takes longer than a frame lasts in every third frame."""

    seen = 0

    def update(self, frame: Frame) -> Tracks:
        """Markers in a frame."""
        self.seen += 1
        time.sleep(0.025 if self.seen % 3 == 0 else 0.0)
        return super().update(frame)


@pytest.mark.loops
def test_tracker_reconstructor_and_renderer_may_be_classes_too(tmp_path: Path) -> None:
    """Frames that are read too late are counted; `auto` is named by what it is."""
    scene = load_scene("camera-100hz", SEEN)
    assert scene.reconstructor == "auto"
    plain = run(scene, tmp_path)
    assert plain.summary["reconstructor"] == "way"
    assert load_scene(str(tmp_path / "scene.toml")).reconstructor == "way"
    assert plain.summary["camera_pose"]["roll_deg"] == pytest.approx(0.0, abs=0.05)
    same = run(scene, tracker=Slow, reconstructor=load_reconstructor("way"), renderer=Own)
    for name, column in plain.trace.columns.items():
        np.testing.assert_array_equal(column, same.trace[name])
    assert same.scene.renderer == f"{__name__}:Own"
    reading = same.summary["reading_ms"]
    assert same.summary["late_frames"] >= same.summary["frames"] // 3  # of 10 ms each
    assert reading["worst"] >= reading["p99"] >= reading["p95"] >= 25.0
    assert reading["median"] <= reading["p95"]


def test_frames_without_an_estimate_are_counted_by_their_reasons() -> None:
    """Reasons that differ by their numbers alone are one kind; the truth path reads nothing."""
    reasons = ["1.2 N of 3 N", "0.9 N of 4 N", "no pair"]
    assert counted_kinds(reasons) == {"1.2 N of 3 N": 2, "no pair": 1}
    truth = run(load_scene("camera-100hz", QUICK)).summary
    assert (truth["without_estimate"], truth["without_estimate_because"]) == (0, {})
    for name in ("reconstructor", "camera_pose", "reading_ms", "late_frames"):
        assert truth[name] is None


@pytest.mark.loops
def test_a_summary_says_why_there_is_no_estimate() -> None:
    hidden = {**SEEN, "defects.jpeg_quality": 15, "safety_margin.grip_first.ceiling_n": 3.0}
    summary = run(load_scene("camera-100hz", hidden)).summary
    assert summary["without_estimate"] == sum(summary["without_estimate_because"].values())
    assert 0 < summary["without_estimate"] <= summary["frames"]
    assert "compressed too much" in next(iter(summary["without_estimate_because"]))


@pytest.mark.parametrize(("body", "name"), [("chain", "way"), ("dome", "contact")])
def test_auto_is_the_reconstructor_of_the_body_and_not_of_the_sensor(body: str, name: str) -> None:
    changes = {"sensor": "dome-2020", "body": body}
    scene = load_scene("camera-100hz", changes)
    assert Methods.of_scene(scene).reconstructor == name
    with pytest.raises(UserError, match=f'does not read body = "{body}"'):
        choose(scene, reconstructor="contact" if body == "chain" else "sequential")
