"""Every message of a browser is input: what is not allowed changes nothing and ends nothing."""

import importlib.metadata
import math
import random
import resource
import socket
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import pytest
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from chromagrip import load_scene
from chromagrip.live.guard import LARGEST_FILE, allowed, permitted
from chromagrip.live.page import Page
from chromagrip.live.replay import Replay
from chromagrip.live.run_page import RunPage
from chromagrip.live.serve import Address, serving
from chromagrip.live.view import GraspView
from chromagrip.live.watch import Looking, WatchPage
from chromagrip.loop.results.run_folder import read_run

from .judged import few_and_many, repeated

TOKEN = "abcdefgh-ijklmnop_1234"
VERSION = f"viser-v{importlib.metadata.version('viser')}"
DOME = Path(__file__).parents[2] / "fixtures/written-before/dome"
pack, unpack = msgspec.msgpack.encode, msgspec.msgpack.decode
#: Values that no control allows.
BAD: tuple[Any, ...] = (
    None, math.nan, math.inf, 1e308, 2**63, -1e9, "", "pwn:C", "x" * 100_000, "nan", b"true", [],
    [1.0], {}, {"name": "a", "content": b""}, [[[[[1]]]]], msgspec.Raw(b"\xd4\x01\x02"),
)  # fmt: skip
CAMERA: dict[str, Any] = {
    "type": "ViewerCameraMessage", "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [1, 2, 3],
    "fov": 1.0, "near": 0.01, "far": 1000, "image_height": 100, "image_width": 100,
    "look_at": [0, 0, 0], "up_direction": [0, 0, 1],
}  # fmt: skip
#: Messages that are none, or of kinds that no page of ours sends.
GARBAGE: tuple[bytes, ...] = (
    b"", b"\xc1", b"\x91" * 50_000, b"\xdd\xff\xff\xff\xff", b"\xa3\xff\xfe\xfd", bytes(700_000),
    *(pack({"type": kind, "uuid": "x"}) for kind in ("ShareUrlRequest", "GuiUpdateMessage", None)),
    # A message of two kinds: who reads the first kind and who reads the last one would differ.
    b"\x82\xa4type" + pack("ViewerCameraMessage") + b"\xa4type" + pack("ShareUrlRequest"),
)  # fmt: skip
#: Bytes that are no request, and that are no frames after one.
REQUESTS = (b"\x16\x03\x01", b"GET / HTTP/1.1\r\n" + b"a: b\r\n" * 5000, b"POST /\xff HTTP/1\r\n")
FRAMES = (b"\xff" * 100, b"\x81\x82abcd\xff\xff", b"\x82\x05hello", b"")


def update(uuid: Any, value: Any) -> dict[str, Any]:
    return {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}}


def file(upload: str, transfer: str, **more: Any) -> dict[str, Any]:
    """Start of a file, or a part of one if it has a content."""
    kind = {"type": "FileTransferPart"} if "content" in more else {
        "type": "FileTransferStartUpload", "filename": "a.stl", "mime_type": ""}  # fmt: skip
    return kind | {"source_component_uuid": upload, "transfer_uuid": transfer} | more


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with serving(Address(port=port, token=TOKEN)) as served:
        yield served


def controls_of(kind: str, server: Any) -> dict[str, Any]:
    """Controls of a page, as viser keeps them."""
    server.gui.reset()
    if kind == "run":
        RunPage(server, Replay(read_run(DOME), GraspView(server)))
    elif kind == "source":
        sensor = {"calibration": "dome-2022", "reconstructor": "auto"}
        WatchPage(server, Looking(source="x", rest="first:8", fps=None, **sensor))
    else:
        with Page(server, load_scene(kind, {"path": "truth"})):
            pass
    return dict(server.gui._gui_input_handle_from_uuid)


@few_and_many(60, 5000)
def test_no_message_but_an_allowed_one_reaches_the_controls(server: Any, count: int) -> None:
    known, gui = controls_of("dome-1", server), server.gui
    gui._current_file_upload_states["begun"] = {"total_bytes": 10, "transferred_bytes": 4}
    upload = next(u for u, c in known.items() if isinstance(c, viser.GuiUploadButtonHandle))
    begun, piece = file(upload, "a", size_bytes=10, part_count=1), {"part_index": 0}
    good = [CAMERA, begun, file(upload, "begun", content=bytes(6), **piece)]
    good += [update(uuid, control.value) for uuid, control in known.items()]
    assert sum(permitted(pack(one), gui) == pack(one) for one in good) > 12
    odd = (*BAD, True, 0, 1, 3.5, -1, LARGEST_FILE, "box", "begun", "a.stl", bytes(7), *known)

    def check(draw: random.Random) -> None:
        message = dict(draw.choice(good))
        key = draw.choice(sorted(message))
        if key == "updates":
            message[key] = {draw.choice(("value", "value", "options", "_impl")): draw.choice(odd)}
        elif draw.random() < 0.8:
            message[key] = draw.choice(odd)
        else:
            message.pop(key)
        raw = bytearray(pack(message))
        for _ in range(draw.choice((0, 0, 1, 2))):
            raw[draw.randrange(len(raw))] = draw.randrange(256)
        passed = permitted(bytes(raw), gui)
        if passed:
            judge(unpack(passed))

    def judge(found: dict[str, Any]) -> None:
        if found["type"] == "GuiUpdateMessage":
            assert found["updates"].keys() == {"value"}
            assert allowed(known[found["uuid"]], found["updates"]["value"])
        elif found["type"] == "ViewerCameraMessage":
            numbers = [v for key in found if key != "type" for v in [found[key]]]
            assert all(math.isfinite(x) for v in numbers for x in (v if type(v) is list else [v]))
        else:
            assert found["source_component_uuid"] == upload
            if found["type"] == "FileTransferPart":
                assert (found["transfer_uuid"], len(found["content"]) <= 6) == ("begun", True)
            else:
                assert found["type"] == "FileTransferStartUpload"
                assert 0 <= found["size_bytes"] <= LARGEST_FILE - 10
                assert 0 <= found["part_count"] <= 1000

    repeated(check, count)
    large = file(upload, "b", size_bytes=LARGEST_FILE - 9, part_count=1)
    assert unpack(permitted(pack(large), gui))["size_bytes"] == 0  # which the page refuses by name
    assert not any(permitted(message, gui) for message in GARBAGE)
    gui._current_file_upload_states.clear()


