"""The tactile video: the camera's image beside the forces that were estimated from it.

Beside the image of a dome it shows the traction from above: the estimated one on the camera path.
"""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..model import REFERENCE_NODES, ForceField, margin_within
from ..output.video import VideoFile
from ..render import View
from ..scene.scene import Scene
from ..tracking import Tracks
from .dome_picture import TractionPicture, write
from .steps.sample import Sample

Image = NDArray[np.uint8]

#: Pictures per second of the video [Hz].
FPS = 25
#: Rate factor of the encoder; lower is better.
QUALITY = 20
#: The video is this many times slower than the run.
SLOWDOWN = 4
#: A picture in so many is complete, so that a player reaches any quickly.
SEEKABLE = {"g": "25"}
#: Length of a force arrow at 251 nodes [px/N].
ARROW = 1200.0
#: Width of the text beside a dome's traction [px].
TEXT_WIDTH = 192
#: Factor by which displacements of markers are magnified.
MAGNIFY = 4.0

Colour = tuple[int, int, int]
#: Colours of forces and markers' motion, RGB.
FORCE_COLOUR: Colour = (30, 60, 200)
TRACK_COLOUR: Colour = (0, 130, 60)


class TactileVideo(VideoFile):
    """Pairs of pictures: the camera's image, and forces and markers' motion on it.

    Parameters
    ----------
    path: of the video
    scene: its sensor's camera maps the forces onto the picture
    """

    def __init__(self, path: Path, scene: Scene) -> None:
        super().__init__(path, FPS, QUALITY, SEEKABLE)
        self._view = scene.build_sensor().view
        self._traction: TractionPicture | None = None
        if scene.body == "dome":  # the estimator's dome is the sensor's, the true one the scene's
            seen = scene.path == "camera"
            self._traction = TractionPicture(
                scene.build_sensor().dome if seen else scene.build_dome()
            )

    def slot(self, time: float) -> int:
        """Number of the video's picture at a time [s]."""
        return int(time * FPS * SLOWDOWN + 1e-6)

    def add_traction(self, image: Image, sample: Sample) -> None:
        """Append one sample of a dome with its image, and its traction as it was estimated."""
        assert self._traction is not None
        assert sample.observation is not None
        seen = sample.tracks is not None
        field = sample.observation.field if seen else sample.field
        mu = sample.observation.friction if seen else sample.friction
        picture = self._traction.draw(field, mu)
        write(picture, f"{'estimated' if seen else 'true'} traction", (8, 18))
        column = np.full((picture.shape[0], TEXT_WIDTH, 3), 255, np.uint8)
        lines = (
            f"t {sample.time:.2f} s",
            f"load {sample.load:.2f} N",
            f"grip {sample.grip:.2f} N",
            "",
            *(_sums("estimated", field, mu) if seen else ()),
            *_sums("true", sample.field, sample.friction),
            f"object x {1e3 * sample.truth.place[0]:.2f} mm",
            f"depth {1e3 * sample.truth.indentation:.2f} mm",
            f"turn {np.degrees(sample.truth.turn):.1f} deg",
        )
        for k, line in enumerate(lines):
            write(column, line, (8, 24 + 18 * k))
        self._traction.legend(column, (8, 24 + 18 * (len(lines) + 1)))
        self.append(_beside(image, np.hstack([picture, column])), self.slot(sample.time))

    def add(self, image: Image, sample: Sample) -> None:
        """Append one sample with its image; a dropped frame adds nothing."""
        observation = sample.observation
        if observation is None:
            return
        overlay = draw_overlay(image, observation.field, self._view, sample.tracks, sample.rest)
        source = "true" if sample.tracks is None else "estimated"
        write(
            overlay,
            f"t {sample.time:.2f} s  load {sample.load:.2f} N  grip {sample.grip:.2f} N",
            (8, 18),
        )
        write(
            overlay,
            f"margin {observation.margin:.2f}  friction {observation.friction:.2f}",
            (8, 36),
        )
        write(overlay, f"{source} force per node", (8, overlay.shape[0] - 28), FORCE_COLOUR)
        if sample.tracks is not None:
            write(overlay, f"marker motion x{MAGNIFY:g}", (8, overlay.shape[0] - 10), TRACK_COLOUR)
        self.append(np.hstack([image, overlay]), self.slot(sample.time))


def _sums(kind: str, field: ForceField, mu: float) -> tuple[str, ...]:
    """Lines about the sums of a field."""
    return (
        f"{kind}:",
        f"normal {field.total_normal:.2f} N",
        f"friction {field.total_friction:.2f} N",
        f"margin {field.safety_margin(mu):.2f}",
        f"with torsion {margin_within(field, mu):.2f}",
    )


def _beside(left: Image, right: Image) -> Image:
    """Two pictures side by side, the lower one in the middle of white."""
    height = max(len(left), len(right))
    whole = np.full((height, left.shape[1] + right.shape[1], 3), 255, np.uint8)
    for picture, at in ((left, 0), (right, left.shape[1])):
        top = (height - len(picture)) // 2
        whole[top : top + len(picture), at : at + picture.shape[1]] = picture
    return whole


def draw_overlay(
    image: Image, field: ForceField, view: View, tracks: Tracks | None, rest: Tracks | None
) -> Image:
    """Paled image with the markers' motion and the force on every third node, RGB.

    An arrow is the contact force on a node: across is friction, up is normal force.
    """
    canvas: Image = (255 - 0.35 * (255.0 - image)).astype(np.uint8)
    if tracks is not None and rest is not None:
        for now, start in zip(tracks.position[0], rest.position[0], strict=True):
            if np.isfinite(now).all() and np.isfinite(start).all():
                tip = now + (MAGNIFY - 1.0) * (now - start)
                _line(canvas, start, tip, TRACK_COLOUR)
    x, z = field.position.T
    base = view.project(np.stack([x, np.zeros_like(x), z], axis=-1))
    force = np.stack([field.friction, -field.normal], axis=-1)
    scale = ARROW * len(x) / REFERENCE_NODES
    for k in np.flatnonzero(field.contact)[::3]:
        _line(canvas, base[k], base[k] + scale * force[k], FORCE_COLOUR, head=True)
    return canvas


def _line(
    canvas: Image,
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    colour: Colour,
    *,
    head: bool = False,
) -> None:
    a, b = (tuple(int(v) for v in np.rint(16 * p)) for p in (start, end))
    if head:
        # arrowedLine draws tips at whole pixels only.
        a, b = (tuple(int(v) for v in np.rint(p)) for p in (start, end))
        cv2.arrowedLine(canvas, a, b, colour, 1, cv2.LINE_AA, tipLength=0.15)
    else:
        cv2.line(canvas, a, b, colour, 1, cv2.LINE_AA, shift=4)
