"""Labels of points that overlap neither each other nor the points, with a line to those far off."""

import math
from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

#: Ends of a line of a panel, each a time and an error.
Segment = tuple[tuple[float, float], tuple[float, float]]
Array = NDArray[np.float64]
#: Text, time and error, and look of a label.
Label = tuple[str, tuple[float, float], dict[str, Any]]
#: Where a label can be: its offset from the point [points], its box and those of its line [px].
Spot = tuple[tuple[float, float], Bbox, list[Bbox]]

#: Size of letters [points].
_LETTERS = 8
#: Half the size of a point [points].
_POINT = 3.5
#: Line to a label.
_LEADER = {"arrowstyle": "-", "color": "0.55", "lw": 0.6, "shrinkA": 0.0, "shrinkB": 3.0}
#: Space around a label [points].
_APART = 1.5
#: Offset of a label that is right beside its point [points].
_BESIDE = 6.0
#: Offsets sideways and up of labels that a line leads to, the nearest first [points].
_OFF = sorted(
    product((15.0, 35.0, 60.0, 90.0), (5.5 * k for k in range(-22, 23) if abs(k) > 1)),
    key=lambda offset: math.hypot(*offset),
)
#: Places along such a line that stay free of other labels, and along other lines.
_ALONG, _ALL_ALONG = np.linspace(0.35, 1.0, 7), np.linspace(0.0, 1.0, 40)


def write_labels(
    figure: Figure, panel: Axes, labels: Sequence[Label], lines: Sequence[Segment]
) -> None:
    """Write labels in turn, each at the nearest free place; what finds none is left out.

    Parameters
    ----------
    figure: that is laid out: places are measured on it
    panel: of the figure
    labels: those that matter most first
    lines: that are drawn in the panel; no label covers one
    """
    scale = figure.dpi / 72.0
    size = _POINT * scale
    places = panel.transData.transform([point for _, point, _ in labels])
    points = [Bbox.from_extents(x - size, y - size, x + size, y + size) for x, y in places]
    for ends in lines:
        start, end = panel.transData.transform(ends)
        points += _boxes(start + np.outer(_ALL_ALONG, end - start))
    taken = [text.get_window_extent() for text in panel.texts]
    for (text, point, look), place in zip(labels, places, strict=True):
        measured = panel.text(0.0, 0.0, text, fontsize=_LETTERS, **look)
        box = measured.get_window_extent()
        measured.remove()
        for offset, around, line in _spots(place, box.width, box.height, scale):
            inside = panel.bbox.x0 <= around.x0 and around.x1 <= panel.bbox.x1
            inside &= panel.bbox.y0 <= around.y0 and around.y1 <= panel.bbox.y1
            if inside and not (
                around.count_overlaps(points + taken)
                or any(each.count_overlaps(taken) for each in line)
            ):
                taken += [around.padded(_APART * scale), *line]
                panel.annotate(
                    text,
                    point,
                    textcoords="offset points",
                    xytext=offset,
                    ha="left" if offset[0] > 0.0 else "right",
                    va="center",
                    fontsize=_LETTERS,
                    arrowprops=_LEADER | {"relpos": (float(offset[0] < 0.0), 0.5)}
                    if line
                    else None,
                    **look,
                )
                break


def _spots(place: Array, width: float, height: float, scale: float) -> Iterator[Spot]:
    """Places beside a point, the nearest first, with the line that leads to one farther off."""
    near = [(_BESIDE, up) for up in (0.0, 8.0, -8.0)]
    for beside, up in [*near, *_OFF]:
        for offset in ((beside, up), (-beside, up)):
            x, y = place + scale * np.array(offset)
            left = x if offset[0] > 0.0 else x - width
            box = Bbox.from_bounds(left, y - height / 2.0, width, height)
            along = () if beside == _BESIDE else _ALONG
            yield offset, box, _boxes(place + np.outer(along, (x - place[0], y - place[1])))


def _boxes(places: Array) -> list[Bbox]:
    """Small boxes at some places."""
    return [Bbox.from_bounds(x - 0.5, y - 0.5, 1.0, 1.0) for x, y in places]
