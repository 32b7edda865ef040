"""A dome's traction, viewed from above: pressure as colour, friction as arrows."""

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from ...model import ForceField, SoftBody
from ...model.dome import lattice

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Colour = tuple[int, int, int]

#: Colours of friction where the skin sticks and slips, of the outline and of text, RGB.
STICKS: Colour = (20, 20, 20)
SLIPS: Colour = (225, 80, 20)
OUTLINE: Colour = (150, 150, 150)
#: Share of the friction limit above which a node slips.
SLIPPING = 0.999
#: Pressure of the darkest colour at first [Pa]. The pressure of a contact rises with the third root
#: of its force (Hertz), so that one scale shows a light touch and a firm grip.
FIRST_TOP = 200e3
#: Magnification of a traction while the contact is in its middle.
ZOOM = 2


class TractionPicture:
    """Pictures of contacts on one dome, with a common scale that grows for larger pressures.

    Parameters
    ----------
    dome: dome that is touched
    size: side of the picture (default 480) [px]

    Attributes
    ----------
    top: pressure of the darkest colour [Pa]; it never falls, and rises to the next of 1, 2, 5, …
    radius: radius of the dome [m]
    pixels: scale of the picture [px/m]
    """

    def __init__(self, dome: SoftBody, size: int = 480) -> None:
        self.radius = dome.radius
        # Length of an arrow as large as the largest pressure, as a share of the picture's side.
        arrow = 100.0 / 480.0
        self._size, self._arrow = size, arrow * size
        nodes = lattice(dome)
        self._areas = nodes.areas
        border = 8  # free border around the dome [px]
        self.pixels = (size / 2 - border) / dome.radius
        self._outline = round(dome.radius * self.pixels)
        mesh = scipy.spatial.Delaunay(nodes.points[:, :2])
        at = (np.arange(size) - (size - 1) / 2) / self.pixels
        places = np.stack(np.meshgrid(at, -at), axis=-1).reshape(-1, 2)
        found = mesh.find_simplex(places)
        self._inside = np.flatnonzero(found >= 0)
        found, places = found[self._inside], places[self._inside]
        self._triangle, self._triangles = found, mesh.simplices
        part = np.einsum("nij,nj->ni", mesh.transform[found, :2], places - mesh.transform[found, 2])
        self._weights = np.column_stack([part, 1.0 - part.sum(axis=1)])
        self._corners = mesh.simplices[found]
        self.top = FIRST_TOP

    def draw(self, field: ForceField, mu: float) -> Image:
        """Draw a contact with a friction coefficient, RGB, (size, size, 3)."""
        pressure = np.where(field.contact, field.normal, 0.0) / self._areas
        self.top = max(self.top, _round_up(float(pressure.max())))
        canvas: Image = np.full((self._size, self._size, 3), 255, np.uint8)
        # The contact has few of the pixels.
        pressed = (pressure[self._triangles] != 0.0).any(axis=1)
        on = np.flatnonzero(pressed[self._triangle])
        share = (pressure[self._corners[on]] * self._weights[on]).sum(axis=1) / self.top
        canvas.reshape(-1, 3)[self._inside[on]] = _colours(share)
        middle = (self._size // 2, self._size // 2)
        cv2.circle(canvas, middle, self._outline, OUTLINE, 1, cv2.LINE_AA)
        self._arrows(canvas, field, mu)
        return canvas

    def _arrows(self, canvas: Image, field: ForceField, mu: float) -> None:
        slips = field.friction_sizes > SLIPPING * mu * field.normal
        traction = field.friction[:, :2] / self._areas[:, None]
        for k in np.flatnonzero(field.contact):
            start = self._pixel(field.position[k, :2])
            way = self._arrow / self.top * traction[k] * [1.0, -1.0]
            if np.hypot(*way) < 1.0:
                continue
            a, b = (tuple(int(v) for v in np.rint(p)) for p in (start, start + way))
            colour = SLIPS if slips[k] else STICKS
            cv2.arrowedLine(canvas, a, b, colour, 1, cv2.LINE_AA, tipLength=0.25)

    def _pixel(self, place: Array) -> Array:
        return (self._size - 1) / 2 + self.pixels * place * [1.0, -1.0]

    def in_middle(self, field: ForceField) -> bool:
        """Whether the contact is in the part that is left of a magnified picture."""
        return not bool((abs(field.position[field.contact, :2]) > 0.95 * self.radius / ZOOM).any())

    def part(self, picture: Image, magnified: bool) -> Image:
        """Middle of a drawn picture, or the whole of it in the same size, with a scale of 5 mm."""
        side = self._size // ZOOM
        first = (self._size - side) // 2
        if magnified:
            shown = picture[first : first + side, first : first + side].copy()
        else:
            small = cv2.resize(picture, (side, side), interpolation=cv2.INTER_AREA)
            shown = np.asarray(small, np.uint8)
        pixels = self.pixels if magnified else self.pixels / ZOOM
        right, row = side - 8, side - 8
        cv2.line(shown, (round(right - 5e-3 * pixels), row), (right, row), STICKS, 2)
        write(shown, "5 mm", (right - 36, row - 6))
        return shown

    def legend(self, canvas: Image, place: tuple[int, int], magnified: bool = True) -> None:
        """Write the meaning of colours and arrows on a picture, from a place downwards [px]."""
        (x, y), row, bar = place, 20, 60  # height of a line, and width of the bar of colours [px]
        left = x + 78  # edge of what the words explain
        kilopascals = self.top / 1e3
        share = np.linspace(0.0, 1.0, bar)
        canvas[y - 10 : y, left : left + bar] = _colours(share)
        cv2.rectangle(canvas, (left, y - 10), (left + bar - 1, y), OUTLINE, 1)
        write(canvas, "pressure 0", (x, y))
        write(canvas, f"{kilopascals:g} kPa", (left + 6 + bar, y))
        write(canvas, "friction", (x, y + row))
        length = int(self._arrow / 4 / (1 if magnified else ZOOM))
        start, end = (left, y + row - 4), (left + length, y + row - 4)
        cv2.arrowedLine(canvas, start, end, STICKS, 1, cv2.LINE_AA, tipLength=0.25)
        write(canvas, f"{kilopascals / 4:g} kPa", (left + 6 + bar, y + row))
        write(canvas, "black: sticks", (x, y + 2 * row))
        write(canvas, "orange: slips", (x + 110, y + 2 * row), SLIPS)


def _colours(share: Array) -> Image:
    """Colours of shares of the largest pressure, shape (N, 3)."""
    none = np.array([255.0, 255.0, 255.0])  # colours of no pressure and of the largest, RGB
    largest = np.array([20.0, 90.0, 190.0])
    colours = none + np.clip(share, 0.0, 1.0)[:, None] * (largest - none)
    return np.asarray(colours.round().astype(np.uint8))


def write(
    canvas: Image,
    text: str,
    place: tuple[int, int],
    colour: Colour = STICKS,
    size: float = 0.42,
) -> None:
    """Write text on a picture, its lower left corner at a place [px], in a size of the font."""
    cv2.putText(canvas, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)


def _round_up(pressure: float) -> float:
    """The next of 1, 2, 5, 10, 20, … kPa [Pa]."""
    if pressure <= 0.0:
        return 0.0
    power = 10.0 ** np.floor(np.log10(pressure))
    return float(next(power * step for step in (1.0, 2.0, 5.0, 10.0) if power * step >= pressure))
