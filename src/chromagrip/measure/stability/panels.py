"""What the maps of the closed loop are made of: panels of cells, with boundaries by analysis."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...output.cells import write_cells
from ...output.page import PageSection, inline_png
from ...output.report import Report
from ..study import Results, Study

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


def map_study(
    name: str,
    settings: Sequence[Any],
    measure: Callable[[Any], list[Any]],
    kind: type[Any],
    report: Callable[[list[Any]], Report],
    draw: Callable[[list[Any], Path], None],
    words: Callable[[Any], str],
) -> Study[Any, Any]:
    """Study that is drawn as one map: NAME.png, and NAME.csv with all of its cells.

    Parameters
    ----------
    settings, words: see `Study`
    measure: cells of a setting
    kind: of the cells
    report: from all cells
    draw: writes the picture of all cells
    """

    def all_cells(results: Results[Any, list[Any]]) -> list[Any]:
        return [one for _, some in results for one in some]

    def show(results: Results[Any, list[Any]], out: Path) -> list[PageSection]:
        draw(all_cells(results), out / f"{name}.png")
        write_cells(all_cells(results), out / f"{name}.csv")
        return [picture_section(name, out / f"{name}.png", "Map")]

    return Study(
        settings=settings,
        measure=measure,
        result=list[kind],  # type: ignore[valid-type]
        report=lambda results: report(all_cells(results)),
        words=words,
        show=show,
    )


def shipped_notes(
    shipped: Mapping[str, Any], done: Mapping[Any, Any], outcomes: Outcomes
) -> Iterator[str]:
    """A sentence for each shipped scene whose own cell is not the best.

    Parameters
    ----------
    shipped: setting of each scene
    done: cells of the settings
    """
    best = next(iter(outcomes))
    for scene, setting in shipped.items():
        outcome = done[setting].outcome
        if outcome != best:
            words = outcomes[outcome].words
            yield f"The scene `{scene}` as shipped is itself in a cell of {outcome} ({words})."


def picture_section(name: str, picture: Path, title: str) -> PageSection:
    """Section of a page with a picture from a file."""
    shown = inline_png(picture.read_bytes(), title)
    return PageSection(anchor=name, name=name, title=title, picture=shown)


def settings_of(plan: Mapping[str, Map[Any]]) -> list[Any]:
    """Every setting of some maps, once."""
    return list(dict.fromkeys(one for which in plan.values() for one in which.settings()))
