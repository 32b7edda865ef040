"""Guard of the live page: a token, a size limit, and a list of what browsers may send to viser."""

import asyncio
import dataclasses
import logging
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
import numpy as np

from ..errors import UserError

#: Largest file, for files that arrive at the same time together, and largest message [bytes].
LARGEST_FILE, LARGEST_MESSAGE = 20_000_000, 2**20
#: Messages that a browser may send.
_KINDS = ("ViewerCameraMessage", "GuiUpdateMessage", "FileTransferStartUpload", "FileTransferPart")


def allowed(control: Any, value: Any) -> bool:
    """Whether a control of viser allows a value that a browser sends."""
    import viser

    if control is None or control.disabled:
        return False
    if isinstance(control, viser.GuiCheckboxHandle | viser.GuiButtonHandle):
        return isinstance(value, bool)
    if isinstance(control, viser.GuiDropdownHandle | viser.GuiButtonGroupHandle):
        return isinstance(value, str) and value in control.options
    if isinstance(control, viser.GuiSliderHandle) and type(value) in (int, float):
        return bool(control.min - 1e-6 <= value <= control.max + 1e-6)  # rounded for display
    return False


def permitted(raw: Any, gui: Any) -> bytes:
    """Message for the controls of viser from a browser's message; empty if it is refused."""
    from viser import GuiUploadButtonHandle, _messages

    try:
        fields = msgspec.msgpack.decode(raw)  # as viser does
        kind = _KINDS[_KINDS.index(fields.pop("type"))]
        sent: Any = msgspec.convert(fields, getattr(_messages, kind), builtin_types=(bytes,))
    except (AttributeError, LookupError, RecursionError, TypeError, ValueError):
        return b""
    known, files = gui._gui_input_handle_from_uuid, gui._current_file_upload_states
    if kind == "ViewerCameraMessage":
        fits = np.isfinite(np.hstack(dataclasses.astuple(sent))).all()
    elif kind == "GuiUpdateMessage":
        fits = len(sent.updates) == 1 and allowed(known.get(sent.uuid), sent.updates.get("value"))
    elif not isinstance(known.get(sent.source_component_uuid), GuiUploadButtonHandle):
        fits = False
    elif kind == "FileTransferPart":
        file = files.get(sent.transfer_uuid, {"total_bytes": -1, "transferred_bytes": 0})
        fits = file["transferred_bytes"] + len(sent.content) <= file["total_bytes"]
    else:
        size = sent.size_bytes + sum(file["total_bytes"] for file in files.values())
        if size > LARGEST_FILE or len(files) == 8:  # an empty file, which the page refuses by name
            return msgspec.msgpack.encode(fields | {"type": kind, "size_bytes": 0, "part_count": 0})
        fits = sent.size_bytes >= 0 and sent.part_count in range(1001)
        fits = fits and sent.transfer_uuid not in files
    return raw if fits else b""


@contextmanager
def guarded(token: str) -> Iterator[list[Any]]:
    """Guard the server that is started inside; it gets messages once its `gui` is in the list."""
    import websockets.asyncio.server as kind

    usual, started, guis = kind.serve, list[bool](), list[Any]()

    class Guarded(kind.ServerConnection):
        async def recv(self, decode: bool | None = None) -> Any:
            while True:
                await asyncio.sleep(0.001)  # no flood of messages fills the memory
                if guis and (message := permitted(await super().recv(), *guis)):
                    return message

    def serve(*words: Any, process_request: Any, **options: Any) -> Any:
        def asked(connection: Any, request: Any) -> Any:
            given = request.path.partition("?")[0].strip("/").encode(errors="replace")
            origins = {one.partition("://")[2] for one in request.headers.get_all("Origin")}
            ours = origins <= set(request.headers.get_all("Host"))
            if ours and secrets.compare_digest(given, token.encode()):
                return process_request(connection, dataclasses.replace(request, path="/"))
            return connection.respond(403, "the address needs the token that was printed\n")

        logger = logging.Logger(__name__, logging.CRITICAL + 1)  # wrong requests are not logged
        options |= {"max_size": LARGEST_MESSAGE, "logger": logger, "create_connection": Guarded}
        started.append(True)
        return usual(*words, process_request=asked, **options)

    kind.serve = serve  # type: ignore[assignment, misc]
    try:
        yield guis
    finally:
        kind.serve = usual  # type: ignore[misc]
    if not started:
        raise UserError("this version of viser starts its server in a way that cannot be guarded")
