"""The tactile video: the camera's picture next to the estimated and the true forces.

A chain's contact is shown magnified, from the camera's side; a dome's from above.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ...model import REFERENCE_NODES, ForceField, margin_within
from ...output.video import VideoFile
from ...render import Frame
from ...scene.scene import Body, Scene
from ...tracking import Tracks
from ..sample import Sample
from .dome_picture import OUTLINE, TractionPicture, write
from .dome_picture import ZOOM as TRACTION_ZOOM

Image = NDArray[np.uint8]

#: Pictures per second of the video [Hz].
FPS = 25
#: Rate factor of the encoder; lower is better.
QUALITY = 20
#: The video is this many times slower than the run.
SLOWDOWN = 4
#: Interval of complete pictures, so that a player reaches any picture quickly.
SEEKABLE = {"g": "25"}
#: Length of a force arrow at 251 nodes, in pictures of the camera's own size [px/N].
ARROW = 1200.0
#: Factor by which displacements of markers are magnified.
MAGNIFY = 4.0
#: Height of the line of text above the pictures [px].
HEAD = 30
#: Magnification of the contact of a chain.
ZOOM = 2

Colour = tuple[int, int, int]
TRACK_COLOUR: Colour = (0, 120, 60)
INK: Colour = (20, 20, 20)
#: Colours of estimated and true forces, RGB.
ESTIMATED: Colour = (200, 70, 0)
TRUE: Colour = (0, 90, 160)
#: Colour of the words for a missing estimate.
NO_ESTIMATE: Colour = (200, 40, 40)
#: Size of the font, readable in a page.
_FONT = 0.48
#: Height of a line of text below a traction [px].
_LINE = 21


@dataclass(frozen=True)
class _Contact:
    """A contact in the video.

    Attributes
    ----------
    kind: `estimated` or `true`
    field, mu: its forces and friction coefficient
    no_estimate: whether nothing was estimated
    """

    kind: str
    field: ForceField
    mu: float
    no_estimate: bool = False

    @property
    def colour(self) -> Colour:
        """Colour of its arrows on a chain and of its title."""
        return ESTIMATED if self.kind == "estimated" else TRUE

    def lines(self, what: str) -> tuple[str, ...]:
        """Lines of text: what is drawn, and its sums."""
        title = f"{self.kind} {what}"
        return (title, "no estimate") if self.no_estimate else (title, *_sums(self.field, self.mu))


class TactileVideo(VideoFile):
    """The camera's picture, next to the estimated and the true contact.

    Parameters
    ----------
    path: path of the video
    scene: scene whose sensor's camera maps the forces onto the picture
    """

    def __init__(self, path: Path, scene: Scene) -> None:
        super().__init__(path, FPS, QUALITY, SEEKABLE)
        self._view = scene.build_sensor().view
        self._camera = scene.path == "camera"
        self._scale = ZOOM * ARROW
        self._slot = -1
        self._notices = 0  # remaining contacts with the notice that the arrows were halved
        self._tractions = _TRACTIONS[scene.body](scene)
        self._magnified = True

    def slot(self, time: float) -> int:
        """Number of the video's picture at a time [s]."""
        return int(time * FPS * SLOWDOWN + 1e-6)

    def due(self, sample: Sample) -> bool:
        """Return True if a picture of this sample is due; never for a dropped frame."""
        slot = self.slot(sample.time)
        due = slot > self._slot and sample.observation is not None
        self._slot = slot if due else self._slot
        return due

    def show(self, sample: Sample, frames: Sequence[Frame]) -> None:
        """Append one sample with its picture."""
        image, observation = frames[0].image, sample.observation
        assert observation is not None
        contacts = [_Contact("true", sample.field, sample.friction)]
        if self._camera:
            missing = bool(observation.no_estimate)
            read = _Contact("estimated", observation.field, observation.friction, missing)
            contacts.insert(0, read)
        draw = self._draw_tractions if self._tractions else self._draw_slices
        self.append(_headed(np.hstack([image, draw(image, sample, contacts)]), sample),
                    self.slot(sample.time))  # fmt: skip

    def _draw_slices(self, image: Image, sample: Sample, contacts: list[_Contact]) -> Image:
        """Draw each contact of a chain, magnified, one above the other."""
        height, width = image.shape[0] // len(contacts), image.shape[1]
        middle = self._view.project(np.array([[0.0, 0.0, _apex(sample.field)]]))[0]
        # The skin is low in the picture: arrows point up.
        corner = middle - np.array([0.5 * width, 0.8 * height]) / ZOOM
        ground = _magnified(image, corner, (height, width))
        longest = 0.7  # longest arrow, as a share of the height; a longer one halves the scale
        for each in contacts:
            self._rescale(each.field, longest * height)
        pictures = []
        for each in contacts:
            canvas = ground.copy()
            if each.kind == "estimated" and sample.tracks is not None and sample.rest is not None:
                _draw_motion(canvas, sample.tracks, sample.rest, corner)
                place = (8, height - 10)
                write(canvas, f"marker motion x{MAGNIFY:g}", place, TRACK_COLOUR, _FONT)
            self._draw_forces(canvas, each.field, corner, each.colour)
            _say(canvas, each.lines("force of every 3rd node"), (8, 18), each.colour)
            self._draw_scale(canvas, each.field, each.colour)
            pictures.append(canvas)
        for canvas in pictures[1:]:
            canvas[0] = OUTLINE
        return np.vstack(pictures)

    def _rescale(self, field: ForceField, longest: float) -> None:
        """Halve the scale of the arrows until the longest is short enough."""
        largest = float(np.hypot(field.normal, field.friction).max()) * _per_node(field)
        while largest * self._scale > longest:
            self._scale /= 2.0
            self._notices = 100  # two a picture
        self._notices -= 1

    def _draw_forces(
        self, canvas: Image, field: ForceField, corner: NDArray[np.float64], colour: Colour
    ) -> None:
        """Draw arrows on every third node: friction across, normal force up."""
        x, z = field.position.T
        base = ZOOM * (self._view.project(np.stack([x, np.zeros_like(x), z], axis=-1)) - corner)
        force = np.stack([field.friction, -field.normal], axis=-1)
        for k in np.flatnonzero(field.contact)[::3]:
            tip = base[k] + self._scale * _per_node(field) * force[k]
            _line(canvas, base[k], tip, colour, head=True)

    def _draw_scale(self, canvas: Image, field: ForceField, colour: Colour) -> None:
        """Draw an arrow of a round force in the lower right corner."""
        scale = self._scale * _per_node(field)
        about_px = 60.0  # length of the arrow of the scale, about [px]
        force = rounded_down(about_px / scale)
        x, y = canvas.shape[1] - 150, canvas.shape[0] - 14
        _line(canvas, np.array([x, y]), np.array([x + scale * force, y]), colour, head=True)
        write(canvas, f"{force:g} N", (x + int(scale * force) + 8, y + 4), colour)
        if self._notices > 0:
            write(canvas, "all arrows are halved", (x - 40, y - 18), colour)

    def _draw_tractions(self, image: Image, sample: Sample, contacts: list[_Contact]) -> Image:
        """Draw each contact of a dome from above, side by side, with text below."""
        shown = [(self._tractions[each.kind], each) for each in contacts]
        self._magnified &= all(picture.in_middle(each.field) for picture, each in shown)
        for _ in range(2):  # once more if the scale of one has grown
            drawn = [picture.draw(each.field, each.mu) for picture, each in shown]
            top = max(picture.top for picture, _ in shown)
            if all(picture.top == top for picture, _ in shown):
                break
            for picture, _ in shown:
                picture.top = top
        columns = []
        for (picture, each), canvas in zip(shown, drawn, strict=True):
            part = picture.part(canvas, self._magnified)
            whole = np.full((len(image), part.shape[1], 3), 255, np.uint8)
            whole[: len(part)] = part
            whole[len(part)] = whole[:, 0] = OUTLINE
            lines = each.lines("traction")
            if each.kind == "true":
                truth = sample.contact
                lines += (
                    f"object x {1e3 * truth.place[0]:.2f} mm, depth "
                    f"{1e3 * truth.indentation:.2f} mm",
                    f"turn {np.degrees(truth.turn):.1f} deg",
                )
            _say(whole, lines, (8, len(part) + 18), each.colour)
            columns.append(whole)
        shown[-1][0].legend(columns[-1], (8, len(image) - 48), self._magnified)
        return np.hstack(columns)


