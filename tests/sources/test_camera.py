"""Cameras: their settings are read back, and what fails there is one sentence."""

import time
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest

from chromagrip import UserError
from chromagrip.sources import open_source

AUTO = cv2.CAP_PROP_AUTO_EXPOSURE


class Camera:
    """Stands in for OpenCV's capture; it takes a value unless it has one of its own."""

    own: ClassVar[dict[int, float]] = {}
    kind: ClassVar[str] = "V4L2"
    delays: ClassVar[list[float]] = []
    read_at: ClassVar[list[float]] = []
    sets: ClassVar[list[tuple[int, float]]] = []
    released: ClassVar[int] = 0

    def __init__(self, number: int) -> None:
        self.number, self.count, self.values = number, 0, dict[int, float]()

    def isOpened(self) -> bool:  # noqa: N802
        return self.number < 3

    def getBackendName(self) -> str:  # noqa: N802
        return self.kind

    def set(self, key: int, value: float) -> bool:
        self.sets.append((key, value))
        self.values[key] = value
        return True

    def get(self, key: int) -> float:
        if key == cv2.CAP_PROP_POS_MSEC:
            return 1e3 * (self.read_at[-1] - self.delays[self.count - 1]) if self.delays else 0.0
        return self.own.get(key, self.values.get(key, -1.0))

    def read(self) -> tuple[bool, Any]:
        self.count += 1
        self.read_at.append(time.monotonic())
        if self.count > 3:
            return False, None
        image = np.zeros((4, 6, 3), np.uint8)
        image[..., 0] = self.count  # blue
        return True, image

    def release(self) -> None:
        type(self).released += 1


@pytest.fixture(autouse=True)
def _camera(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2, "VideoCapture", Camera)
    for name in ("sets", "read_at"):
        monkeypatch.setattr(Camera, name, [])
    monkeypatch.setattr(Camera, "released", 0)


def test_a_camera_that_vanishes_gave_what_it_gave() -> None:
    frames = open_source("camera:0").frames()
    times = [next(frames).time for _ in range(3)]
    with pytest.raises(UserError, match=r"^camera 0 gave no picture after 3 frames$"):
        next(frames)
    assert times[0] == 0.0
    assert Camera.released == 1
    assert Camera.sets == []


@pytest.mark.parametrize(
    ("delays", "stamped"), [([0.05, 0.03, 0.01], True), ([60.0, 61.0, 62.0], False)]
)  # the second ones are of another clock
def test_the_time_of_a_frame_is_the_stamp_of_its_driver(
    delays: list[float], stamped: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Camera, "delays", delays)
    frames = open_source("camera:0").frames()
    times = np.array([next(frames).time for _ in delays])
    read = np.array(Camera.read_at)
    expected = read - delays if stamped else read
    np.testing.assert_allclose(times, expected - expected[0], atol=1e-9 if stamped else 0.5)
    assert (np.abs(times - (read - read[0])) < 0.005).all() != stamped


def test_settings_are_made_and_read_back() -> None:
    source = open_source("/dev/video2(exposure=120, gain=3, fps=60, width=640, height=480)")
    assert (source.fps, source.fps_from) == (60, "given")
    assert next(source.frames()).image.shape == (4, 6, 3)
    keys = [key for key, _ in Camera.sets]
    assert dict(Camera.sets) == {
        AUTO: 1.0,
        cv2.CAP_PROP_EXPOSURE: 120.0,
        cv2.CAP_PROP_GAIN: 3.0,
        cv2.CAP_PROP_FPS: 60.0,
        cv2.CAP_PROP_FRAME_WIDTH: 640.0,
        cv2.CAP_PROP_FRAME_HEIGHT: 480.0,
    }
    assert keys.index(AUTO) < keys.index(cv2.CAP_PROP_EXPOSURE)


@pytest.mark.parametrize(
    ("own", "words"),
    [
        ({cv2.CAP_PROP_FRAME_HEIGHT: 360.0, cv2.CAP_PROP_EXPOSURE: 156.0},
         r"did not take height = 480 \(it has 360\), exposure = 120 \(it has 156\)$"),
        ({AUTO: 3.0}, r"did not take auto exposure off \(it has 3, off is 1\)$"),
    ],
)  # fmt: skip
def test_what_a_camera_does_not_take_is_one_sentence(
    own: dict[int, float], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Camera, "own", own)
    source = open_source("camera:0(exposure=120, fps=60, width=640, height=480)")
    with pytest.raises(UserError, match=f"^camera 0 {words}"):
        next(source.frames())
    assert Camera.released == 1


@pytest.mark.parametrize(
    ("own", "kind"),
    [
        ({cv2.CAP_PROP_FPS: 59.94}, "V4L2"),  # the rate of a video camera that is called 60
        ({AUTO: -1.0}, "V4L2"),  # has no automatic exposure
        ({AUTO: 0.0}, "MSMF"),
    ],
)
def test_what_is_as_good_is_taken(
    own: dict[int, float], kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Camera, "own", own)
    monkeypatch.setattr(Camera, "kind", kind)
    next(open_source("camera:0(exposure=120, fps=60)").frames())


def test_a_camera_that_is_not_there() -> None:
    with pytest.raises(UserError, match="camera 7 cannot be opened"):
        next(open_source("camera:7").frames())
