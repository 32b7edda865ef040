"""Studies whose settings are parts of a benchmark, each of which yields rows."""

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

from chromagrip.measure.charts.chart import Chart
from chromagrip.measure.charts.page import chart_study
from chromagrip.measure.study import Asked, Study
from chromagrip.output.report import Report, Row


class Part(NamedTuple):
    """Name of a part, and whether it is measured in short."""

    name: str
    quick: bool


def parts_study(
    parts: Mapping[str, Callable[[bool], Iterable[Row]]], asked: Asked
) -> Study[Part, tuple[Row, ...]]:
    """Study of parts, one after the other because they take times.

    Parameters
    ----------
    parts: functions that yield the rows of a part; they are told whether the study is a quick one
    """
    return Study(
        timed=[Part(name, asked.quick) for name in parts],
        measure=lambda part: tuple(parts[part.name](part.quick)),
        result=tuple[Row, ...],
        report=lambda results: Report(rows=tuple(row for _, rows in results for row in rows)),
        words=lambda part: part.name,
    )


def whole_chart(draw: Callable[[bool], Chart], name: str, asked: Asked) -> Study[Part, Chart]:
    """Study of one chart that is measured as a whole."""
    return chart_study(
        lambda results: results[0][1],
        lambda part: draw(part.quick),
        Chart,
        timed=[Part(name, asked.quick)],
        words=lambda part: part.name,
    )
