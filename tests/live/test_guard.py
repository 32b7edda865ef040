"""Who is answered: those that bring the token, from no page of another site."""

import http.client
import importlib.metadata
import re
import socket
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any
from urllib.parse import quote

import pytest

from chromagrip import UserError
from chromagrip.live.guard import guarded
from chromagrip.live.serve import Address, announce, check_port, serving, token_for

TOKEN = "abcdefgh-ijklmnop_1234"
UPGRADE = {
    "Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
    "Sec-WebSocket-Protocol": f"viser-v{importlib.metadata.version('viser')}",
}  # fmt: skip
Typed = Callable[..., CompletedProcess[str]]


def ask(port: int, path: str, **headers: str) -> set[int]:
    """Statuses of the answers to a page's request and to a websocket's."""
    found = set()
    for more in ({}, UPGRADE):
        with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=10)) as connection:
            connection.request("GET", path, headers=more | headers)
            with closing(connection.getresponse()) as answer:
                found.add(answer.status)
    return found


def test_pages_of_other_sites_are_refused(port: int) -> None:
    with serving(Address(port=port, token=TOKEN)):
        for path in (f"/{TOKEN}", f"/{TOKEN}/", f"/{TOKEN}?websocket=x"):
            assert ask(port, path, Origin=f"http://127.0.0.1:{port}") == {200, 101}
        for origin in ("http://other.example", f"http://localhost:{port}", "null"):
            assert ask(port, f"/{TOKEN}", Origin=origin) == {403}
        # A name of another site that was made to lead here has no token.
        assert ask(port, "/", Host=f"other.example:{port}") == {403}
        assert ask(port, f"/{TOKEN}", Host="localhost:9000") == {200, 101}  # as through ssh -L


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "0.0.0.0"])
def test_every_page_is_for_its_user_alone(port: int, host: str, capsys: Any) -> None:
    """Other users of this machine reach the port, too."""
    said: list[str] = []
    address = Address(host=host, port=port, ready=said.append)
    with serving(address) as server:
        announce(address, server)
        name, _, printed = said[0].partition(f":{port}")
        assert name == f"http://{socket.gethostname() if host == '0.0.0.0' else host}"
        assert re.fullmatch(r"/[\w-]{32}", printed)
        assert ask(port, printed) == {200, 101}
        other = printed[:-1] + ("a" if printed[-1] != "a" else "b")
        for path in ("/", "/index.html", other, printed[:-1], f"{printed}x", f"/x{printed}",
                     f"{printed}/index.html", f"/?token={printed[1:]}", f"/%00{printed[1:]}",
                     "/%ed%a0%80", "/\u00e9", f"{printed}/../x"):  # fmt: skip
            assert ask(port, quote(path, "/?=%")) == {403}
    assert capsys.readouterr() == ("", "")


def test_a_token_is_new_or_given(port: int) -> None:
    assert len(token_for()) >= 32
    assert token_for() != token_for()
    assert token_for(TOKEN) == TOKEN
    for bad in ("", "short", "with a space and more", 'with"quote_and_more'):
        with pytest.raises(UserError, match="--token: expected 16 or more"):
            token_for(bad)
    weak = Address(port=port, token="")
    with pytest.raises(UserError, match="--token: expected 16"), serving(weak):
        pass
    with (
        socket.create_server(("127.0.0.1", port)),
        pytest.raises(UserError, match="cannot be used"),
    ):
        check_port("127.0.0.1", port)


def test_a_server_that_does_not_ask_is_refused() -> None:
    with pytest.raises(UserError, match="cannot be guarded"), guarded(TOKEN):
        pass


def test_addresses_and_sources_that_cannot_be_used(typed: Typed, tmp_path: Path) -> None:
    pinch = Path(__file__).parents[2] / "fixtures/written-before/pinch"
    of = "--calibration"
    for words, sentence in (
        (("--host", "192.0.2.7"), "host 192.0.2.7 is not an address of this machine"),
        (("--port", "0"), "port 0 does not exist"),
        (("--rest", "first"), "--rest is an option of --source"),
        (("dome-1", "--run", "x"), "--run has a scene of its own"),
        (("--source", "x"), "--source needs --calibration"),
        (("--source", "x", "--run", "y"), "--run and --source are two pages"),
        (("--source", "camera:37", of, "thesis"), "camera 37 cannot be opened"),
        (("--source", "nothing.mp4", of, "thesis"), "there is no nothing.mp4"),
        (("--run", tmp_path), "is not a finished run: it has no summary.json"),
        (("--run", pinch), f"see report.html of {pinch}: the live page shows one finger"),
    ):
        done = typed("live", *words)
        assert (done.returncode, done.stdout) == (2, "")
        assert re.fullmatch(rf"chromagrip: .*{re.escape(sentence)}.*\n", done.stderr), done.stderr
