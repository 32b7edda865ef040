"""Raw pictures of a grasp: they are what the camera took, each with its instant."""

import csv
import errno
import os
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any, Literal

import numpy as np
import pytest

import chromagrip
from chromagrip import Scene, UserError, load_scene, run
from chromagrip.control import GripCommand, GripObservation
from chromagrip.loop import grasp, open_camera
from chromagrip.loop.rig import Rig
from chromagrip.loop.run_files import RunFiles
from chromagrip.sources import open_source
from chromagrip.sources.picture_files import read_picture

from .test_pinch import COARSE

KINDS: tuple[Literal["png", "ffv1"], ...] = ("png", "ffv1")
QUICK = {"duration_s": 0.08, "camera.rest_frames": 2, "camera.dropped": 0.4}


def listed(folder: Path) -> list[dict[str, str]]:
    with (folder / "frames.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def taken(scene: Scene) -> dict[int, np.ndarray]:
    with closing(open_camera(scene)) as camera:
        return {s.index: s.frame.image for s in grasp(scene, camera) if s.frame is not None}


@pytest.mark.parametrize("kind", KINDS)
def test_pictures_lose_nothing(kind: Literal["png", "ffv1"], tmp_path: Path) -> None:
    scene = load_scene("camera-100hz", QUICK)
    run(scene, tmp_path / "run", frames=kind)
    folder, expected = tmp_path / "run/frames", taken(scene)
    assert 0 < len(expected) < scene.frames
    rows = listed(folder)
    assert [int(row["frame"]) for row in rows] == list(expected)
    assert [float(row["time_s"]) for row in rows] == [index * scene.period for index in expected]
    name = str(folder / "frames.mkv") if kind == "ffv1" else str(folder)
    source = open_source(name, without=folder / "rest.png" if kind == "png" else None)
    assert not source.lossy
    read = list(source.frames())
    for frame, image in zip(read, expected.values(), strict=True):
        np.testing.assert_array_equal(frame.image, image)
    times, exact = [frame.time for frame in read], [index * scene.period for index in expected]
    if kind == "ffv1":  # Matroska counts milliseconds
        assert times == pytest.approx(exact, abs=1e-3)
    else:
        assert times == exact
    rest = read_picture(folder / "rest.png")
    assert np.abs(rest.astype(float) - expected[0]).mean() < 5.0  # two draws of the noise
    assert (rest != expected[0]).any()


def test_the_truth_path_has_pictures_too_and_a_run_without_them_none(tmp_path: Path) -> None:
    scene = load_scene("camera-100hz", {"path": "truth", "duration_s": 0.03})
    run(scene, tmp_path, frames="png")
    assert [row["file"] for row in listed(tmp_path / "frames")] == [
        f"frame-{k:06d}.png" for k in range(4)
    ]
    run(scene, tmp_path, overwrite=True)
    assert not (tmp_path / "frames").exists()
    with pytest.raises(UserError, match="pictures as png need a folder"):
        run(scene, frames="png")


@pytest.mark.loops
@pytest.mark.parametrize("light", [{"camera.exposure_ms": 15.0}, {"defects.motion_blur": 0.5}])
@pytest.mark.parametrize("name", ["camera-100hz", "pinch-lift"])
def test_a_run_keeps_the_pictures_that_a_rig_gives(
    name: str, light: dict[str, float], tmp_path: Path
) -> None:
    """They show the middle of the exposure, also on the truth path, whichever were asked for."""
    changes = COARSE if name == "pinch-lift" else {"path": "truth"}
    changes = {**changes, "controller": "conservative", "camera.rate_hz": 60.0, "duration_s": 0.1}
    scene = load_scene(name, {**changes, **light})
    run(scene, tmp_path / "run", frames="png")
    folder = tmp_path / "run" / "frames"
    folders = [folder / "first", folder / "second"] if scene.pinch.mass_g else [folder]
    with chromagrip.open(scene) as rig:
        rig.reset()
        while not rig.done:
            rig.step(scene.conservative.force_n)
            if rig.index % 2:
                continue
            for place, picture in zip(folders, rig.pictures(), strict=True):
                kept = read_picture(place / f"frame-{rig.index:06d}.png")
                np.testing.assert_array_equal(kept, picture.image)


class Ends:
    """Ends the run at the third frame."""

    error: type[BaseException] = KeyboardInterrupt

    def reset(self) -> None:
        pass

    def command(self, observation: GripObservation) -> GripCommand:
        if observation.time > 0.015:
            raise self.error
        return GripCommand(force=1.0)


@pytest.mark.parametrize("kind", KINDS)
def test_an_interruption_keeps_the_pictures_until_then(
    kind: Literal["png", "ffv1"], tmp_path: Path
) -> None:
    scene = load_scene("camera-100hz", {"camera.rest_frames": 2, "camera.latency_frames": 0})
    with pytest.raises(KeyboardInterrupt):
        run(scene, tmp_path, frames=kind, controller=Ends())
    assert len(listed(tmp_path / "frames")) == 2
    name = tmp_path / "frames" / ("frames.mkv" if kind == "ffv1" else "frame-000001.png")
    assert len(list(open_source(str(name)).frames())) == (2 if kind == "ffv1" else 1)


def test_a_full_disk_leaves_no_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    scene = load_scene("camera-100hz", {"path": "truth", "duration_s": 0.03})
    with pytest.raises(UserError, match=r"cannot be written: No space left on device$"):
        run(scene, tmp_path / "run", frames="png")
    assert not (tmp_path / "run").exists()


def test_from_the_command_line(typed: Callable[..., CompletedProcess[str]], tmp_path: Path) -> None:
    line = ["grasp", "thesis", "--path", "truth", "--set", "duration_s=0.002", "--frames", "png"]
    assert typed(*line, "--out", "run").returncode == 0
    assert len(list((tmp_path / "run/frames").glob("frame-*.png"))) == 3
    done = typed(*line, "--json")
    assert done.returncode == 2
    assert "--frames png needs a folder: give --out as well as --json" in done.stderr
    assert typed(*line[:-1], "gif").returncode == 2


@pytest.mark.parametrize("kind", ["png", pytest.param("ffv1", marks=pytest.mark.loops)])
def test_both_cameras_of_a_pinch_lose_nothing(kind: Literal["png", "ffv1"], tmp_path: Path) -> None:
    changes = {**COARSE, "duration_s": 0.08, "camera.dropped": 0.4}
    scene = load_scene("pinch-lift", {**changes, "controller": "conservative"})
    run(scene, tmp_path / "run", frames=kind)
    rig = Rig(scene)
    rig.reset()
    expected = {}
    while True:
        if rig.readings[0].observation is not None:
            expected[rig.index] = rig.pictures()
        if rig.done:
            break
        rig.step(scene.conservative.force_n)
    rest = rig.rest_pictures()
    rig.close()
    assert 0 < len(expected) < scene.frames
    for k, finger in enumerate(("first", "second")):
        folder = tmp_path / "run" / "frames" / finger
        rows = listed(folder)
        assert [int(row["frame"]) for row in rows] == list(expected)
        times = [float(row["time_s"]) for row in rows]
        assert times == pytest.approx([index * scene.period for index in expected])
        name = str(folder / "frames.mkv") if kind == "ffv1" else str(folder)
        source = open_source(name, without=folder / "rest.png" if kind == "png" else None)
        for frame, pictures in zip(source.frames(), expected.values(), strict=True):
            np.testing.assert_array_equal(frame.image, pictures[k].image)
        np.testing.assert_array_equal(read_picture(folder / "rest.png"), rest[k].image)
    assert not np.array_equal(rest[0].image, rest[1].image)
    with RunFiles(tmp_path / "run", True, scene):
        assert not (tmp_path / "run" / "frames").exists()
    with pytest.raises(UserError, match=f"pictures as {kind} need a folder"):
        run(scene, frames=kind)
