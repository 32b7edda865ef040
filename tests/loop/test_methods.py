"""Methods from Python: objects, classes and arguments in place of what a scene names."""

import sys
from functools import partial
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numpy.typing import NDArray

from chromagrip import UserError, load_scene, run
from chromagrip.control import GripCommand, GripObservation
from chromagrip.loop.methods import Methods, choose
from chromagrip.loop.trace import counted_kinds
from chromagrip.render import Membrane, SensorDesign, open_renderer
from chromagrip.scene.scene import dump_scene
from chromagrip.tracking import MarkerTracker, load_reconstructor

QUICK = {"path": "truth", "duration_s": 0.1}
SEEN = {"duration_s": 0.02, "camera.rest_frames": 2}


class Scaled:
    """A controller with an argument, whose command is constant."""

    def __init__(self, gain: float = 1.0) -> None:
        self.gain = gain

    def reset(self) -> None:
        """Nothing to forget."""

    def command(self, observation: GripObservation) -> GripCommand:
        return GripCommand(force=0.5 * self.gain)


@pytest.fixture(autouse=True)
def plugin(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("plugin")
    module.__dict__["Scaled"] = Scaled
    monkeypatch.setitem(sys.modules, "plugin", module)


def test_a_controller_may_be_an_object_a_factory_or_a_name() -> None:
    for controller, force in (
        (Scaled(gain=4.0), 2.0),
        (partial(Scaled, gain=4.0), 2.0),
        (Scaled, 0.5),
        ("plugin:Scaled", 0.5),
    ):
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


def test_what_is_no_controller_is_refused(tmp_path: Path) -> None:
    for controller, words in (
        (dict, "controller 'builtins:dict' has no reset"),
        ("pid", "no controller 'pid'; there is"),
        ("plugin:Nobody", "controller 'plugin:Nobody': module plugin has no Nobody"),
    ):
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


@pytest.mark.loops
def test_tracker_reconstructor_and_renderer_may_be_classes_too(tmp_path: Path) -> None:
    """And `auto` is named by what it is."""
    scene = load_scene("camera-100hz", SEEN)
    assert scene.reconstructor == "auto"
    plain = run(scene, tmp_path)
    assert plain.summary["reconstructor"] == "way"
    assert load_scene(str(tmp_path / "scene.toml")).reconstructor == "way"
    assert plain.summary["camera_pose"]["roll_deg"] == pytest.approx(0.0, abs=0.05)
    same = run(scene, tracker=MarkerTracker, reconstructor=load_reconstructor("way"), renderer=Own)
    for name, column in plain.trace.columns.items():
        np.testing.assert_array_equal(column, same.trace[name])
    assert same.scene.renderer == f"{__name__}:Own"


def test_frames_without_an_estimate_are_counted_by_their_reasons() -> None:
    """Reasons that differ by their numbers alone are one kind; the truth path reads nothing."""
    reasons = ["1.2 N of 3 N", "0.9 N of 4 N", "no pair"]
    assert counted_kinds(reasons) == {"1.2 N of 3 N": 2, "no pair": 1}
    truth = run(load_scene("camera-100hz", QUICK)).summary
    assert (truth["without_estimate"], truth["without_estimate_because"]) == (0, {})
    for name in ("reconstructor", "camera_pose", "reading_ms", "late_frames"):
        assert truth[name] is None


@pytest.mark.parametrize(("body", "name"), [("chain", "way"), ("dome", "contact")])
def test_auto_is_the_reconstructor_of_the_body_and_not_of_the_sensor(body: str, name: str) -> None:
    changes = {"sensor": "dome-2020", "body": body}
    scene = load_scene("camera-100hz", changes)
    assert Methods.of_scene(scene).reconstructor == name
    with pytest.raises(UserError, match=f'does not read body = "{body}"'):
        choose(scene, reconstructor="contact" if body == "chain" else "way")
