"""A recording is a run folder like any other, or it is not there."""

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from chromagrip import load_scene
from chromagrip.live.record import FROM, Recorder
from chromagrip.live.session import Session, Shown
from chromagrip.live.sliders import scene_for, slider_values
from chromagrip.loop.results.reports import write_reports
from chromagrip.loop.results.run_folder import read_run
from chromagrip.scene.scene import Scene

DOME = {"path": "truth", "camera.rate_hz": 50.0, "fingertip.step_ms": 10.0}
Until = Callable[..., None]


class Grasp:
    """A session with a recorder, whose words are kept."""

    def __init__(self, scene: Scene, folder: Path) -> None:
        self.shown: list[Shown] = []
        self.told: list[str] = []
        self.recorder = Recorder(folder, self.told.append)
        self.session = Session(scene, self.shown.append, lambda _: None, self.recorder)


def test_a_recording_is_a_run_with_its_sliders_as_steps(tmp_path: Path, until: Until) -> None:
    grasp = Grasp(load_scene("dome-1", DOME), tmp_path / "kept")
    with grasp.session as session:
        session.ask(replace(session.sliders, automatic=False, grip=3.0, load=0.2, twist=0.0))
        until(lambda: len(grasp.shown) > 30)
        grasp.recorder.wanted = True
        first = len(grasp.shown)
        until(lambda: len(grasp.shown) > first + 20)
        session.ask(replace(session.sliders, load=0.5, twist=2.0, friction=0.7))
        changed = len(grasp.shown)
        until(lambda: len(grasp.shown) > changed + 20)
        grasp.recorder.wanted = False
        until(lambda: grasp.told[-1].startswith("recorded"))
    folder = tmp_path / "kept/001"
    run = read_run(folder)
    names = {"figure.png", "report.html", "scene.toml", "sliders.csv", "summary.json"}
    assert {f.name for f in folder.iterdir()} == names | {"tactile.mp4", "trace.parquet"}
    of = run.columns
    assert of["time_s"][0] == 0.0
    np.testing.assert_allclose(np.diff(of["time_s"]), 0.02, atol=1e-9)
    by_time = {one.sample.time: one.sample for one in grasp.shown}
    begin = run.summary[FROM]
    last = by_time[min(by_time, key=lambda t: abs(t - begin - of["time_s"][-1]))]
    assert of["normal_true_n"][-1] == pytest.approx(last.field.total_normal, rel=1e-9)
    assert run.summary["complete"]
    assert run.scene.load.forces_n == pytest.approx((0.2, 0.5))
    assert run.scene.load.twists_nmm == pytest.approx((0.0, 2.0), abs=1e-6)
    assert run.scene.object.frictions == (0.5, 0.7)
    step = np.flatnonzero(np.diff(of["mu_true"]) > 0.1)[0]
    assert of["time_s"][step + 1] == pytest.approx(run.scene.load.times_s[1], abs=0.021)
    with (folder / "sliders.csv").open() as file:
        sliders = list(csv.DictReader(file))
    assert [float(line["load"]) for line in sliders] == [0.2, 0.5]
    assert sliders[0]["grip"] == "3.0"
    assert write_reports([folder], tmp_path / "again.html").is_file()


def test_a_server_that_stops_leaves_the_recording_whole(tmp_path: Path, until: Until) -> None:
    grasp = Grasp(load_scene("camera-100hz", {"path": "truth"}), tmp_path)
    grasp.recorder.wanted = True
    with grasp.session:
        until(lambda: len(grasp.shown) > 40)
    run = read_run(tmp_path / "001")
    assert len(run.columns["time_s"]) >= 40
    assert not (tmp_path / "001/.parts").exists()


def test_a_moment_is_no_recording(tmp_path: Path, until: Until) -> None:
    grasp = Grasp(load_scene("camera-100hz", {"path": "truth"}), tmp_path)
    grasp.recorder.wanted = True
    with grasp.session as session:
        until(lambda: len(grasp.shown) > 3)
        session.paused = True
        grasp.recorder.wanted = False
        until(lambda: len(grasp.told) > 1)
    assert "too short" in grasp.told[-1]
    assert list(tmp_path.iterdir()) == []


def test_where_no_folder_can_be_the_grasp_goes_on(tmp_path: Path, until: Until) -> None:
    (tmp_path / "file").write_text("")
    grasp = Grasp(load_scene("camera-100hz", {"path": "truth"}), tmp_path / "file")
    grasp.recorder.wanted = True
    with grasp.session:
        until(lambda: len(grasp.shown) > 10)
    assert grasp.told[-1].startswith("**not recorded:**")
    assert not grasp.recorder.wanted


@pytest.mark.loops
def test_another_grasp_ends_the_recording(tmp_path: Path, until: Until) -> None:
    grasp = Grasp(load_scene("camera-100hz", {"path": "truth"}), tmp_path)
    grasp.recorder.wanted = True
    with grasp.session as session:
        until(lambda: len(grasp.shown) > 40)
        session.ask(replace(session.sliders, latency=3))
        before = len(grasp.shown)
        until(lambda: len(grasp.shown) > before + 60)
    latencies = [read_run(tmp_path / name).scene.camera.latency_frames for name in ("001", "002")]
    assert latencies == [1, 3]


def test_a_mesh_is_kept_beside_its_recording(tmp_path: Path, until: Until) -> None:
    mesh = tmp_path / "dropped.stl"
    trimesh.creation.icosphere(subdivisions=3, radius=9.0).export(mesh)
    base = load_scene("dome-1", DOME)
    scene = scene_for(base, replace(slider_values(base), object=str(mesh)))
    grasp = Grasp(scene, tmp_path / "kept")
    grasp.recorder.wanted = True
    with grasp.session:
        until(lambda: len(grasp.shown) > 20)
    mesh.unlink()
    folder = (tmp_path / "kept").rename(tmp_path / "moved") / "001"
    run = read_run(folder)
    assert Path(run.scene.object.mesh) == folder / "object.stl"
    summary: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    assert summary[FROM] == 0.0
