from collections.abc import Iterator

import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.model import ContactObject, Fingertip, rest_state, step
from chromagrip.render import Membrane, MembraneMap, Renderer, load_sensor, open_renderer
from chromagrip.render.drawing import gl as gl_module
from chromagrip.render.drawing.gl import gl_problem

SENSOR = load_sensor("thesis")


@pytest.fixture(scope="module")
def mesh() -> Iterator[Renderer]:
    problem = gl_problem()
    if problem is not None:
        pytest.skip(problem)
    renderer = open_renderer("pyrender", SENSOR)
    yield renderer
    renderer.close()


@pytest.fixture(scope="module")
def pressed() -> Membrane:
    tip, obj = Fingertip(), ContactObject()
    state = rest_state(tip)
    for k in range(60):
        state = step(tip, obj, state, 5e-3, 3.0, 0.65 if k > 5 else 0.0)
    return MembraneMap(SENSOR, tip.nodes)(state.deformation.seen)


def test_painter_and_meshes_agree(mesh: Renderer, pressed: Membrane) -> None:
    """Two independent rasterisers: at most 3 levels apart on 98 % of the pixels."""
    painted = open_renderer("painter", SENSOR).render(pressed).astype(int)
    difference = np.abs(mesh.render(pressed) - painted).max(axis=2)
    assert (difference <= 3).mean() > 0.98
    assert difference.max() < 25
    # Where it counts: the mean colour of the frame, so that no layer is missing or shifted.
    assert difference.mean() < 0.5


def test_meshes_follow_the_membrane(mesh: Renderer, pressed: Membrane) -> None:
    """Replacing positions in place is silently ignored by pyrender; frames must still change."""
    rest = MembraneMap(SENSOR, 251)(np.zeros((251, 2)))
    assert (mesh.render(rest) != mesh.render(pressed)).any()
    assert (mesh.render(rest) == mesh.render(rest)).all()


def test_missing_gl_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "chromagrip.render.drawing.mesh_renderer.gl_problem",
        lambda: "no off-screen OpenGL context: test",
    )
    with pytest.raises(UserError, match=r"pyrender cannot run here.*apt-get install"):
        open_renderer("pyrender", SENSOR)
    assert gl_module.MEND.startswith("sudo apt-get install")
