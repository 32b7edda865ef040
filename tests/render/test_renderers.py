"""Renderers by name, by `module:Class` and from Python."""

from functools import partial

import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.loop.run import run
from chromagrip.render import RENDERERS, MembraneMap, load_sensor, open_renderer
from chromagrip.render.drawing.painter import Painter
from chromagrip.scene.scene import load_scene

SENSOR = load_sensor("thesis")
MODULE = """
from chromagrip.render.drawing.painter import Painter

class Dim(Painter):
    share = 0.5
    def __init__(self, sensor, share=0.5):
        super().__init__(sensor)
        self._share = share
    def render(self, membrane):
        return (self._share * super().render(membrane)).astype("uint8")

class Broken(Painter):
    def __init__(self, sensor):
        raise RuntimeError("no ink")

class Blind:
    def close(self):
        pass
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    (tmp_path / "somebodys_renderer.py").write_text(MODULE)
    monkeypatch.syspath_prepend(str(tmp_path))
    return "somebodys_renderer"


def brightness(renderer):
    return renderer.render(MembraneMap(SENSOR, 11)(np.zeros((11, 2)))).mean()


def test_an_unknown_renderer_is_named_with_those_there_are():
    with pytest.raises(UserError, match=r"no renderer 'crayon'; there is painter, pyrender, or"):
        open_renderer("crayon", SENSOR)
    with pytest.raises(UserError, match=r"no renderer 'crayon'"):
        load_scene(changes={"renderer": "crayon"})


def test_a_renderer_of_a_module_takes_arguments(module):
    bright = brightness(open_renderer("painter", SENSOR))
    assert brightness(open_renderer(f"{module}:Dim", SENSOR)) == pytest.approx(bright / 2, abs=1)
    dark = open_renderer(f"{module}:Dim", SENSOR, {"share": 0.25})
    assert brightness(dark) == pytest.approx(bright / 4, abs=1)


def test_a_class_or_another_factory_is_a_renderer():
    assert isinstance(open_renderer(Painter, SENSOR), Painter)
    assert isinstance(open_renderer(partial(Painter, redraw=True), SENSOR), Painter)


def test_a_renderer_that_fails_or_lacks_a_method_is_one_sentence(module):
    with pytest.raises(UserError, match=r"somebodys_renderer:Broken.*RuntimeError: no ink"):
        open_renderer(f"{module}:Broken", SENSOR)
    with pytest.raises(UserError, match=r"somebodys_renderer:Blind' has no render; see chromagrip"):
        open_renderer(f"{module}:Blind", SENSOR)


def test_a_scene_names_a_renderer_of_a_module(module):
    scene = load_scene(changes={"renderer": f"{module}:Dim", "duration_s": 0.02, "path": "truth"})
    assert run(scene).summary["renderer"] == f"{module}:Dim"


def test_every_renderer_has_a_line_of_description():
    assert set(RENDERERS.descriptions()) >= {"painter", "pyrender"}
