"""What the maps of the closed loop are made of: panels of cells, with boundaries by analysis."""

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...output.cells import read_cells, resumed
from ...output.processes import map_processes

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Array = NDArray[np.float64]
#: What a cell is run with.
Setting = TypeVar("Setting", bound="DataclassInstance")


class Outcome(NamedTuple):
    """Colour of the cells of an outcome, their letter, and what the legend says beside its name."""

    colour: str
    letter: str
    words: str = ""


#: Outcomes of the cells of a map by name, best first.
Outcomes = Mapping[str, Outcome]


def worst(best: str, happened: Mapping[str, bool]) -> str:
    """Last outcome that happened, or else the best one."""
    return [name for name, did in {best: True, **happened}.items() if did][-1]


def score_of(outcome: str) -> str:
    """Outcome as part of the name of a figure."""
    return outcome.replace(",", "").replace(" ", "_")


def text_of(value: float | int | str) -> str:
    """Value of an axis in words."""
    if value == np.inf:
        return "flat"
    return value if isinstance(value, str) else f"{value:g}"


@dataclass(frozen=True, kw_only=True)
class Panel(Generic[Setting]):
    """One field of a map.

    Attributes
    ----------
    title: of the panel
    base: setting that all of its cells share but for the two axes
    x, y: values of the map's two axes
    """

    title: str
    base: Setting
    x: tuple[float, ...]
    y: tuple[float | int | str, ...]


@dataclass(frozen=True, kw_only=True)
class Line:
    """A predicted boundary, in places along the axes: cell k reaches from k − ½ to k + ½."""

    label: str
    x: Array
    y: Array


@dataclass(frozen=True, kw_only=True)
class Map(Generic[Setting]):
    """Panels of one kind.

    Attributes
    ----------
    title: over the picture
    x, y: attributes of a setting that change along the axes
    x_label, y_label: with units
    columns: panels in a row
    panels: of the map
    camera: settings of cells that are run through the camera as well
    lines: predicted boundaries of a panel; none where cells are marked one by one
    number: attribute that a cell shows, with its meaning; none shows no number
    """

    title: str
    x: str
    y: str
    x_label: str
    y_label: str
    columns: int
    panels: tuple[Panel[Setting], ...]
    camera: tuple[Setting, ...] = ()
    lines: Callable[[Panel[Setting]], list[Line]] | None = None
    number: tuple[str, str] | None = None

    def at(self, panel: Panel[Setting], x: float, y: float | int | str) -> Setting:
        """Setting of one cell."""
        return replace(panel.base, **{self.x: x, self.y: y})

    def cells(self, panel: Panel[Setting]) -> list[Setting]:
        """Setting of every cell of a panel."""
        return [self.at(panel, x, y) for y in panel.y for x in panel.x]

    def settings(self) -> list[Setting]:
        """Every setting, through the camera last."""
        return [*(one for panel in self.panels for one in self.cells(panel)), *self.camera]


def place(values: Sequence[float], at: Array) -> Array:
    """Places of values along an axis of equal cells, in between by their logarithm."""
    known, wanted = np.log(np.array(values)), np.log(at)
    places = np.interp(wanted, known, np.arange(len(known)))
    first, last = known[1] - known[0], known[-1] - known[-2]
    places += np.minimum(wanted - known[0], 0.0) / first
    return np.asarray(places + np.maximum(wanted - known[-1], 0.0) / last)


def run_maps(
    plan: Mapping[str, Map[Any]],
    kind: type[Any],
    cell: Callable[[Any], Any],
    unfinished: Path | None,
    progress: Callable[[str], None],
    workers: int,
) -> dict[Any, Any]:
    """Cell of every setting of all maps; those of an interrupted run need no new one.

    Parameters
    ----------
    kind: of a cell, with its `setting`
    cell: makes one from its setting
    unfinished: file of the cells so far; None keeps none
    progress: called with the number of runs that are done
    workers: processes; one runs in this one
    """
    wanted = list(dict.fromkeys(one for which in plan.values() for one in which.settings()))

    def run(waiting: list[Any]) -> Generator[Any]:
        yield from map_processes(cell, waiting, workers)

    return resumed(
        unfinished,
        read_cells(unfinished, kind),
        lambda one: one.setting,
        wanted,
        run,
        lambda done, total: progress(f"{done} of {total} runs"),
    )
