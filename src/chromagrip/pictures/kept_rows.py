"""Rows of a run that may last for days: what its summary and its figure need of them."""

from collections import Counter
from typing import Generic, TypeVar

import numpy as np

from ..loop.trace import kind_of
from ..output.parquet import Row
from ..sources.delivery import Lateness, lateness

#: Largest number of rows in memory.
MOST_ROWS = 20_000
Value = TypeVar("Value")


class Thinned(Generic[Value]):
    """Values at even intervals: all of them, or every 2nd, 4th, … if they are too many.

    Parameters
    ----------
    most: largest number of values that are kept
    """

    def __init__(self, most: int) -> None:
        self.kept: list[Value] = []
        self._most, self._step, self._count = most, 1, 0

    def add(self, value: Value) -> None:
        """Append a value."""
        if self._count % self._step == 0:
            if len(self.kept) == self._most:
                self.kept, self._step = self.kept[::2], 2 * self._step
            if self._count % self._step == 0:
                self.kept.append(value)
        self._count += 1


class KeptRows:
    """Rows of a run, thinned, and exact counts over all of them.

    Attributes
    ----------
    without: number of frames without an estimate
    observable: number of frames with an estimate and an observable µ

    Parameters
    ----------
    period: time from frame to frame [s]
    most: largest number of rows in memory
    """

    def __init__(self, period: float, most: int = MOST_ROWS) -> None:
        self.without = self.observable = 0
        self._rows, self._late = Thinned[tuple[int, Row]](most), Thinned[float](most)
        self._last: list[tuple[int, Row]] = []
        self._estimated: list[tuple[int, Row]] = []
        self._count = 0
        self._firsts: dict[str, str] = {}
        self._reasons = Counter[str]()
        self._period, self._longest, self._late_frames = period, 0.0, 0

    def add(self, row: Row, late: float) -> None:
        """Append a frame's row; its arrays are not kept.

        Parameters
        ----------
        row: of a frame
        late: time from the arrival of the frame until now [s]
        """
        row = {key: value for key, value in row.items() if not isinstance(value, np.ndarray)}
        self._rows.add((self._count, row))
        self._last = [(self._count, row)]
        if row["no_estimate"]:
            reason = str(row["no_estimate"])
            self.without += 1
            self._reasons[self._firsts.setdefault(kind_of(reason), reason)] += 1
        else:
            self.observable += bool(row.get("mu_observable"))
            self._estimated = self._last
        self._count += 1
        self._late.add(late)
        self._longest = max(self._longest, late)
        self._late_frames += late > self._period

    @property
    def rows(self) -> list[Row]:
        """Kept rows, with the last one, and the last one that has an estimate."""
        kept = dict([*self._rows.kept, *self._estimated, *self._last])
        return [kept[index] for index in sorted(kept)]

    @property
    def because(self) -> dict[str, int]:
        """Number of frames without an estimate by the kind of the reason, see `counted_kinds`."""
        return dict(self._reasons.most_common())

    @property
    def late(self) -> Lateness:
        """Lateness of all frames; percentiles are those of the kept ones."""
        found = lateness(self._late.kept, self._period)
        if found["reading_ms"] is not None:
            found["reading_ms"]["worst"] = 1e3 * self._longest
            found["late_frames"] = self._late_frames
        return found
