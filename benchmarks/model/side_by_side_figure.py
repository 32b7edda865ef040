"""Picture of chain and dome side by side."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from benchmarks.model.side_by_side import FITTED, FRICTION, GRIP, OBJECTS, Side
from chromagrip.output.figure import WIDTH, finish, legend_below, new_figure

_COLOURS = {"chain": "#1d70b8", "dome": "#e76f51"}
#: Marker of each, so that they differ by more than their colour.
_MARKERS = {"chain": "^", "dome": "o"}
_STYLES = {"flat": "-", "ball": "--"}


def draw_side_by_side(sides: Sequence[Side]) -> Figure:
    """Four panels: force over depth, width over force, sliding part, and Γ over the load."""
    title = f"Chain and dome: a press to {GRIP:g} N, then a load, µ {FRICTION:g}"
    figure = new_figure(title, WIDTH, 7.4)
    depth, width, sliding, margin = figure.subplots(2, 2).flat
    for side in sides:
        look = {"color": _COLOURS[side.body], "ls": _STYLES[side.object], "lw": 1.6}
        look |= {"marker": _MARKERS[side.body], "markevery": 0.12, "ms": 5.0}
        press, pull = side.press, side.pull
        far = press.force >= FITTED / 2.0
        depth.loglog(1e3 * press.depth[far], press.force[far], **look)
        width.plot(press.force[far], 1e3 * press.half_width[far], **look)
        sliding.plot(pull.share, 100.0 * pull.sliding, **look)
        margin.plot(pull.share, pull.margin, **look)
    for body, power, across in (("chain", 1.5, 0.8), ("dome", 2.0, 1.45)):
        _slope(depth, next(s for s in sides if s.body == body), power, across)
    share = sides[0].pull.share
    margin.plot(share, 1.0 - share, color="0.2", ls=":", lw=1.2)
    depth.set_yticks([0.2, 0.5, 1.0, 2.0, 3.0], ["0.2", "0.5", "1", "2", "3"])
    ticks = [0.05, 0.1, 0.2, 0.4, 0.8]
    depth.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    depth.minorticks_off()
    finish(depth, "ΣFn [N]", "depth [mm]", legend=False, title="Force over depth")
    finish(width, "half width [mm]", "ΣFn [N]", legend=False, title="Width over force", ylim=0)
    load = "load / (µ · grip)"
    finish(sliding, "of the width [%]", load, legend=False, title="Part that slides", ylim=0)
    finish(margin, "Γ", load, legend=False, title="Safety margin", ylim=0)
    names = {"flat": "flat object", "ball": f"ball of {1e3 * OBJECTS['ball']:g} mm radius"}
    handles = [
        Line2D([], [], color=colour, marker=_MARKERS[body], ms=5.0, label=body)
        for body, colour in _COLOURS.items()
    ]
    handles += [
        Line2D([], [], color="0.3", ls=style, label=names[each]) for each, style in _STYLES.items()
    ]
    handles += [
        Line2D([], [], color="0.2", ls=":", lw=1.2, label="1 − load / (µ · grip)"),
        Line2D([], [], color="0.5", lw=0.9, label="thin: a power of the depth"),
    ]
    legend_below(figure, handles, 3)
    return figure


def _slope(axes: Axes, side: Side, power: float, across: float) -> None:
    """A line of one power of the depth beside the curves of a body, at `across` times their depth.

    Its name is at its lower end, on the side away from the curves.
    """
    depth = np.array([0.3, 0.8]) * 1e3 * side.press.depth[-1]
    force = side.press.force[-1] * (depth / (1e3 * side.press.depth[-1])) ** power
    colour, left = _COLOURS[side.body], across < 1.0
    axes.plot(across * depth, force, color=colour, lw=0.9, alpha=0.7)
    axes.annotate(
        f"depth$^{{{power:g}}}$",
        (across * depth[0], force[0]),
        xytext=(-4 if left else 6, 0),
        textcoords="offset points",
        ha="right" if left else "left",
        va="center",
        fontsize=9,
        color=colour,
    )
