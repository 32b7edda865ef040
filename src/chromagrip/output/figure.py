"""Style that the figures of the measuring commands share."""

import io
import textwrap
from collections.abc import Sequence
from typing import Any

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import LogLocator, NullFormatter

#: Width of a figure [inches]. On a page, which is about 720 px wide, 8 points are 10 px.
WIDTH = 8.0
#: Size of the letters of a footnote [points].
_FOOTNOTE = 7.5


def new_figure(title: str, width: float, height: float, footnote: str = "") -> Figure:
    """Figure with a title.

    Parameters
    ----------
    title: above the panels
    width, height: of the figure [inches]
    footnote: small text below the panels
    """
    figure = Figure(figsize=(width, height), layout="constrained")
    figure.suptitle(_wrapped(title, width, 11.0), fontsize=11)
    lines = _wrapped(footnote, width, _FOOTNOTE)
    figure.supxlabel(lines, fontsize=_FOOTNOTE, color="0.4")
    return figure


def _wrapped(text: str, width: float, size: float) -> str:
    """Text in lines that fit into a width [inches] with letters of a size [points]."""
    letters = round(72.0 * width / (0.58 * size))
    return "\n".join(
        textwrap.fill(line, letters, break_on_hyphens=False) for line in text.splitlines()
    )


def finish(
    axes: Axes, y_label: str, x_label: str = "", legend: bool = True, **properties: Any
) -> None:
    """Set labels, grid, frame, legend and further properties of a panel."""
    axes.set(ylabel=y_label, xlabel=x_label, **properties)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.25, lw=0.5)
    axes.spines[["top", "right"]].set_visible(False)
    if legend:
        axes.legend(fontsize=8, frameon=False)


def legend_below(figure: Figure, handles: Sequence[Artist], columns: int) -> None:
    """Add one legend for all panels, below them, above the footnote; fewer columns if it must."""
    lines = len(figure.get_supxlabel().splitlines())
    low = 1.5 * lines * _FOOTNOTE / 72.0 / figure.get_figheight()
    at: dict[str, Any] = {"loc": "lower center", "bbox_to_anchor": (0.5, low), "fontsize": 8}
    legend = figure.legend(handles=handles, ncols=columns, **at)
    while columns > 1 and legend.get_window_extent().width > figure.bbox.width:
        columns -= 1
        legend.remove()
        legend = figure.legend(handles=handles, ncols=columns, **at)
    # The layout keeps room for the footnote, and by itself not for a legend beside it.
    above = legend.get_window_extent().y1 / figure.bbox.height - low + 0.04 / figure.get_figheight()
    layout = figure.get_layout_engine()
    assert isinstance(layout, ConstrainedLayoutEngine)
    layout.set(rect=(0.0, above, 1.0, 1.0 - above))


def plain_ticks(axis: Axis) -> None:
    """Plain numbers on a logarithmic axis that is drawn on: each power of ten, and between them.

    The fewer decades are visible, the more of the numbers between them have a tick.
    """
    low, high = axis.get_view_interval()
    between = (1, 2, 5) if high < 500.0 * low else (1,)
    axis.set_major_locator(LogLocator(subs=(1, 2, 3, 4, 5, 6, 8) if high < 8.0 * low else between))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def png(figure: Figure, dpi: int = 110) -> bytes:
    """PNG of a figure; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    return buffer.getvalue()
