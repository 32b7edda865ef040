"""Curves of the last seconds: margins, forces, friction."""

from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..loop.columns import values_of
from ..loop.sample import Sample

if TYPE_CHECKING:
    import viser

#: Values of a frame, by the names of a trace's columns.
Row = dict[str, float]
#: Largest number of frames on the curves.
FRAMES = 2000
_GRIP = ", grip thin"
#: Title of each plot, its range of values, and the columns of its curves.
_PLOTS: tuple[tuple[str, tuple[float, float] | None, tuple[str, ...]], ...] = (
    (
        "Γ: true solid, estimated dashed, 90 % shaded",
        (-0.2, 1.05),
        ("margin_low", "margin_high", "margin_estimated", "margin_true"),
    ),
    (
        "forces [N]: ΣFn thick, ΣFf dotted" + _GRIP,
        None,
        (
            "normal_estimated_n",
            "normal_true_n",
            "friction_estimated_n",
            "friction_true_n",
            "applied_n",
        ),
    ),
    (
        "µ: true solid, estimated dashed, 90 % shaded",
        (0.0, 1.5),
        ("mu_low", "mu_high", "mu_estimated", "mu_true"),
    ),
)
#: Columns of a trace that the curves show.
COLUMNS = ("time_s", *(name for _, _, names in _PLOTS for name in names))


def _look(name: str) -> dict[str, Any]:
    """Stroke of a column's curve."""
    if name.endswith(("_low", "_high")):
        return {"stroke": "rgba(213, 94, 0, 0.2)", "width": 1}
    if name == "applied_n":
        return {"stroke": "#7a7a7a", "width": 1}
    true = "_true" in name
    blue = "#0072b2"  # colours as in the figures: true and estimated
    orange = "#d55e00"
    look: dict[str, Any] = {"stroke": blue if true else orange, "width": 2}
    if name.startswith("friction"):
        return look | {"dash": (2, 2)}
    return look if true else look | {"dash": (6, 3)}


class Strips:
    """The curves; each has the last seconds of the grasp.

    Parameters
    ----------
    server: server of the page
    truth: whether the truth is shown in addition to the estimate
    """

    def __init__(self, server: "viser.ViserServer", truth: bool = True) -> None:
        self._rows: deque[Row] = deque(maxlen=FRAMES)
        self._plots: list[tuple[Any, tuple[str, ...]]] = []
        for title, span, names in _PLOTS:
            # A curve without values would give a plot without a scale.
            there = [n for n in names if truth or not ("_true" in n or n == "applied_n")]
            banded = there[0].endswith("_low")
            series: list[Any] = [{"label": name, **_look(name)} for name in there]
            handle = server.gui.add_uplot(
                data=tuple(np.zeros(2) for _ in range(len(there) + 1)),
                series=({"label": "s"}, *series),
                title=title if truth else title.replace("true solid, ", "").replace(_GRIP, ""),
                scales={"x": {"time": False}, **({} if span is None else {"y": {"range": span}})},
                bands=({"series": (2, 1), "fill": "rgba(213, 94, 0, 0.2)"},) if banded else None,
                legend={"show": False},
                aspect=2.2,
            )
            self._plots.append((handle, ("time_s", *there)))

    def add(self, row: Row) -> None:
        """Append a frame; a time before the last one starts the curves again."""
        if self._rows and row["time_s"] <= self._rows[-1]["time_s"]:
            self._rows.clear()
        self._rows.append(row)

    def put(self, rows: Sequence[Row]) -> None:
        """Replace all rows; the last one is the present frame."""
        self._rows = deque(rows, maxlen=FRAMES)

    def draw(self) -> None:
        """Send the curves to the page."""
        rows = list(self._rows)
        seconds = 10.0  # length of the curves
        rows = [row for row in rows if row["time_s"] > rows[-1]["time_s"] - seconds]
        if len(rows) < 2:
            return
        for handle, names in self._plots:
            handle.data = tuple(np.array([row.get(name, np.nan) for row in rows]) for name in names)


def row_of(sample: Sample) -> Row:
    """Values of a frame, with truth and estimates."""
    return values_of(sample, COLUMNS)


def rows_of(columns: dict[str, NDArray[np.float64]]) -> list[Row]:
    """Values of each frame of a trace."""
    count = len(columns["time_s"])
    return [{name: float(columns[name][k]) for name in COLUMNS} for k in range(count)]
