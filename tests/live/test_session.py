"""A live grasp follows its sliders, and refuses what makes no scene with a sentence."""

import math
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from chromagrip import UserError, load_scene
from chromagrip.live import session as module
from chromagrip.live.record import Recorder
from chromagrip.live.serve import check_port
from chromagrip.live.session import Session, Shown
from chromagrip.live.sliders import OBJECTS, SliderValues, scene_for, slider_values
from chromagrip.loop.rig import Rig
from chromagrip.scene.scene import Scene

DOME = {"path": "truth", "camera.rate_hz": 50.0, "fingertip.step_ms": 10.0}


class Watched:
    """What a session shows and tells."""

    def __init__(self) -> None:
        self.shown: list[Shown] = []
        self.told: list[str] = []
        self.kept: list[str] = []


@contextmanager
def live(scene: Scene) -> Iterator[tuple[Session, Watched]]:
    watched = Watched()
    recorder = Recorder(Path("runs"), watched.kept.append)
    with Session(scene, watched.shown.append, watched.told.append, recorder) as session:
        yield session, watched


def until(watched: Watched, count: int) -> Shown:
    """Frame after so many more."""
    wanted = len(watched.shown) + count
    for _ in range(2000):
        if len(watched.shown) >= wanted:
            return watched.shown[-1]
        time.sleep(0.02)
    raise AssertionError(f"{len(watched.shown)} of {wanted} frames; told {watched.told}")


@pytest.mark.parametrize("name", ["camera-100hz", "dome-1"])
def test_more_grip_presses_more(name: str) -> None:
    changes = DOME if name == "dome-1" else {"path": "truth"}
    with live(load_scene(name, changes)) as (session, watched):
        until(watched, 2)
        session.ask(replace(session.sliders, automatic=False, grip=1.0, load=0.0))
        weak = until(watched, 60).sample.field.total_normal
        session.ask(replace(session.sliders, grip=3.0))
        strong = until(watched, 60).sample.field.total_normal
    assert weak == pytest.approx(1.0, rel=0.05)
    assert strong == pytest.approx(3.0, rel=0.05)


@pytest.mark.loops
def test_load_twist_and_azimuth_of_a_dome() -> None:
    with live(load_scene("dome-1", DOME)) as (session, watched):
        until(watched, 2)
        pulled = replace(session.sliders, automatic=False, grip=4.0, load=0.5, azimuth=90.0)
        session.ask(replace(pulled, twist=0.0))
        sideways = until(watched, 80).sample
        session.ask(replace(pulled, twist=3.0))
        twisted = until(watched, 80).sample
    pull = sideways.field.friction.sum(axis=0)
    assert abs(pull[1]) == pytest.approx(0.5, rel=0.1)
    assert abs(pull[0]) < 0.05
    assert twisted.contact.turn > sideways.contact.turn + np.radians(0.5)


def test_slippery_objects_have_less_margin() -> None:
    with live(load_scene("camera-100hz", {"path": "truth"})) as (session, watched):
        until(watched, 2)
        held = replace(session.sliders, automatic=False, grip=2.0, load=0.4, friction=0.9)
        session.ask(held)
        rough = until(watched, 60).sample
        session.ask(replace(held, friction=0.4))
        smooth = until(watched, 60).sample
    assert rough.friction == pytest.approx(0.9)
    assert rough.field.safety_margin(0.9) > smooth.field.safety_margin(0.4) + 0.2


def test_what_restarts_begins_at_time_0() -> None:
    with live(load_scene("camera-100hz", {"path": "truth"})) as (session, watched):
        until(watched, 10)
        session.ask(replace(session.sliders, latency=3))
        until(watched, 3)
        assert watched.shown[-1].scene.camera.latency_frames == 3
        assert watched.shown[-1].sample.time < watched.shown[9].sample.time + 1.0
        times = [one.sample.time for one in watched.shown]
    assert min(times[5:]) == 0.0


@pytest.mark.parametrize("name", ["camera-100hz", "dome-1"])
@pytest.mark.parametrize("value", [math.nan, math.inf, 1e308, -1e308, -1.0])
def test_wishes_are_checked_like_a_file(name: str, value: float) -> None:
    base = load_scene(name, {"path": "truth"})
    keys = ("load", "friction", "stiffness", "noise", "latency")
    dome = ("azimuth", "twist", "tilt") if name == "dome-1" else ()
    for key in keys + dome:
        turned = key == "azimuth" and math.isfinite(value)  # any number of turns
        if turned or (value == -1.0 and key in ("load", "twist", "tilt")):
            continue
        with pytest.raises(UserError):
            scene_for(base, replace(slider_values(base), **{key: value}))


@pytest.mark.parametrize(
    ("bad", "sentence"),
    [
        ({"controller": "nobody"}, "nobody"),
        ({"latency": 3}, "the grasp failed (AttributeError: "),
    ],
)
def test_what_breaks_a_grasp_is_told_and_the_next_one_goes_on(
    bad: dict[str, Any], sentence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(base: Scene, sliders: SliderValues) -> Scene:
        return scene_for(base, sliders) if sliders.latency != 3 else base.nothing  # type: ignore[attr-defined]

    monkeypatch.setattr(module, "scene_for", broken)
    with live(load_scene("camera-100hz", {"path": "truth"})) as (session, watched):
        until(watched, 2)
        good = session.sliders
        session.ask(replace(good, **bad))
        for _ in range(200):
            if watched.told and watched.told[-1]:
                break
            time.sleep(0.02)
        assert sentence in watched.told[-1]
        session.ask(replace(good, controller="conservative"))
        until(watched, 3)
        session.check()
    assert watched.told[-1] == ""


def test_a_pause_stands_and_a_step_is_one_frame() -> None:
    with live(load_scene("camera-100hz", {"path": "truth"})) as (session, watched):
        until(watched, 3)
        session.paused = True
        time.sleep(0.2)
        standing = len(watched.shown)
        time.sleep(0.2)
        assert len(watched.shown) == standing
        session.step_once()
        until(watched, 1)
        time.sleep(0.2)
        assert len(watched.shown) == standing + 1


@pytest.mark.parametrize("name", list(OBJECTS))
def test_every_object_of_the_page_makes_a_scene(name: str) -> None:
    base = load_scene("dome-1", {"path": "truth"})
    scene = scene_for(base, replace(slider_values(base), object=name))
    scene.build_solid()


def test_a_port_in_use_is_a_sentence() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(UserError, match=r"port \d+ cannot be used: .*; choose another"):
            check_port("127.0.0.1", taken.getsockname()[1])


def test_a_pinch_is_refused() -> None:
    pinch = load_scene("pinch-lift")
    with pytest.raises(UserError, match="one finger"):
        scene_for(pinch, slider_values(load_scene("dome-1")))


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
