"""What the page itself shows and takes: the swirl of a twist, an object from a file."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from chromagrip import load_scene
from chromagrip.live.guard import LARGEST_FILE
from chromagrip.live.page import Page
from chromagrip.live.record import Recorder
from chromagrip.live.session import Session
from chromagrip.live.solid import half_sphere, object_mesh, skin_faces
from chromagrip.scene.settings import ObjectSettings

DOME = {"path": "truth", "camera.rate_hz": 50.0, "fingertip.step_ms": 10.0}
Until = Callable[..., None]


class Shown:
    """A page, its controls by their labels, and what it shows."""

    def __init__(self, server: Any, page: Page, session: Session) -> None:
        self.page, self.session = page, session
        controls = server.gui._gui_input_handle_from_uuid.values()
        self.named = {control.label: control for control in controls}

    @property
    def count(self) -> int:
        return 0 if self.page.board.strips is None else len(self.page.board.strips._rows)

    @property
    def status(self) -> str:
        return str(self.page.board._status.content)

    def swirl(self) -> float:
        """Torque about the axis of the arrows that the browsers are sent, of any unit."""
        points = self.page.view._arrows.points
        start, way = points[:, 0], points[:, 1] - points[:, 0]
        return float((start[:, 0] * way[:, 1] - start[:, 1] * way[:, 0]).sum())


@pytest.fixture
def shown(viser_server: Any, tmp_path: Path) -> Iterator[Shown]:
    scene = load_scene("dome-1", DOME)
    with Page(viser_server, scene) as page:
        recorder = Recorder(tmp_path / "kept", page.tell_kept)
        with Session(scene, page.show, page.tell, recorder) as session:
            page.connect(session)
            yield Shown(viser_server, page, session)
            session.check()


def test_a_twist_swirls_the_arrows(shown: Shown, until: Until) -> None:
    """The friction on the fingertip turns the way that the object is turned, and back."""
    shown.named["load [N]"].value = 0.0
    shown.named["controller grips"].value = False
    shown.named["grip [N]"].value = 5.0
    shown.named["twist [N mm]"].value = 4.0
    until(lambda: "true: Γ" in shown.status and shown.swirl() > 1.0)
    shown.named["twist [N mm]"].value = -4.0
    until(lambda: shown.swirl() < -1.0)
    assert shown.session.sliders.twist == -4.0


def test_an_object_is_dropped_in(shown: Shown, until: Until) -> None:
    until(lambda: "true: Γ" in shown.status)
    content = trimesh.creation.icosphere(subdivisions=3, radius=9.0).export(file_type="stl")
    shown.page.drop("screw.stl", content)
    until(lambda: shown.session.sliders.object.endswith(".stl"))
    until(lambda: len(shown.page.view._object.vertices) == 642)
    assert shown.named["object"].value == "screw.stl"
    shown.named["object"].value = "box"
    until(lambda: shown.session.sliders.object == "box")
    shown.page.drop("screw.stl", content)  # the same name again
    until(lambda: shown.session.sliders.object.endswith("2.stl"))


def test_a_file_that_is_no_object_is_refused(shown: Shown, until: Until) -> None:
    until(lambda: "true: Γ" in shown.status)
    before = shown.session.sliders
    for name, content, sentence in (
        ("screw.step", b"solid", "screw.step: an object is a file .stl, .obj, .ply"),
        ("large.stl", bytes(LARGEST_FILE + 1), "large.stl is empty or too large; at most 20 MB"),
        ("../../screw.obj", b"v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 3\n", "mesh screw.obj"),
        ("open.obj", b"v 0 0 0\nv 9 0 0\nv 0 9 0\nv 0 0 9\nf 1 2 3\nf 1 2 4\n", "mesh open.obj"),
    ):
        shown.page.drop(name, content)
        until(lambda sentence=sentence: sentence in shown.status)
        assert "**Refused:**" in shown.status
        assert str(shown.page._folder.name) not in shown.status
        assert shown.session.sliders == before
    count = shown.count
    until(lambda: shown.count > count + 5)  # the grasp goes on
    assert "**Refused:**" in shown.status
    assert list(Path(shown.page._folder.name).iterdir()) == []


@pytest.mark.loops
def test_the_button_records(shown: Shown, until: Until, tmp_path: Path) -> None:
    until(lambda: "true: Γ" in shown.status)
    shown.page._press("record")
    assert shown.page._record.label == "stop recording"
    until(lambda: "recording** into" in shown.status)
    count = shown.count
    until(lambda: shown.count > count + 20)
    shown.page._press("record")
    until(lambda: "recorded" in shown.status)
    assert shown.page._record.label == "record"
    assert (tmp_path / "kept/001/report.html").is_file()


def test_a_half_sphere_has_no_torn_rim() -> None:
    """Its triangles cover it: their area is that of the sphere, and its border is the rim."""
    points = half_sphere(1.0)
    made = trimesh.Trimesh(points, skin_faces(points), process=False)
    assert made.area == pytest.approx(2.0 * math.pi, rel=0.01)
    once = trimesh.grouping.group_rows(made.edges_sorted, require_count=1)
    np.testing.assert_allclose(points[np.unique(made.edges_sorted[once]), 2], 0.0, atol=1e-12)


def test_a_mesh_lies_where_the_model_has_it(tmp_path: Path) -> None:
    made = trimesh.creation.box(extents=(4.0, 6.0, 8.0))
    made.apply_translation((100.0, 0.0, 50.0))
    made.export(tmp_path / "far.stl")
    drawn = object_mesh(ObjectSettings(mesh=str(tmp_path / "far.stl")))
    np.testing.assert_allclose(drawn.bounds, [[-0.002, -0.003, -0.004], [0.002, 0.003, 0.004]])
