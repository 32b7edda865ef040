"""Raw pictures of a grasp: they are what the camera took, each with its instant."""

import csv
from contextlib import closing
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from chromagrip import UserError, load_scene, run
from chromagrip.control import GripCommand, GripObservation
from chromagrip.loop.rig import Rig
from chromagrip.loop.run_files import RunFiles
from chromagrip.sources import open_source
from chromagrip.sources.picture_files import read_picture

from .test_pinch import COARSE


def listed(folder: Path) -> list[dict[str, str]]:
    with (folder / "frames.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("kind", ["ffv1", pytest.param("png", marks=pytest.mark.loops)])
@pytest.mark.parametrize(
    ("name", "light"),
    [
        ("camera-100hz", {"camera.exposure_ms": 8.0}),
        pytest.param("pinch-lift", {"defects.motion_blur": 0.5}, marks=pytest.mark.loops),
    ],
)
def test_pictures_lose_nothing(
    kind: Literal["png", "ffv1"], name: str, light: dict[str, float], tmp_path: Path
) -> None:
    """They show the middle of the exposure, also on the truth path; dropped ones are left out."""
    changes = COARSE if name == "pinch-lift" else {"path": "truth"}
    changes = {**changes, "controller": "conservative", "duration_s": 0.05, **light}
    scene = load_scene(name, changes | {"camera.rest_frames": 2, "camera.dropped": 0.4})
    run(scene, tmp_path / "run", frames=kind)
    folder, expected = tmp_path / "run" / "frames", {}
    with closing(Rig(scene)) as rig:
        rig.reset()
        while True:
            if rig.readings[0].observation is not None:
                expected[rig.index] = [one.image for one in rig.pictures()]
            if rig.done:
                break
            rig.step(scene.conservative.force_n)
        rest = [one.image for one in rig.rest_pictures()]
    assert 0 < len(expected) < scene.frames
    fingers = [folder] if scene.fingers == 1 else [folder / "first", folder / "second"]
    for k, place in enumerate(fingers):
        rows = listed(place)
        assert [int(row["frame"]) for row in rows] == list(expected)
        exact = [index * scene.period for index in expected]
        assert [float(row["time_s"]) for row in rows] == pytest.approx(exact, abs=1e-12)
        source = open_source(str(place / "frames.mkv" if kind == "ffv1" else place))
        if kind == "png":
            source = open_source(str(place), without=place / "rest.png")
        assert not source.lossy
        read = list(source.frames())
        for frame, images in zip(read, expected.values(), strict=True):
            np.testing.assert_array_equal(frame.image, images[k])
        # Matroska counts milliseconds.
        assert [frame.time for frame in read] == pytest.approx(exact, abs=1e-3)
        np.testing.assert_array_equal(read_picture(place / "rest.png"), rest[k])
        assert (rest[k] != expected[0][k]).any()  # two draws of the noise
    with RunFiles(tmp_path / "run", True, scene):
        assert not folder.exists()


def test_pictures_need_a_folder() -> None:
    with pytest.raises(UserError, match="pictures as png need a folder"):
        run(load_scene("camera-100hz", {"path": "truth"}), frames="png")


class Ends:
    """Ends the run at the third frame."""

    def reset(self) -> None: ...

    def command(self, observation: GripObservation) -> GripCommand:
        if observation.time > 0.015:
            raise KeyboardInterrupt
        return GripCommand(force=1.0)


@pytest.mark.loops
def test_an_interruption_keeps_the_pictures_until_then(tmp_path: Path) -> None:
    scene = load_scene("camera-100hz", {"path": "truth", "camera.latency_frames": 0})
    with pytest.raises(KeyboardInterrupt):
        run(scene, tmp_path, frames="ffv1", controller=Ends())
    assert len(listed(tmp_path / "frames")) == 2
    assert len(list(open_source(str(tmp_path / "frames/frames.mkv")).frames())) == 2
