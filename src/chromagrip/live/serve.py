"""Serve the live page: of a grasp, of a finished run, or of a camera."""

import errno
import io
import secrets
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import UserError
from ..extras import need
from ..scene.scene import Scene
from .guard import guarded
from .page import Page
from .record import Recorder
from .session import Session

if TYPE_CHECKING:
    import viser


def token_for(given: str | None = None) -> str:
    """Token of a page: the given one, or a new one.

    Raises
    ------
    UserError
        For a token that is easily guessed, or that is not possible in an address.
    """
    token = secrets.token_urlsafe(24) if given is None else given
    if len(token) < 16 or not all(c.isascii() and (c.isalnum() or c in "-_.") for c in token):
        raise UserError(
            "--token: expected 16 or more letters, digits, -, _ or .; leave it out to get one"
        )
    return token


@dataclass(frozen=True, kw_only=True)
class Address:
    """Address of a page, and how long it is served.

    Attributes
    ----------
    host: host of the page; by default only programs on this machine reach it
    port: port of the page (default 8090)
    token: token that every request needs, also from other users of this machine (default: random)
    seconds: time after which the page ends (default: no limit) [s]
    ready: function called with the page's address, once it can be opened (default `print`)
    """

    host: str = "127.0.0.1"
    port: int = 8090
    token: str = field(default_factory=token_for)
    seconds: float | None = None
    ready: Callable[[str], None] = print


def serve_grasp(
    scene: Scene,
    address: Address,
    recordings: Path,
    prepare: Callable[[], None] = lambda: None,
    tell: Callable[[str], None] = lambda _: None,
) -> None:
    """Serve the page of a live grasp until Ctrl-C.

    Parameters
    ----------
    scene: scene that the sliders change
    address: address of the page
    recordings: folder in which each recording gets a folder
    prepare: function called before the first frame, once the page can be opened
    tell: function called with a sentence about the first frame: awaited, then shown

    Raises
    ------
    UserError
        When the address cannot be used.
    """
    with serving(address) as server, Page(server, scene) as page:
        announce(address, server)
        tell("waiting for the first frame: kernels are loaded, in a new installation compiled")
        prepare()
        recorder = Recorder(recordings, page.tell_kept)
        with Session(scene, page.show, page.tell, recorder) as session:
            page.connect(session)
            told = False
            for _ in ticks(address.seconds):
                session.check()
                if page.started and not told:
                    tell("the grasp is running")
                    told = True


@contextmanager
def serving(address: Address) -> "Iterator[viser.ViserServer]":
    """Start a server at an address; a context, at whose end it stops.

    Raises
    ------
    UserError
        When the address cannot be used.
    """
    viser = need("viser", "live")
    check_port(address.host, address.port)
    before = set(threading.enumerate())
    token = token_for(address.token)
    with redirect_stdout(io.StringIO()), guarded(token) as guis:  # it prints a banner
        server = viser.ViserServer(
            host=address.host, port=address.port, label="chromagrip", verbose=False
        )
    guis.append(server.gui)
    own = set(threading.enumerate()) - before
    longest_wait = 3.0  # longest wait for the server's threads to end [s]
    try:
        yield server
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()
            end = time.monotonic() + longest_wait
            for thread in own:  # they close the connections
                thread.join(max(0.0, end - time.monotonic()))


def announce(address: Address, server: "viser.ViserServer") -> None:
    """Report the page's address with its token."""
    shown = socket.gethostname() if address.host in ("0.0.0.0", "::") else address.host
    shown = f"[{shown}]" if ":" in shown else shown
    address.ready(f"http://{shown}:{server.get_port()}/{address.token}")


def ticks(seconds: float | None, every: float = 0.1) -> Iterator[None]:
    """Yield at intervals `every` [s], until `seconds` have passed."""
    end = None if seconds is None else time.monotonic() + seconds
    while end is None or time.monotonic() < end:
        yield
        time.sleep(every)


def check_port(host: str, port: int) -> None:
    """Refuse a host that is not this machine's, and a port that another program uses."""
    if not 0 < port < 65536:
        raise UserError(f"port {port} does not exist; allowed are 1 to 65535")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            if isinstance(error, socket.gaierror) or error.errno == errno.EADDRNOTAVAIL:
                raise UserError(f"host {host} is not an address of this machine") from None
            raise UserError(
                f"port {port} cannot be used: {error.strerror}; choose another with --port"
            ) from None
