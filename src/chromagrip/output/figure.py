"""What the reproduced figures share: controllers, colours, axes, and what is not printed."""

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ..model import ContactObject

#: The thesis's controllers with its names and, nearly, its colours.
CONTROLLERS = {
    "safety-margin": ("Safety Margin Control", "#1f5fa8"),
    "conservative": ("Conservative Control", "#c8442e"),
    "react-to-slip": ("React To Slip", "#e0a100"),
}
_PLAIN = ContactObject()
#: What no figure of the thesis says, and every one here has.
UNPRINTED = (
    f"Dahl n = {_PLAIN.dahl_exponent:g}, σ0 = {_PLAIN.dahl_stiffness:g} N/m per node, "
    f"drag {_PLAIN.drag:g} N·s/m"
)


def new_figure(title: str, width: float, height: float) -> Figure:
    """Figure with its title and, below, what it rests on that is not printed."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11)
    figure.supxlabel(UNPRINTED, fontsize=7, color="0.4")
    return figure


def finish(axes: Axes, up: str, across: str = "", legend: bool = True) -> None:
    """Labels, grid, frame and legend of a panel."""
    axes.set_ylabel(up, fontsize=9)
    axes.set_xlabel(across, fontsize=9)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.25, lw=0.5)
    axes.spines[["top", "right"]].set_visible(False)
    if legend:
        axes.legend(fontsize=8, frameon=False)
