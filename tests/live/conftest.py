"""What tests of the live page share."""

import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from chromagrip.loop.run import run
from chromagrip.scene import load_scene

#: Changes of `dome-1` in the run that tests share.
DOME_RUN = {
    "path": "camera", "duration_s": 0.1, "camera.rate_hz": 50.0, "camera.rest_frames": 2,
}  # fmt: skip


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


@pytest.fixture(scope="session")
def dome_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run folder of a dome through its camera, with its pictures; not to be changed."""
    folder = tmp_path_factory.mktemp("runs") / "dome"
    run(load_scene("dome-1", DOME_RUN), folder, frames="png")
    return folder
