"""A source that stops giving frames is refused; that it is followed is in the contract."""

import threading
from collections.abc import Iterator

import numpy as np
import pytest

from chromagrip import UserError
from chromagrip.render import Frame
from chromagrip.sources import Source
from chromagrip.sources.feed import Feed


def test_a_camera_that_stalls_is_one_sentence() -> None:
    stop = threading.Event()

    def stalling() -> Iterator[Frame]:
        for k in range(3):
            yield Frame(image=np.full((4, 6, 3), k, np.uint8), time=0.01 * k)
        stop.wait(20.0)

    feed = Feed(Source(name="camera:7", frames=stalling, count=None, fps=100.0), 0.2)
    assert [feed.next() is not None for _ in range(3)] == [True] * 3
    with pytest.raises(UserError, match=r"^camera:7 gave no frame within 0\.2 s after 3 frames$"):
        feed.next()
    feed.close()
    stop.set()
