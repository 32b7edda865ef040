"""Frames as they come, read in a thread of their own."""

import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from chromagrip import UserError
from chromagrip.render import Frame
from chromagrip.sources import Source
from chromagrip.sources.feed import Feed


def frames(count: int) -> Iterator[Frame]:
    for k in range(count):
        yield Frame(image=np.full((4, 6, 3), k, np.uint8), time=0.01 * k)


def test_a_camera_that_stalls_is_one_sentence() -> None:
    stop = threading.Event()

    def stalling() -> Iterator[Frame]:
        yield from frames(3)
        stop.wait(20.0)

    feed = Feed(Source(name="camera:7", frames=stalling, count=None, fps=100.0), 0.2)
    assert [feed.next() is not None for _ in range(3)] == [True] * 3
    with pytest.raises(UserError, match=r"^camera:7 gave no frame within 0\.2 s after 3 frames$"):
        feed.next()
    feed.close()
    stop.set()


def test_a_live_camera_is_not_followed_late() -> None:
    """The newest frame is what a slow loop gets next; every frame of another source comes."""
    sent = threading.Event()

    def all_at_once() -> Iterator[Frame]:
        yield from frames(20)
        sent.set()
        time.sleep(0.5)

    for live in (True, False):
        sent.clear()
        source = Source(name="x", frames=all_at_once, count=None, fps=100.0, live=live)
        feed = Feed(source, 5.0)
        if live:
            assert sent.wait(5.0)
        got = []
        while (frame := feed.next()) is not None:
            got.append(int(frame.image[0, 0, 0]))
        assert got == ([19] if live else list(range(20)))
        assert feed.skipped == (19 if live else 0)
