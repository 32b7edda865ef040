"""Frames that did not come as they should: repeated, dropped, stalled and late ones."""

import math
import time
from collections import deque
from collections.abc import Mapping, Sequence
from statistics import median
from typing import TypedDict

import cv2
import numpy as np

from ..render import Frame
from .interlaced import Rows


class Counts(TypedDict):
    """Numbers of frames by what happened to them, see `Delivery`; None where it is unknown."""

    repeated: int
    dropped: int | None
    stalled: int | None
    late: int | None


class Delivery:
    """Counts of the frames of a source that did not come as they should.

    - Repeated: it has the same bytes as the frame before.
    - Dropped: a gap of k + 1 periods between a source's own times counts k. The period is the
      median of those of the last 31 gaps that are shorter than 1.5 times their first quartile. If
      more than a quarter of these gaps are not near a whole number of periods, the rate is
      variable, and no frame is counted as dropped.
    - Stalled: a gap of more than 10 periods and at least 0.5 s counts 1, and not as dropped.
    - Late: a frame of a live source came more than half a period after it was due, which is its own
      time and the shortest delay of the source. The delay may grow by 0.1 ms in a second, as two
      clocks differ.

    The first 5 gaps only tell the period. Frames without times of their own are only compared.
    """

    def __init__(self) -> None:
        self.begin(timed=False, live=False)

    def begin(self, timed: bool, live: bool) -> None:
        """Count from the first frame of a source with times of its own, or without."""
        self._timed, self._live = timed, live
        self._repeated = self._dropped = self._stalled = self._late = 0
        self._before: Frame | None = None
        self._gaps = deque[float](maxlen=31)
        self._delay, self._since = math.inf, -math.inf
        self._rows = Rows()

    def go_on(self) -> None:
        """Leave out what a live source sent before now, as nobody was reading."""
        self._since = time.monotonic()

    @property
    def counts(self) -> Counts:
        """Counts so far."""
        return {
            "repeated": self._repeated,
            "dropped": self._dropped if self._timed else None,
            "stalled": self._stalled if self._timed else None,
            "late": self._late if self._live else None,
        }

    @property
    def doubt(self) -> str:
        """What is wrong with the frames themselves, in words; empty if nothing is."""
        return self._rows.doubt

    def add(self, frame: Frame, arrived: float) -> None:
        """Count a frame.

        Parameters
        ----------
        frame: frame with its own time, which is not before that of the last one
        arrived: time of its arrival, by `time.monotonic` [s]
        """
        before, self._before = self._before, frame
        self._rows.add(frame.image)
        if before is not None:
            a, b = before.image, frame.image
            # Faster than NumPy, and without an array of the differences.
            self._repeated += a.shape == b.shape and cv2.norm(a, b, cv2.NORM_INF) == 0.0
        if not self._timed:
            return
        gap = 0.0 if before is None else frame.time - before.time
        self._delay = min(self._delay + 1e-4 * gap, arrived - frame.time)
        read = before is not None and before.time + self._delay >= self._since
        if len(self._gaps) >= 5 and (read or not self._live):
            self._judge(gap, arrived - frame.time - self._delay)
        if gap > 0.0:
            self._gaps.append(gap)

    def _judge(self, gap: float, late: float) -> None:
        """Count a frame by the gap before it, and by the time since it was due [s]."""
        gaps = sorted(self._gaps)
        period = median(each for each in gaps if each <= 1.5 * gaps[len(gaps) // 4])
        if gap > 10.0 * period and gap >= 0.5:
            self._stalled += 1
        elif gap >= 1.5 * period:
            off = sum(abs(each / period - round(each / period)) > 0.25 for each in gaps)
            self._dropped += round(gap / period) - 1 if 4 * off <= len(gaps) else 0
        self._late += self._live and late > 0.5 * period


def in_words(counts: Mapping[str, object]) -> str:
    """Counts that are not zero, such as `3 repeated, 12 dropped`; empty if all are."""
    return ", ".join(f"{count} {name}" for name, count in counts.items() if count)


class Lateness(TypedDict):
    """Time of a reading in percentiles [ms], and number of frames that took longer than a period.

    Both are None where nothing was read.
    """

    reading_ms: dict[str, float] | None
    late_frames: int | None


def lateness(seconds: Sequence[float], period: float) -> Lateness:
    """Lateness of readings that took so long, of frames a period apart [s]."""
    if not len(seconds):
        return {"reading_ms": None, "late_frames": None}
    milliseconds = 1e3 * np.asarray(seconds)
    shares = {"median": 50.0, "p95": 95.0, "p99": 99.0, "worst": 100.0}
    return {
        "reading_ms": {
            name: float(np.percentile(milliseconds, share)) for name, share in shares.items()
        },
        "late_frames": int((milliseconds > 1e3 * period).sum()),
    }
