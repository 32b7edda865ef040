"""Checks of the requests and messages that reach the page.

Requests need the token. Messages are parsed strictly before they reach viser, which does not check
values.
"""

import asyncio
import http
import logging
import math
import secrets
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING, Annotated, Any
from urllib.parse import parse_qs, urlsplit

import msgspec
from msgspec import Meta

from ..errors import UserError

if TYPE_CHECKING:
    import viser

#: Largest accepted file [bytes]; files that arrive at the same time share it.
LARGEST_FILE = 20_000_000
#: Pause after each message of a browser, so that no flood of them fills the memory [s].
_PAUSE = 0.001

_Text = Annotated[str, Meta(max_length=255)]
_Number = Annotated[float, Meta(ge=-1e9, le=1e9)]
_Count = Annotated[int, Meta(ge=0, le=2**40)]
_Vector = tuple[_Number, _Number, _Number]


class _Message(msgspec.Struct, tag_field="type", forbid_unknown_fields=True):
    """A message that a browser may send."""


class _Value(msgspec.Struct, forbid_unknown_fields=True):
    """New value of a control."""

    value: bool | int | float | _Text


class _Update(_Message, tag="GuiUpdateMessage"):
    """A control was changed."""

    uuid: _Text
    updates: _Value


class _Camera(_Message, tag="ViewerCameraMessage"):
    """The view was turned; the first such message announces the browser."""

    wxyz: tuple[_Number, _Number, _Number, _Number]
    position: _Vector
    fov: _Number
    near: _Number
    far: _Number
    image_height: _Count
    image_width: _Count
    look_at: _Vector
    up_direction: _Vector


class _FileStart(_Message, tag="FileTransferStartUpload"):
    """A file will be sent."""

    source_component_uuid: _Text
    transfer_uuid: _Text
    filename: _Text
    mime_type: _Text
    part_count: _Count
    size_bytes: _Count


class _FilePart(_Message, tag="FileTransferPart"):
    """A part of a file."""

    source_component_uuid: _Text
    transfer_uuid: _Text
    part_index: _Count
    content: bytes


_DECODER: msgspec.msgpack.Decoder[_Update | _Camera | _FileStart | _FilePart] = (
    msgspec.msgpack.Decoder(_Update | _Camera | _FileStart | _FilePart)
)


@dataclass
class Inbox:
    """Messages of all browsers; viser gets those that a page of ours can send.

    Attributes
    ----------
    server: server whose controls determine the allowed values; None refuses all messages
    """

    server: "viser.ViserServer | None" = None
    _files: dict[str, tuple[_FileStart, dict[int, bytes]]] = field(default_factory=dict)

    def taken(self, raw: str | bytes, before: str) -> list[bytes]:
        """Messages for viser from a browser's message; empty if it is refused.

        They are encoded again, so that viser never gets a browser's own bytes.

        Parameters
        ----------
        raw: message of the browser
        before: beginning of the names of that browser's files
        """
        try:
            message = _DECODER.decode(raw if isinstance(raw, bytes) else b"")
        except (msgspec.MsgspecError, RecursionError, ValueError):
            return []
        found: list[_Message] = []
        if isinstance(message, _Camera):
            found = [message]
        elif isinstance(message, _Update):
            value = allowed(self._control(message.uuid), message.updates.value)
            if value is not None:
                found = [_Update(uuid=message.uuid, updates=_Value(value=value))]
        elif isinstance(message, _FileStart):
            found = self._begin(message, before + message.transfer_uuid)
        else:
            found = self._append(message, before + message.transfer_uuid)
        return [msgspec.msgpack.encode(one) for one in found]

    def leave(self, before: str) -> None:
        """Forget the unfinished files of a browser that has disconnected."""
        self._files = {name: of for name, of in self._files.items() if not name.startswith(before)}

    def _control(self, uuid: str) -> Any:
        gui = None if self.server is None else self.server.gui
        return None if gui is None else gui._gui_input_handle_from_uuid.get(uuid)

    def _begin(self, start: _FileStart, name: str) -> list[_Message]:
        """Note a file; one that is too large is replaced by an empty one, which a page refuses."""
        import viser

        control = self._control(start.source_component_uuid)
        if not isinstance(control, viser.GuiUploadButtonHandle) or name in self._files:
            return []
        size = start.size_bytes + sum(one.size_bytes for one, _ in self._files.values())
        most_files = 8  # largest number of files that arrive at a time
        if not start.size_bytes or size > LARGEST_FILE or len(self._files) == most_files:
            return [_renamed(start, 0)]
        most_parts = 1000  # the largest file needs 39
        if 0 < start.part_count <= most_parts:
            self._files[name] = start, {}
        return []

    def _append(self, part: _FilePart, name: str) -> list[_Message]:
        """Keep a part; viser gets the file once it is whole."""
        start, parts = self._files.get(name, (None, {}))
        if start is None or part.source_component_uuid != start.source_component_uuid:
            return []
        fits = part.part_index < start.part_count and part.part_index not in parts
        parts[part.part_index] = part.content
        size, whole = sum(map(len, parts.values())), len(parts) == start.part_count
        if fits and size <= start.size_bytes and not whole:
            return []
        del self._files[name]
        if not fits or size != start.size_bytes:
            return []
        content = b"".join(parts[k] for k in range(start.part_count))
        first = _renamed(start, size)
        one = _FilePart(first.source_component_uuid, first.transfer_uuid, 0, content)
        return [first, one]


