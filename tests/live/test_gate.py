"""Who is answered: this machine alone, or those that bring the token."""

import http.client
import re
import socket
from collections.abc import Callable
from contextlib import closing
from subprocess import CompletedProcess
from typing import Any
from urllib.parse import quote

import pytest

from chromagrip import UserError
from chromagrip.live.gate import Gate, guarded
from chromagrip.live.serve import Address, announce, serving, token_for

TOKEN = "abcdefgh-ijklmnop_1234"
Typed = Callable[..., CompletedProcess[str]]


def ask(port: int, path: str = "/", **headers: str) -> http.client.HTTPResponse:
    with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=10)) as connection:
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        if answer.status != 101:
            answer.read()
        answer.close()
        return answer


def handshake(port: int, path: str = "/", **headers: str) -> int:
    """Status of a websocket's first answer."""
    upgrade = {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version": "13",
    }
    return ask(port, path, **{**upgrade, **headers}).status


def test_pages_of_other_sites_are_refused(port: int) -> None:
    with serving(Address(port=port, token=TOKEN)):
        path = f"/?token={TOKEN}"
        assert handshake(port, path, Origin=f"http://127.0.0.1:{port}") == 101
        for origin in ("http://other.example", f"http://localhost:{port}", "null"):
            assert handshake(port, path, Origin=origin) == 403
            assert ask(port, path, Origin=origin).status == 403
        # A name of another site that was made to lead here has no token.
        assert ask(port, Host=f"other.example:{port}").status == 403
        assert handshake(port, Host=f"other.example:{port}") == 403
        assert ask(port, path, Host="localhost:9000").status == 200  # as through ssh -L


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "0.0.0.0"])
def test_every_page_is_for_its_user_alone(port: int, host: str) -> None:
    """Other users of this machine reach the port, too."""
    said: list[str] = []
    address = Address(host=host, port=port, ready=said.append)
    with serving(address) as server:
        announce(address, server)
        printed = said[0].partition(f":{port}")[2]
        assert re.fullmatch(r"/\?token=[\w-]{32}", printed)
        assert ask(port, printed).status == 200
        assert handshake(port, printed) == 101
        other = printed[:-1] + ("a" if printed[-1] != "a" else "b")
        for path in ("/", "/index.html", other, printed[:-1], f"{printed}x", "/?token=",
                     f"/?token=%00{printed[8:]}", "/?token=%ed%a0%80",
                     "/?token=\u00e9"):  # fmt: skip
            assert ask(port, quote(path, "/?=%")).status == 403
            assert handshake(port, quote(path, "/?=%")) == 403


def test_a_weak_token_opens_nothing(port: int) -> None:
    weak = Address(port=port, token="")
    with pytest.raises(UserError, match="--token: expected 16"), serving(weak):
        pass


def test_a_token_is_asked_for_and_becomes_a_cookie(port: int) -> None:
    with serving(Address(port=port, token=TOKEN)):
        for path in ("/", "/?token=wrong", "/?token=", "/assets/x.js", f"/?tokens={TOKEN}"):
            assert ask(port, path).status == 403
            assert handshake(port, path) == 403
        first = ask(port, f"/?token={TOKEN}")
        assert first.status == 200
        cookie = first.getheader("Set-Cookie")
        assert cookie is not None
        assert re.fullmatch(rf"(\S+={TOKEN}); HttpOnly; SameSite=Strict; Path=/", cookie)
        kept = cookie.split(";")[0]
        assert ask(port, Cookie=kept).status == 200
        assert handshake(port, Cookie=kept) == 101
        assert handshake(port, Cookie=kept, Origin="http://other.example") == 403
        assert handshake(port, Cookie=kept.replace("a", "b")) == 403
        assert ask(port, Host="some.name", Cookie=kept).status == 200


def test_the_printed_address_has_the_token(port: int) -> None:
    said: list[str] = []
    address = Address(host="0.0.0.0", port=port, token=TOKEN, ready=said.append)
    with serving(address) as server:
        announce(address, server)
    assert said == [f"http://{socket.gethostname()}:{port}/?token={TOKEN}"]


def test_a_token_is_new_or_given() -> None:
    assert len(token_for()) >= 32
    assert token_for() != token_for()
    assert token_for(TOKEN) == TOKEN
    for bad in ("", "short", "with a space and more", 'with"quote_and_more'):
        with pytest.raises(UserError, match="--token: expected 16 or more"):
            token_for(bad)


def test_a_server_that_does_not_ask_is_refused() -> None:
    with pytest.raises(UserError, match="cannot be guarded"), guarded(Gate(token="", port=1)):
        pass


def test_nothing_is_printed_at_the_end(port: int, capsys: Any) -> None:
    with serving(Address(port=port, token=TOKEN)):
        assert ask(port, f"/?token={TOKEN}").status == 200
    assert capsys.readouterr() == ("", "")


def test_addresses_that_cannot_be_used(typed: Typed) -> None:
    for words, sentence in (
        (("--host", "192.0.2.7"), "host 192.0.2.7 is not an address of this machine"),
        (("--token", "short"), "--token: expected 16 or more"),
        (("--port", "0"), "port 0 does not exist"),
        (("--run", "nowhere"), "nowhere is not a run folder"),
        (("--rest", "first"), "--rest is an option of --source"),
        (("dome-1", "--run", "x"), "--run has a scene of its own"),
        (("--source", "x"), "--source needs --calibration"),
        (("--source", "x", "--run", "y"), "--run and --source are two pages"),
        (("--source", "x", "--calibration", "flat-2019"), "is for a flat pad"),
    ):
        done = typed("live", *words)
        assert done.returncode == 2
        assert re.fullmatch(rf"chromagrip: .*{re.escape(sentence)}.*\n", done.stderr), done.stderr
