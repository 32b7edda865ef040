"""Frames of a camera through OpenCV."""

import math
import os
import re
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import cv2
import numpy as np

from ..errors import UserError, meant
from ..render import Frame
from .source import ASSUMED, Source, rated

#: Settings in the order in which they are made: another size or rate may change the others.
_SETTINGS = {
    "width": cv2.CAP_PROP_FRAME_WIDTH,
    "height": cv2.CAP_PROP_FRAME_HEIGHT,
    "fps": cv2.CAP_PROP_FPS,
    "exposure": cv2.CAP_PROP_EXPOSURE,
    "gain": cv2.CAP_PROP_GAIN,
}


def camera_number(name: str) -> int | None:
    """Number of `camera:N`, of `/dev/videoN` or of a link to it; None for any other name."""
    path = os.path.realpath(name) if name.startswith("/dev/") else name
    found = re.fullmatch(r"(?:camera:|/dev/video)(\d+)", path)
    return int(found[1]) if found else None


def camera_source(name: str, number: int, settings: Mapping[str, Any], fps: float | None) -> Source:
    """Source of a camera.

    Parameters
    ----------
    name: that the user gave
    number: of the camera
    settings: what is set and read back: `width`, `height` [px], `fps` [Hz], `exposure` and `gain`
        in the driver's units
    fps: nominal rate, if it is not set [Hz]

    Raises
    ------
    UserError
        For an unknown setting.
    """
    for key, value in settings.items():
        if key not in _SETTINGS:
            question, known = meant(key, _SETTINGS), ", ".join(_SETTINGS)
            raise UserError(f"source {name} has no argument {key}{question}; it has {known}")
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise UserError(f"source {name}: {key} = {value!r}; expected a number")
    if ("width" in settings) != ("height" in settings):
        raise UserError(f"source {name}: width and height go together; give both")
    rate, rate_from = rated(fps or settings.get("fps"))
    return Source(
        name=name,
        frames=lambda: _frames(number, settings),
        count=None,
        fps=rate,
        fps_from="nominal" if rate_from == ASSUMED else rate_from,
        timed=True,
        live=True,
    )


@contextmanager
def _silent() -> Iterator[None]:
    """Keep OpenCV from writing to the terminal; our own error says what failed."""
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)


def _frames(number: int, settings: Mapping[str, float]) -> Iterator[Frame]:
    """Frames as they come, with the time since the first one."""
    with _silent():
        capture = cv2.VideoCapture(number)
    try:
        if not capture.isOpened():
            raise UserError(f"camera {number} cannot be opened; is it there, free and allowed?")
        with _silent():
            _set(capture, number, settings)
        begin, last, count = 0.0, -math.inf, 0
        while True:
            with _silent():
                found, image = capture.read()
            if not found:
                raise UserError(f"camera {number} gave no picture after {count} frames")
            last = max(last, _exposed(capture))
            begin = last if count == 0 else begin
            count += 1
            yield Frame(image=np.ascontiguousarray(image[..., ::-1], np.uint8), time=last - begin)
    finally:
        capture.release()


def _exposed(capture: cv2.VideoCapture) -> float:
    """Time of the last frame by `time.monotonic`: the driver's stamp, or now without one [s].

    Video4Linux stamps frames with that clock; other drivers give 0, or count from elsewhere.
    """
    now, longest = time.monotonic(), 10.0  # longest time that a frame may wait in the driver [s]
    stamp = 1e-3 * capture.get(cv2.CAP_PROP_POS_MSEC)
    return stamp if max(0.0, now - longest) < stamp <= now else now


def _set(capture: cv2.VideoCapture, number: int, settings: Mapping[str, float]) -> None:
    """Fix the settings of a camera, and refuse it where it has others afterwards."""
    asked = {key: float(settings[key]) for key in _SETTINGS if key in settings}
    wrong = []
    if "exposure" in asked:
        manual = 1.0 if capture.getBackendName() == "V4L2" else 0.0  # each driver has its own
        capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, manual)
        if (has := capture.get(cv2.CAP_PROP_AUTO_EXPOSURE)) not in (manual, -1.0):  # -1: none
            wrong.append(f"auto exposure off (it has {has:g}, off is {manual:g})")
    for key, value in asked.items():
        capture.set(_SETTINGS[key], value)
    for key, value in asked.items():
        has = capture.get(_SETTINGS[key])
        if not math.isclose(has, value, rel_tol=2e-3 if key == "fps" else 1e-6):
            wrong.append(f"{key} = {value:g} (it has {has:g})")
    if wrong:
        raise UserError(f"camera {number} did not take {', '.join(wrong)}")