def _renamed(start: _FileStart, size: int) -> _FileStart:
    """File of one part; all have one name, because viser keeps an answer for each name."""
    return msgspec.structs.replace(
        start, transfer_uuid="file", part_count=min(size, 1), size_bytes=size
    )


def allowed(control: Any, value: Any) -> Any:
    """Value that a control allows; None if it is refused.

    Parameters
    ----------
    control: handle of viser
    value: value that a browser sends
    """
    import viser

    if control is None or control.disabled:
        return None
    if isinstance(control, viser.GuiCheckboxHandle | viser.GuiButtonHandle):
        return value if isinstance(value, bool) else None
    if isinstance(control, viser.GuiDropdownHandle | viser.GuiButtonGroupHandle):
        return value if isinstance(value, str) and value in control.options else None
    number = isinstance(value, int | float) and not isinstance(value, bool)
    rounded = 1e-6  # error of a number that the browser rounded for its display
    if isinstance(control, viser.GuiSliderHandle) and number:
        low, high = control.min, control.max
        if not (math.isfinite(value) and low - rounded <= value <= high + rounded):
            return None
        whole = isinstance(control.value, int)
        if whole and value != round(value):
            return None
        return (int if whole else float)(min(max(value, low), high))
    return None  # a file, which has its own messages, or a kind that no page has


@dataclass(frozen=True, kw_only=True)
class Gate:
    """Decides which requests are answered.

    Attributes
    ----------
    token: token that a request must have in its address or as a cookie
    port: port of the page; a browser sends a cookie to every port of a host
    """

    token: str
    port: int

    @property
    def cookie(self) -> str:
        """Name of the cookie that keeps the token."""
        return f"chromagrip-{self.port}"

    def refusal(self, path: str, headers: Any) -> str:
        """Reason for which a request is refused; "" if it may pass.

        Parameters
        ----------
        path: requested path
        headers: headers of the request
        """
        try:
            host, origin = headers.get("Host", ""), headers.get("Origin")
            if origin is not None and urlsplit(origin).netloc != host:
                return "a page of another site may not use this server"
            if not any(map(self._right, self._given(path, headers))):
                return "the address needs the token that `chromagrip live` printed"
        except (ValueError, LookupError):  # an invalid address, or a repeated header
            return "this is not a request of a browser"
        return ""

    def keeps(self, path: str) -> bool:
        """Return True if a request's address has the token, which then becomes a cookie."""
        return any(map(self._right, _in_address(path)))

    def _right(self, given: str) -> bool:
        return secrets.compare_digest(given.encode(), self.token.encode())

    def _given(self, path: str, headers: Any) -> list[str]:
        """Tokens in a request's address and cookies."""
        kept = SimpleCookie()
        try:
            kept.load(headers.get("Cookie", ""))
        except CookieError:
            return _in_address(path)
        found = [kept[self.cookie].value] if self.cookie in kept else []
        return [*_in_address(path), *found]


def _in_address(path: str) -> list[str]:
    return parse_qs(urlsplit(path).query).get("token", [])


class _Checked:
    """A browser's connection that passes only allowed messages to viser."""

    def __init__(self, connection: Any, inbox: Inbox) -> None:
        self._connection, self._inbox = connection, inbox
        self.name = f"{id(connection)} "
        self._taken: deque[bytes] = deque()

    def __getattr__(self, name: str) -> Any:
        """Attribute of the connection."""
        return getattr(self._connection, name)

    async def recv(self) -> bytes:
        """Wait for the next message; the messages of one file come together."""
        while not self._taken:
            await asyncio.sleep(_PAUSE)
            self._taken.extend(self._inbox.taken(await self._connection.recv(), self.name))
        return self._taken.popleft()


@contextmanager
def guarded(gate: Gate) -> Iterator[Inbox]:
    """Make each server that is started inside ask the gate before it answers.

    viser has no option for that: the function with which it starts its server is replaced inside.
    Messages pass through the inbox.

    Raises
    ------
    UserError
        At the end, if no server was started with that function: it would be open.
    """
    import viser
    import websockets.asyncio.server as kind

    usual: Any = kind.serve
    used, inbox = [], Inbox()
    silent = logging.getLogger(f"{__name__}.{gate.port}")  # wrong requests are not logged
    silent.propagate = False
    silent.addHandler(logging.NullHandler())

    # Largest message [bytes]; the browser cuts files into parts of half of that.
    largest_message = 2**20

    def serve(met: Any, *words: Any, process_request: Callable[..., Any], **options: Any) -> Any:
        def asked(connection: Any, request: Any) -> Any:
            why = gate.refusal(request.path, request.headers)
            if why:
                return connection.respond(http.HTTPStatus.FORBIDDEN, f"{why}\n")
            answer = process_request(connection, request)
            if answer is not None and gate.keeps(request.path):
                kept = f"{gate.cookie}={gate.token}; HttpOnly; SameSite=Strict; Path=/"
                answer.headers["Set-Cookie"] = kept
            return answer

        async def read(connection: Any) -> None:
            if connection.subprotocol != f"viser-v{viser.__version__}":  # viser would print it
                await connection.close(1002, "this is the page of another version; load it again")
                return
            checked = _Checked(connection, inbox)
            try:
                await met(checked)
            finally:
                inbox.leave(checked.name)

        used.append(True)
        options |= {"max_size": largest_message, "logger": silent}
        return usual(read, *words, process_request=asked, **options)

    kind.serve = serve  # type: ignore[assignment, misc]
    try:
        yield inbox
    finally:
        kind.serve = usual  # type: ignore[misc]
    if not used:
        raise UserError("this version of viser starts its server in a way that cannot be guarded")
