"""The video of a pinch: both cameras with their tractions, the scene, and margins over time."""

import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ...model import ForceField
from ...output.video import VideoFile
from ...render import Frame
from ...scene.fingers import build_pinch, fingers
from ...scene.scene import Scene
from ...sensing.reader import Reading
from ..column import OUTCOMES
from ..results.dome_picture import STICKS, ZOOM, TractionPicture, write
from ..results.tactile_video import FPS, NO_ESTIMATE, QUALITY, SEEKABLE, SLOWDOWN
from ..sample import Sample
from ..trace import word_for_read
from .course_plot import CoursePlot, Courses
from .stage import FINGER_COLOURS, INK, draw_along, draw_side, set_stage

Image = NDArray[np.uint8]
Colour = tuple[int, int, int]

#: Width of a picture [px].
WIDTH = 1280
#: Height of a picture [px].
HEIGHT = 720
#: Height of the line of text above [px].
HEAD = 32
#: Side of a camera's picture and of a traction [px].
SIDE = 232
#: Width and height of the scene from the side [px].
SCENE = (1280 - 3 * SIDE, 2 * SIDE)
#: Size of the plots [px].
PLOTS = (WIDTH, HEIGHT - HEAD - 2 * SIDE)


class PinchVideo(VideoFile):
    """Video of a pinch: 1280 × 720, at the rate and the slow-down of a grasp's video.

    Everything is turned so that a finger's x, along which the weight acts, points down. Cameras
    and tractions show the view from inside the finger.

    Parameters
    ----------
    path: path of the video
    scene: scene of two fingers
    """

    def __init__(self, path: Path, scene: Scene) -> None:
        super().__init__(path, FPS, QUALITY, SEEKABLE)
        self._scene, self._camera = scene, scene.path == "camera"
        pinch = build_pinch(scene)
        caption = 22  # height of the text below the view along the pinch [px]
        self.stage = set_stage(pinch, scene.duration_s, SCENE, (SIDE, SIDE - caption))
        domes = [each.build_sensor().dome for each in fingers(scene)] if self._camera else []
        self._tractions = [
            TractionPicture(dome, ZOOM * SIDE) for dome in domes or (pinch.first, pinch.second)
        ]
        self._zoomed = True
        self.courses = Courses()
        self.plot = CoursePlot(
            PLOTS, scene.duration_s, scene.target_margin, word_for_read(scene.path)
        )
        self._start = math.nan
        self._slot = -1

    def due(self, sample: Sample) -> bool:
        """Add a frame to the plots; returns True if its picture is due."""
        if not self.courses.times:
            self._start = float(sample.pinch.state.moving.place[0])
        self.courses.add(sample)
        slot = int(sample.time * FPS * SLOWDOWN + 1e-6)
        due = slot > self._slot and all(each.observation is not None for each in sample.readings)
        self._slot = slot if due else self._slot
        return due

    def show(self, sample: Sample, frames: Sequence[Frame]) -> None:
        """Append the picture of a frame that was added by `due`."""
        self.append(self.compose(sample, frames), self._slot)

    def compose(self, sample: Sample, frames: Sequence[Frame]) -> Image:
        """Compose the picture of a frame, RGB, (720, 1280, 3)."""
        whole = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
        tractions = self._draw_tractions(sample)
        for k, left in enumerate((0, WIDTH - SIDE)):
            camera = _upright(frames[k].image)
            write(camera, f"finger {k + 1}", (6, 15), _shade(FINGER_COLOURS[k]))
            write(camera, "camera", (SIDE - 56, 15), (230, 230, 230))
            _put(whole, camera, (left, HEAD))
            _put(whole, tractions[k], (left, HEAD + SIDE))
        _put(whole, draw_side(self.stage, sample.pinch), (SIDE, HEAD))
        column = SIDE + SCENE[0]
        _put(whole, draw_along(self.stage, sample.pinch), (column, HEAD))
        write(whole, "along the pinch, from finger 1", (column + 8, HEAD + SIDE - 6), INK)
        _put(whole, self._legend(sample), (column, HEAD + SIDE))
        _put(whole, self.plot.draw(self.courses), (0, HEAD + 2 * SIDE))
        self._head(whole, sample)
        return whole

    def _draw_tractions(self, sample: Sample) -> list[Image]:
        """Draw both tractions, with one scale, from the cameras' side."""
        shown: list[tuple[ForceField, float]] = []
        for contact, reading in zip(sample.pinch.fingers, sample.readings, strict=True):
            observation = reading.observation
            if self._camera and observation is not None:
                shown.append((observation.field, observation.friction))
            else:
                shown.append((contact.field, contact.friction))
        for _ in range(2):  # once more if the scale of one has grown
            pictures = [
                each.draw(*values) for each, values in zip(self._tractions, shown, strict=True)
            ]
            top = max(each.top for each in self._tractions)
            if all(each.top == top for each in self._tractions):
                break
            for each in self._tractions:
                each.top = top
        self._zoomed &= all(
            each.in_middle(field) for each, (field, _) in zip(self._tractions, shown, strict=True)
        )
        drawn = zip(self._tractions, pictures, sample.readings, strict=True)
        return [self._shown(*each) for each in drawn]

    def _shown(self, traction: TractionPicture, picture: Image, reading: Reading) -> Image:
        """Turn a traction to the camera's side, and add its name and a scale."""
        turned = np.ascontiguousarray(picture.transpose(1, 0, 2))
        turned = traction.part(turned, self._zoomed)
        write(turned, "estimated traction" if self._camera else "true traction", (6, 14), INK)
        if self._camera and reading.no_estimate:
            write(turned, "no estimate", (6, 34), NO_ESTIMATE)
        cv2.rectangle(turned, (0, 0), (SIDE - 1, SIDE - 1), (215, 215, 215), 1)
        return turned

    def _legend(self, sample: Sample) -> Image:
        legend = np.full((SIDE, SIDE, 3), 255, np.uint8)
        truth = sample.pinch.record
        lines = (
            "the object in truth:",
            f"rise {1e3 * self._rise(sample):z.1f} mm",
            f"slid by {1e3 * truth.slide:.2f} mm",
            f"turned by {math.degrees(truth.turn):z.1f} deg",
            f"skins twisted by {math.degrees(truth.elastic):z.1f} deg",
            f"mean pressure {1e-3 * truth.pressure:.0f} kPa",
        )
        for k, line in enumerate(lines):
            write(legend, line, (10, 16 + 19 * k), INK)
        self._tractions[0].legend(legend, (10, 30 + 19 * len(lines)), self._zoomed)
        return legend

    def _rise(self, sample: Sample) -> float:
        """Rise of the centre of mass since the start [m]; x is down."""
        return self._start - float(sample.pinch.state.moving.place[0])

    def _head(self, whole: Image, sample: Sample) -> None:
        """Write the line of text above the pictures."""
        scene = self._scene
        outcome = sample.pinch.record.outcome(scene.pinch.limits)
        weight = 9.81 * self.stage.pinch.body_at(sample.time).mass
        good, bad = (30, 120, 60), (200, 40, 40)
        words = (
            (f"t = {sample.time:.2f} s", 8, STICKS),
            (f"grip {sample.grip:.2f} N", 180, STICKS),
            (f"weight {weight:.2f} N", 350, STICKS),
            (f"so far: {outcome}", 530, good if outcome == OUTCOMES[0] else bad),
            (f"{scene.controller}, {scene.path} path", 720, INK),
            (f"shown {SLOWDOWN} times slower", 1065, INK),
        )
        for text, column, colour in words:
            cv2.putText(
                whole, text, (column, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.58, colour, 1, cv2.LINE_AA
            )


def _upright(image: Image) -> Image:
    """Crop the middle of a camera's picture, and turn the finger's x downwards."""
    height, width = image.shape[:2]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    middle = image[top : top + side, left : left + side]
    turned = np.ascontiguousarray(np.rot90(middle, -1))
    return np.asarray(cv2.resize(turned, (SIDE, SIDE), interpolation=cv2.INTER_AREA), np.uint8)


def _shade(colour: Colour) -> Colour:
    """Lighter colour, readable on black."""
    red, green, blue = (min(255, value + 60) for value in colour)
    return red, green, blue


def _put(whole: Image, part: Image, at: tuple[int, int]) -> None:
    x, y = at
    whole[y : y + part.shape[0], x : x + part.shape[1]] = part
