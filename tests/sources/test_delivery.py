"""Repeated, dropped, stalled and late frames are counted by their definitions."""

import time
import tracemalloc
from collections.abc import Iterable

import numpy as np
import pytest

from chromagrip.render import Frame
from chromagrip.sources.delivery import Delivery, in_words

PERIOD = 1.0 / 60.0
RNG = np.random.default_rng(4)
PICTURES = RNG.integers(0, 256, (2, 48, 64, 3), dtype=np.uint8)


def counted(
    times: Iterable[float], delays: Iterable[float] | None = None, timed: bool = True
) -> Delivery:
    """Delivery of frames with these times, of a live source if they have delays [s]."""
    times = list(times)
    delivery = Delivery()
    delivery.begin(timed=timed, live=delays is not None)
    for k, (instant, delay) in enumerate(zip(times, delays or [0.0] * len(times), strict=True)):
        # The clock of a source counts from elsewhere.
        delivery.add(Frame(image=PICTURES[k % 2], time=instant), 5000.0 + instant + delay)
    return delivery


def every_period(count: int, jitter: float = 0.0) -> np.ndarray:
    """Times of frames that come at a rate, off by up to a share of the period [s]."""
    return PERIOD * (np.arange(count) + RNG.uniform(-jitter, jitter, count))


def test_frames_in_time_count_nothing() -> None:
    counts = counted(every_period(300, jitter=0.1)).counts
    assert counts == {"repeated": 0, "dropped": 0, "stalled": 0, "late": None}


@pytest.mark.parametrize("jitter", [0.0, 0.1])
def test_a_gap_of_some_periods_is_that_many_frames_less_one(jitter: float) -> None:
    missing = {40, 77, 78, 120, 121, 122, 123, 290}
    times = [t for k, t in enumerate(every_period(300, jitter)) if k not in missing]
    counts = counted(times).counts
    assert (counts["dropped"], counts["stalled"]) == (len(missing), 0)
    assert in_words(counts) == "8 dropped"


def test_a_variable_rate_has_times_of_its_own_and_no_drops() -> None:
    times = np.cumsum(np.random.default_rng(1).uniform(0.01, 0.05, 400))
    assert (counted(times).counts["dropped"] or 0) < 4
    assert counted(times).counts["stalled"] == 0


def test_a_rate_that_changes_for_good_is_followed() -> None:
    times = np.concatenate([every_period(100), 100 * PERIOD + 2.0 * every_period(200)])
    assert (counted(times).counts["dropped"] or 0) <= 31


def test_a_stall_is_no_drop() -> None:
    times = every_period(100)
    times[60:] += 0.6
    assert counted(times).counts == {"repeated": 0, "dropped": 0, "stalled": 1, "late": None}
    times[60:] -= 0.2  # 25 periods, but less than 0.5 s
    assert counted(times).counts["stalled"] == 0
    assert counted(times).counts["dropped"] == 24
    slow = np.arange(30.0)
    slow[20:] += 5.0  # more than 0.5 s, but 6 periods
    assert counted(slow).counts["stalled"] == 0
    assert counted(slow).counts["dropped"] == 5


def test_late_is_half_a_period_after_the_usual_delay() -> None:
    delays = np.full(200, 0.030)  # of the exposure and the cable, which is usual
    delays[[50, 51, 160]] += 0.6 * PERIOD
    delays[100] += 0.4 * PERIOD
    counts = counted(every_period(200), delays.tolist()).counts
    assert counts == {"repeated": 0, "dropped": 0, "stalled": 0, "late": 3}


def test_two_clocks_may_drift_apart() -> None:
    """100 millionths, over half an hour: 180 ms, ten periods."""
    times = every_period(30 * 3600)[::20]
    assert counted(times, (1e-4 * times).tolist()).counts["late"] == 0


def test_repeated_is_the_same_bytes() -> None:
    delivery = Delivery()
    delivery.begin(timed=False, live=False)
    other = PICTURES[0].copy()
    other[-1, -1, -1] ^= 1
    for image in (PICTURES[0], PICTURES[0].copy(), other, PICTURES[0], PICTURES[0][:-1]):
        delivery.add(Frame(image=image, time=0.0), 0.0)
    assert delivery.counts == {"repeated": 1, "dropped": None, "stalled": None, "late": None}


def test_what_came_while_nobody_read_is_left_out() -> None:
    """A driver keeps four old frames for a program that is busy; then its own gap follows."""
    delivery, begin = Delivery(), time.monotonic() - 3.0
    delivery.begin(timed=True, live=True)
    sent = [begin + k * PERIOD for k in range(8)]
    for k, instant in enumerate(sent):
        delivery.add(Frame(image=PICTURES[k % 2], time=instant), instant)
    delivery.go_on()
    now = time.monotonic()
    for k in range(8, 12):
        delivery.add(Frame(image=PICTURES[k % 2], time=begin + k * PERIOD), now)
    for k in range(12, 16):
        delivery.add(Frame(image=PICTURES[k % 2], time=now + k * PERIOD), now + k * PERIOD)
    assert in_words(delivery.counts) == ""
    late = now + 17 * PERIOD  # and from here on it counts again
    delivery.add(Frame(image=PICTURES[0], time=late), late + PERIOD)
    assert delivery.counts == {"repeated": 0, "dropped": 1, "stalled": 0, "late": 1}


def test_counting_makes_no_second_picture() -> None:
    delivery = Delivery()
    delivery.begin(timed=True, live=True)
    image = np.full((480, 640, 3), 90, np.uint8)
    frames = [Frame(image=image.copy(), time=k * PERIOD) for k in range(60)]
    delivery.add(frames[0], 0.0)
    tracemalloc.start()
    for frame in frames[1:]:
        delivery.add(frame, frame.time)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert delivery.counts["repeated"] == 59
    assert peak < image.nbytes
