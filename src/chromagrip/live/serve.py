"""Serving the live page on this machine."""

import io
import socket
import time
from collections.abc import Callable
from contextlib import redirect_stdout

from ..errors import UserError
from ..extras import need
from ..scene.scene import Scene
from .page import Page
from .session import Session
from .wishes import scene_for, wishes_of

#: Only programs on this machine reach the page.
HOST = "127.0.0.1"


def serve(
    scene: Scene, port: int, ready: Callable[[str], None], seconds: float | None = None
) -> None:
    """Serve the page of a live grasp until Ctrl-C.

    Parameters
    ----------
    scene: that the sliders change
    port: of the page
    ready: called with the page's address, once it is there
    seconds: end after this time [s]; None goes on

    Raises
    ------
    UserError
        When the port cannot be used, or the scene cannot be shown.
    """
    viser = need("viser", "live")
    check_port(port)
    scene_for(scene, wishes_of(scene))  # what cannot be shown is refused before a page is there
    with redirect_stdout(io.StringIO()):  # it prints a banner of its own
        server = viser.ViserServer(host=HOST, port=port, label="chromagrip", verbose=False)
    try:
        page = Page(server, scene)
        with Session(scene, page.show, page.tell) as session:
            page.connect(session)
            ready(f"http://{HOST}:{port}")
            end = None if seconds is None else time.monotonic() + seconds
            while end is None or time.monotonic() < end:
                time.sleep(0.1)
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()


def check_port(port: int) -> None:
    """Refuse a port that another program has."""
    if not 0 < port < 65536:
        raise UserError(f"port {port} does not exist; allowed are 1 to 65535")
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError as error:
            raise UserError(
                f"port {port} cannot be used: {error.strerror}; choose another with --port"
            ) from None
