"""A live grasp follows its sliders, and refuses what makes no scene with a sentence."""

import csv
import json
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import trimesh

from chromagrip import UserError, load_scene
from chromagrip.live import session as module
from chromagrip.live.record import FROM, Recorder
from chromagrip.live.session import Session, Shown
from chromagrip.live.sliders import OBJECTS, SliderValues, scene_for, slider_values
from chromagrip.loop.results.run_folder import read_run
from chromagrip.loop.rig import Rig
from chromagrip.scene.scene import Scene

TRUTH = {"path": "truth"}
DOME = {"path": "truth", "camera.rate_hz": 50.0, "fingertip.step_ms": 10.0}
Until = Callable[..., None]


class Watched:
    """What a session shows and tells."""

    def __init__(self, folder: Path) -> None:
        self.shown: list[Shown] = []
        self.told: list[str] = []
        self.kept: list[str] = []
        self.recorder = Recorder(folder, self.kept.append)


@contextmanager
def live(
    scene: Scene, folder: Path = Path("runs"), record: bool = False
) -> Iterator[tuple[Session, Watched]]:
    """A session; `record` is whether it records from the start."""
    watched = Watched(folder)
    watched.recorder.wanted = record
    with Session(scene, watched.shown.append, watched.told.append, watched.recorder) as session:
        yield session, watched


def later(watched: Watched, count: int) -> Shown:
    """Frame after so many more."""
    wanted = len(watched.shown) + count
    for _ in range(2000):
        if len(watched.shown) >= wanted:
            return watched.shown[-1]
        time.sleep(0.02)
    raise AssertionError(f"{len(watched.shown)} of {wanted} frames; told {watched.told}")


@pytest.mark.parametrize("name", ["camera-100hz", pytest.param("dome-1", marks=pytest.mark.loops)])
def test_more_grip_presses_more(name: str) -> None:
    changes = DOME if name == "dome-1" else {"path": "truth"}
    with live(load_scene(name, changes)) as (session, watched):
        later(watched, 2)
        session.ask(replace(session.sliders, automatic=False, grip=1.0, load=0.0))
        weak = later(watched, 60).sample.field.total_normal
        session.ask(replace(session.sliders, grip=3.0))
        strong = later(watched, 60).sample.field.total_normal
    assert weak == pytest.approx(1.0, rel=0.05)
    assert strong == pytest.approx(3.0, rel=0.05)


def test_slippery_objects_have_less_margin_and_a_restart_begins_at_time_0() -> None:
    with live(load_scene("camera-100hz", TRUTH)) as (session, watched):
        later(watched, 2)
        held = replace(session.sliders, automatic=False, grip=2.0, load=0.4, friction=0.9)
        session.ask(held)
        rough = later(watched, 60).sample
        session.ask(replace(held, friction=0.4))
        smooth = later(watched, 60).sample
        before = len(watched.shown)
        session.ask(replace(held, latency=3))
        later(watched, 3)
        assert watched.shown[-1].scene.camera.latency_frames == 3
        times = [one.sample.time for one in watched.shown[before:]]
        speeds = [
            one.speed for one in watched.shown
        ]  # the last frame of a session is not waited for
    assert rough.friction == pytest.approx(0.9)
    assert rough.field.safety_margin(0.9) > smooth.field.safety_margin(0.4) + 0.2
    assert min(times) == 0.0
    assert times[-1] < 1.0
    # It never runs ahead of the clock.
    assert 0.0 < max(speeds) < 1.05


def test_wishes_are_checked_like_a_file() -> None:
    for name in ("camera-100hz", "dome-1"):
        base = load_scene(name, {"path": "truth"})
        for key, value in product(("load", "friction", "stiffness", "latency"), (math.nan, 1e308)):
            with pytest.raises(UserError):
                scene_for(base, replace(slider_values(base), **{key: value}))
    base = load_scene("dome-1", {"path": "truth", "object.radius_mm": 9.0})
    for name in OBJECTS:
        scene_for(base, replace(slider_values(base), object=name)).build_solid()
    pulled = replace(slider_values(base), load=0.5, azimuth=30.0, twist=3.0)
    load = scene_for(base, pulled).load
    assert load.forces_n == pytest.approx((0.5 * math.cos(math.pi / 6),))
    assert load.sideways_n == pytest.approx((0.25,))
    assert load.twists_nmm == pytest.approx((3.0,))
    # Nothing is left of the object before.
    boxed = scene_for(base, replace(slider_values(base), object="box"))
    again = scene_for(boxed, replace(slider_values(base), object="torus"))
    assert (again.object.shape, again.object.rounding_mm) == ("torus", 0.0)
    with pytest.raises(UserError, match="one finger"):
        scene_for(load_scene("pinch-lift"), slider_values(base))


def test_what_breaks_a_grasp_is_told_and_the_next_one_goes_on(
    monkeypatch: pytest.MonkeyPatch, until: Until
) -> None:
    def broken(base: Scene, sliders: SliderValues) -> Scene:
        return scene_for(base, sliders) if sliders.latency != 3 else base.nothing  # type: ignore[attr-defined]

    monkeypatch.setattr(module, "scene_for", broken)
    with live(load_scene("camera-100hz", TRUTH)) as (session, watched):
        later(watched, 2)
        good = session.sliders
        for key, bad, sentence in (
            ("controller", "nobody", "nobody"),
            ("latency", 3, "the grasp failed (AttributeError: "),
        ):
            session.ask(replace(good, **{key: bad}))
            until(lambda sentence=sentence: sentence in "".join(watched.told[-1:]))
            session.ask(replace(good, controller="conservative"))
            later(watched, 3)
            session.check()
            assert watched.told[-1] == ""