@pytest.mark.parametrize("kind", ["run", "source", "camera-100hz", "dome-1"])
def test_every_control_of_every_page_has_a_rule(server: Any, kind: str) -> None:
    for control in controls_of(kind, server).values():
        assert not any(allowed(control, value) for value in BAD), control.label
        if isinstance(control, viser.GuiUploadButtonHandle):  # a file has messages of its own
            continue
        control.disabled = False
        now = control.value
        if isinstance(now, str):
            now = now or control.options[0]  # of buttons; none is pressed
            others = [f"{now} ", control.options]
        elif isinstance(now, bool):
            others = [1]
        else:
            assert allowed(control, control.max + 1e-9)  # a browser rounds for its display
            others = [True, control.max + 1e-3, control.min - 1e-3]
        assert allowed(control, now), control.label
        assert not any(allowed(control, other) for other in others), control.label
    assert not allowed(server.gui.add_checkbox("off", True, disabled=True), True)
    assert not allowed(server.gui.add_number("a", 1.0), 1.0)  # a new kind needs a rule first


def test_a_page_goes_on_whatever_comes(
    server: Any, until: Callable[..., None], capfd: pytest.CaptureFixture[str]
) -> None:
    """Garbage, files that are larger than they say, what is no frame, and what is no request."""
    server.gui.reset()
    port, piece = server.get_port(), bytes(512 * 1024)
    slider = server.gui.add_slider("force", 0.0, 3.0, 0.1, 1.0)
    upload = server.gui.add_upload_button("object")._impl.uuid
    files = server.gui._current_file_upload_states

    def browser(spoken: str) -> Any:
        address = f"ws://127.0.0.1:{port}/{TOKEN}"
        return connect(address, subprotocols=[Subprotocol(spoken)], close_timeout=0.2)

    def goes_on(page: Any, value: float) -> None:
        page.send(pack(update(slider._impl.uuid, value)))
        until(lambda: slider.value == value, 20.0)

    with browser(VERSION) as page:
        for message in (pack(CAMERA), *GARBAGE, "text"):
            page.send(message)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        page.send(pack(file(upload, "lies", size_bytes=1000, part_count=900)))
        for k in range(60):
            size = {"size_bytes": 5 * len(piece), "part_count": 6}
            page.send(pack(file(upload, f"part-{k}", **size)))
            for name in (f"part-{k}", "lies"):
                page.send(pack(file(upload, name, part_index=k % 6, content=piece)))
        goes_on(page, 0.5)
        assert sum(one["total_bytes"] for one in files.values()) <= LARGEST_FILE
        assert (len(files) <= 8, files["lies"]["parts"]) == (True, {})
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        assert grown < 50_000  # kB; 60 MB were sent
        page.send(bytes(2_000_000))
        with pytest.raises(ConnectionClosed, match="too big"):
            _ = [page.recv(timeout=20) for _ in range(1000)]
    until(lambda: files == {})  # those of a browser that has left
    hello = (
        f"GET /{TOKEN} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
        f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: {VERSION}\r\n\r\n"
    )
    for sent in (*REQUESTS, *(hello.encode() + frames for frames in FRAMES)):
        with socket.create_connection(("127.0.0.1", port), timeout=10) as raw, suppress(OSError):
            raw.sendall(sent)
            raw.shutdown(socket.SHUT_WR)
            while raw.recv(65536):
                pass
    with browser("viser-v0.0.1") as old, pytest.raises(ConnectionClosed, match="Version mismatch"):
        old.recv(timeout=10)
    with browser(VERSION) as page:
        goes_on(page, 0.75)
    assert capfd.readouterr().err == ""


def test_names_are_shown_as_they_are(server: Any) -> None:
    """viser draws HTML in Markdown, and reads the files of its pictures."""
    server.gui.reset()
    with Page(server, load_scene("dome-1", {"path": "truth"})) as page:
        for name in ("<img src=x onerror=alert(1)>", "![a](notes.md)", "a\\`b", "&lt;"):
            page.drop(f"{name}.step", b"solid")
            plain = str.maketrans({c: f"&#{ord(c)};" for c in "<>[`\\&"})
            assert f"{Path(name).name}.step".translate(plain) in page.board._status.content
            sent = page.board._status._markdown.replace("<br/>", "")
            assert not {"<", "["} & set(sent)