def _tractions_of(scene: Scene) -> dict[str, TractionPicture]:
    """Pictures of tractions: the estimated on the sensor's dome, the true on the scene's."""
    share = 0.6  # of the camera's height; the text below needs the rest
    side = TRACTION_ZOOM * 2 * round(0.5 * share * scene.build_sensor().view.height)
    pictures = {"true": TractionPicture(scene.build_dome(), side)}
    if scene.path == "camera":
        pictures["estimated"] = TractionPicture(scene.build_sensor().dome, side)
    return pictures


#: Pictures of tractions of each body; empty for a chain.
_TRACTIONS: dict[Body, Callable[[Scene], dict[str, TractionPicture]]] = {
    "chain": lambda scene: {},
    "dome": _tractions_of,
}


def rounded_down(value: float) -> float:
    """The largest of …, 1, 2, 5, 10, … up to a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(step * power for step in (5.0, 2.0, 1.0) if step * power <= value * 1.0001))


def _per_node(field: ForceField) -> float:
    """Factor on arrows that compensates the larger forces per node of coarser chains."""
    return len(field.normal) / REFERENCE_NODES


def _apex(field: ForceField) -> float:
    """Height of the middle node of a chain [m]."""
    return float(field.position[len(field.position) // 2, 1])


def _headed(picture: Image, sample: Sample) -> Image:
    """Add a line of text about the sample above a picture."""
    head = np.full((HEAD, picture.shape[1], 3), 255, np.uint8)
    slow = f"shown {SLOWDOWN:g} times slower"
    write(head, f"t {sample.time:.2f} s    load {sample.load:.2f} N    grip {sample.grip:.2f} N",
          (8, 20), size=_FONT)  # fmt: skip
    write(head, slow, (picture.shape[1] - 200, 20), size=_FONT)
    return np.vstack([head, picture])


def _sums(field: ForceField, mu: float) -> tuple[str, ...]:
    """Lines about the sums of a field."""
    margin = field.safety_margin(mu)
    torsion = margin_within(field, mu) if field.directions is not None else math.nan
    return (
        f"normal {field.total_normal:.2f} N, friction {field.total_friction:.2f} N",
        f"mu {_known(mu)}, margin {_known(margin)}",
        *(() if math.isnan(torsion) else (f"margin with torsion {torsion:.2f}",)),
    )


def _known(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "unknown"


def _say(canvas: Image, lines: Sequence[str], place: tuple[int, int], colour: Colour) -> None:
    """Write lines of text below each other, the first one in a colour."""
    for k, line in enumerate(lines):
        ink = NO_ESTIMATE if line == "no estimate" else INK
        write(canvas, line, (place[0], place[1] + _LINE * k), colour if k == 0 else ink, _FONT)


def _magnified(image: Image, corner: NDArray[np.float64], size: tuple[int, int]) -> Image:
    """Paled part of an image from a corner (x, y) on, magnified to a size (rows, columns)."""
    shift = np.array([[ZOOM, 0.0, -ZOOM * corner[0]], [0.0, ZOOM, -ZOOM * corner[1]]])
    part = cv2.warpAffine(image, shift, size[::-1], borderMode=cv2.BORDER_REPLICATE)
    return (255 - 0.3 * (255.0 - part)).astype(np.uint8)


def _draw_motion(canvas: Image, tracks: Tracks, rest: Tracks, corner: NDArray[np.float64]) -> None:
    """Draw the motion of the outer markers since rest, magnified."""
    for now, start in zip(tracks.position[0], rest.position[0], strict=True):
        if np.isfinite(now).all() and np.isfinite(start).all():
            way = ZOOM * MAGNIFY * (now - start)
            at = ZOOM * (start - corner)
            _line(canvas, at, at + way, TRACK_COLOUR, head=True)


def _line(
    canvas: Image,
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    colour: Colour,
    *,
    head: bool = False,
) -> None:
    # arrowedLine draws tips at whole pixels only.
    ends = np.array([start, end]) * (1 if head else 16)
    a, b = np.rint(ends).astype(int).tolist()
    if head:
        cv2.arrowedLine(canvas, a, b, colour, 1, cv2.LINE_AA, tipLength=0.15)
    else:
        cv2.line(canvas, a, b, colour, 1, cv2.LINE_AA, shift=4)
