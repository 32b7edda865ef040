"""What tests of the live page share."""

import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest


@pytest.fixture
def port() -> int:
    """A port that no program has."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        number: int = free.getsockname()[1]
        return number


@pytest.fixture
def viser_server(port: int) -> Iterator[Any]:
    """A server without a page."""
    from chromagrip.live.serve import Address, serving

    with serving(Address(port=port)) as server:
        yield server


@pytest.fixture
def until() -> Callable[..., None]:
    """Waits for a condition."""

    def wait(condition: Callable[[], object], seconds: float = 60.0) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if condition():
                return
            time.sleep(0.05)
        raise AssertionError("it did not come to this")

    return wait