def test_a_pause_stands_and_a_step_is_one_frame() -> None:
    with live(load_scene("camera-100hz", TRUTH)) as (session, watched):
        later(watched, 3)
        session.paused = True
        time.sleep(0.2)
        standing = len(watched.shown)
        time.sleep(0.2)
        assert len(watched.shown) == standing
        session.step_once()
        later(watched, 1)
        time.sleep(0.2)
        assert len(watched.shown) == standing + 1


@pytest.mark.parametrize("name", ["camera-100hz", "dome-1"])
def test_a_changed_load_acts_as_one_that_was_planned(name: str) -> None:
    """From the frame of the change on, the forces are those of a scene with that step of load."""
    dome = {"load.twists_nmm": [0.0, 0.0], "body": "dome"} if name == "dome-1" else {}
    shared = {"path": "truth", "duration_s": 0.4, "camera.rate_hz": 100.0}
    planned = load_scene(
        name, shared | dome | {"load.times_s": [0.0, 0.2], "load.forces_n": [0.1, 0.5]}
    )
    before = msgspec.structs.replace(planned.load, forces_n=(0.1, 0.1))
    rig = Rig(msgspec.structs.replace(planned, load=before))
    rig.reset()
    whole = Rig(planned)
    whole.reset()
    while not rig.done:
        if rig.index == 20:
            rig.change(planned)
        rig.step(2.0)
        whole.step(2.0)
        assert rig.truth.field.total_friction == whole.truth.field.total_friction
    assert rig.truth.field.total_friction > 0.3


def test_what_cannot_change_is_refused() -> None:
    scene = load_scene("dome-1", {"path": "truth", "load.twists_nmm": [0.0, 0.0, 0.0]})
    rig = Rig(scene)
    with pytest.raises(UserError, match="before reset"):
        rig.change(scene)
    rig.reset()
    with pytest.raises(UserError, match=r"only load, object\.friction and object\.stiffness_kpa"):
        rig.change(msgspec.structs.replace(scene, seed=3))
    turned = msgspec.structs.replace(scene.load, twists_nmm=(0.0, 1.0, 1.0))
    with pytest.raises(UserError, match="cannot move along rz"):
        rig.change(msgspec.structs.replace(scene, load=turned))


@pytest.mark.loops
def test_a_recording_is_a_run_with_its_sliders_as_steps(tmp_path: Path, until: Until) -> None:
    with live(load_scene("dome-1", DOME), tmp_path / "kept") as (session, watched):
        session.ask(replace(session.sliders, automatic=False, grip=3.0, load=0.2, twist=0.0))
        later(watched, 30)
        watched.recorder.wanted = True
        later(watched, 20)
        session.ask(replace(session.sliders, load=0.5, twist=2.0, friction=0.7))
        later(watched, 20)
        watched.recorder.wanted = False
        until(lambda: watched.kept[-1].startswith("recorded"))
    folder = tmp_path / "kept/001"
    run = read_run(folder)
    assert {"report.html", "sliders.csv", "tactile.mp4"} < {f.name for f in folder.iterdir()}
    of = run.columns
    assert of["time_s"][0] == 0.0
    np.testing.assert_allclose(np.diff(of["time_s"]), 0.02, atol=1e-9)
    by_time = {one.sample.time: one.sample for one in watched.shown}
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


def test_a_moment_is_no_recording(tmp_path: Path, until: Until) -> None:
    with live(load_scene("camera-100hz", TRUTH), tmp_path, record=True) as (session, watched):
        later(watched, 3)
        session.paused = True
        watched.recorder.wanted = False
        until(lambda: len(watched.kept) > 1)
    assert "too short" in watched.kept[-1]
    assert list(tmp_path.iterdir()) == []


def test_where_no_folder_can_be_the_grasp_goes_on(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with live(load_scene("camera-100hz", TRUTH), tmp_path / "file", record=True) as (_, watched):
        later(watched, 10)
    assert watched.kept[-1].startswith("**not recorded:**")
    assert not watched.recorder.wanted


@pytest.mark.loops
def test_another_grasp_and_a_server_that_stops_end_the_recording(tmp_path: Path) -> None:
    with live(load_scene("camera-100hz", TRUTH), tmp_path, record=True) as (session, watched):
        later(watched, 42)
        session.ask(replace(session.sliders, latency=3))
        later(watched, 60)
    runs = [read_run(tmp_path / name) for name in ("001", "002")]
    assert [one.scene.camera.latency_frames for one in runs] == [1, 3]
    assert len(runs[0].columns["time_s"]) >= 40
    assert not list(tmp_path.glob("*/.parts"))


@pytest.mark.loops
def test_a_mesh_is_kept_beside_its_recording(tmp_path: Path) -> None:
    mesh = tmp_path / "dropped.stl"
    trimesh.creation.icosphere(subdivisions=3, radius=9.0).export(mesh)
    base = load_scene("dome-1", DOME)
    scene = scene_for(base, replace(slider_values(base), object=str(mesh)))
    with live(scene, tmp_path / "kept", record=True) as (_, watched):
        later(watched, 20)
    mesh.unlink()
    folder = (tmp_path / "kept").rename(tmp_path / "moved") / "001"
    run = read_run(folder)
    assert Path(run.scene.object.mesh) == folder / "object.stl"
    summary: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    assert summary[FROM] == 0.0
