"""Style that the figures of the measuring commands share."""

import io
from collections.abc import Sequence
from typing import Any

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure


def new_figure(title: str, width: float, height: float, footnote: str = "") -> Figure:
    """Figure with a title.

    Parameters
    ----------
    title: above the panels
    width, height: of the figure [inches]
    footnote: small text below the panels
    """
    figure = Figure(figsize=(width, height), layout="constrained")
    figure.suptitle(title, fontsize=11)
    figure.supxlabel(footnote, fontsize=7, color="0.4")
    return figure


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
    """Add one legend for all panels, below them."""
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, fontsize=8)


def png(figure: Figure, dpi: int = 110) -> bytes:
    """PNG of a figure; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    return buffer.getvalue()
