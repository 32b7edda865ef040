"""Who may reach the page: programs on this machine, or those that know a token."""

import http
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

from ..errors import UserError

#: Names of this machine by which a browser on it may ask.
LOCAL = ("127.0.0.1", "localhost", "::1")


@dataclass(frozen=True, kw_only=True)
class Gate:
    """Decides which requests are answered.

    Attributes
    ----------
    token: that a request must bring, in its address or as a cookie; "" asks for none, and answers
        only requests to a name of this machine, which a page of another site cannot send
    port: of the page; a browser sends a cookie to every port of a host
    """

    token: str
    port: int

    @property
    def cookie(self) -> str:
        """Name of the cookie that keeps the token."""
        return f"chromagrip-{self.port}"

    def refusal(self, path: str, headers: Any) -> str:
        """Why a request is refused; "" where it may pass.

        Parameters
        ----------
        path: that is asked for
        headers: of the request
        """
        try:
            host, origin = headers.get("Host", ""), headers.get("Origin")
            if not self.token and urlsplit(f"//{host}").hostname not in LOCAL:
                return "ask for this page at 127.0.0.1"
            if origin is not None and urlsplit(origin).netloc != host:
                return "a page of another site may not use this server"
            if self.token and not any(map(self._right, self._given(path, headers))):
                return "the address needs the token that `chromagrip live` printed"
        except (ValueError, LookupError):  # no address, or a header that is there twice
            return "this is no request of a browser"
        return ""

    def keeps(self, path: str) -> bool:
        """Whether a request's address brings the token, so that it becomes a cookie."""
        return bool(self.token) and any(map(self._right, _in_address(path)))

    def _right(self, given: str) -> bool:
        return secrets.compare_digest(given.encode(), self.token.encode())

    def _given(self, path: str, headers: Any) -> list[str]:
        """Tokens that a request brings."""
        kept = SimpleCookie()
        try:
            kept.load(headers.get("Cookie", ""))
        except CookieError:
            return _in_address(path)
        found = [kept[self.cookie].value] if self.cookie in kept else []
        return [*_in_address(path), *found]


def _in_address(path: str) -> list[str]:
    return parse_qs(urlsplit(path).query).get("token", [])


@contextmanager
def guarded(gate: Gate) -> Iterator[None]:
    """Let each server that is started meanwhile ask the gate before it answers.

    viser has no place for that: what it starts its server with is replaced for this moment.

    Raises
    ------
    UserError
        At the end, when no server was started in that way; it would be open.
    """
    import websockets.asyncio.server as kind

    usual: Any = kind.serve
    used = []

    def serve(*words: Any, process_request: Callable[..., Any], **options: Any) -> Any:
        def checked(connection: Any, request: Any) -> Any:
            why = gate.refusal(request.path, request.headers)
            if why:
                return connection.respond(http.HTTPStatus.FORBIDDEN, f"{why}\n")
            answer = process_request(connection, request)
            if answer is not None and gate.keeps(request.path):
                kept = f"{gate.cookie}={gate.token}; HttpOnly; SameSite=Strict; Path=/"
                answer.headers["Set-Cookie"] = kept
            return answer

        used.append(True)
        return usual(*words, process_request=checked, **options)

    kind.serve = serve  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        kind.serve = usual  # type: ignore[misc]
    if not used:
        raise UserError("this version of viser starts its server in a way that cannot be guarded")
