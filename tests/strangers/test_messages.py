"""Every message of a browser is input: what is not allowed changes nothing and ends nothing."""

import importlib.metadata
import math
import resource
import socket
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import viser
from hypothesis import given, settings
from hypothesis import strategies as st
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
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

from .judged import few_and_many

TOKEN = "abcdefgh-ijklmnop_1234"
WRITTEN = Path(__file__).parents[2] / "fixtures/written-before"
pack = msgspec.msgpack.encode

#: Values that no control allows.
BAD: tuple[Any, ...] = (
    None, math.nan, math.inf, -math.inf, 1e308, 2**63, 1e9, -1e9, "", "pwn:C", "os:system",
    "../../x", "x" * 100_000, "\0", "nan", "True", b"true", [], [1.0], {}, {"value": 1.0},
    {"name": "a", "content": b""}, [[[[[1]]]]], msgspec.Raw(b"\xd4\x01\x02"),
)  # fmt: skip
CAMERA: dict[str, Any] = {
    "type": "ViewerCameraMessage", "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [1, 2, 3],
    "fov": 1.0, "near": 0.01, "far": 1000, "image_height": 100, "image_width": 100,
    "look_at": [0, 0, 0], "up_direction": [0, 0, 1],
}  # fmt: skip
#: Messages that are none, or of kinds that no page of ours sends.
GARBAGE: tuple[bytes, ...] = (
    b"", b"\xc1", b"\x91" * 50_000, b"\xdd\xff\xff\xff\xff", b"\xa3\xff\xfe\xfd", bytes(700_000),
    *(pack({"type": kind, "uuid": "x", "updates": []}) for kind in (
        "ShareUrlRequest", "RunJavascriptMessage", "GuiRemoveMessage", "GuiUpdateMessage", None)),
    # A message of two kinds: who reads the first kind and who reads the last one would differ.
    b"\x82\xa4type" + pack("ViewerCameraMessage") + b"\xa4type" + pack("ShareUrlRequest"),
)  # fmt: skip
#: Bytes that are no request, and that are no frames after one.
REQUESTS = (
    b"\x16\x03\x01", b"GET / HTTP/1.1\r\n" + b"a: b\r\n" * 5000,
    b"GET /\xff HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n",
    f"POST /{TOKEN} HTTP/1.1\r\nHost: a\r\n\r\n".encode(),
)  # fmt: skip
FRAMES = (b"\xff" * 100, b"\x81\x82abcd\xff\xff", b"\x82\x05hello", b"\x89\xfe\x01\x00abcd", b"")


def update(uuid: Any, value: Any, /, **more: Any) -> dict[str, Any]:
    return {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value} | more}


def start(upload: str, transfer: Any, size: Any, parts: Any) -> dict[str, Any]:
    return {
        "type": "FileTransferStartUpload", "source_component_uuid": upload,
        "transfer_uuid": transfer, "filename": f"{transfer}.stl", "mime_type": "",
        "part_count": parts, "size_bytes": size,
    }  # fmt: skip


def part(upload: str, transfer: Any, index: Any, content: Any) -> dict[str, Any]:
    return {
        "type": "FileTransferPart", "source_component_uuid": upload, "transfer_uuid": transfer,
        "part_index": index, "content": content,
    }  # fmt: skip


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with serving(Address(port=port, token=TOKEN)) as served:
        yield served


@pytest.fixture
def gui(server: viser.ViserServer) -> Any:
    """Controls of the page of a grasp, as viser keeps them; a file is on its way."""
    with Page(server, load_scene("dome-1", {"path": "truth"})):
        pass
    server.gui._current_file_upload_states["begun"] = {"total_bytes": 10, "transferred_bytes": 4}
    yield server.gui
    server.gui._current_file_upload_states.clear()
    server.gui.reset()


def fits(control: Any, value: Any) -> bool:
    """Whether a value is one of those that a control shows."""
    if isinstance(control, viser.GuiCheckboxHandle | viser.GuiButtonHandle):
        return isinstance(value, bool)
    if isinstance(control, viser.GuiSliderHandle):
        number = isinstance(value, int | float) and not isinstance(value, bool)
        return number and control.min - 1e-3 <= value <= control.max + 1e-3
    return isinstance(value, str) and value in getattr(control, "options", ())


ANY = st.one_of(
    st.sampled_from(BAD), st.booleans(), st.integers(-(2**63), 2**64 - 1), st.floats(),
    st.floats(-10.0, 10.0), st.text(max_size=9), st.binary(max_size=20),
    st.lists(st.floats(), max_size=4), st.sampled_from(("box", "conservative", "begun", "x.stl")),
)  # fmt: skip


@few_and_many(120, 20_000)
def test_no_message_but_an_allowed_one_reaches_the_controls(gui: Any, count: int) -> None:
    known = dict(gui._gui_input_handle_from_uuid)
    upload = next(u for u, c in known.items() if isinstance(c, viser.GuiUploadButtonHandle))
    good = [CAMERA, start(upload, "a", 10, 1), part(upload, "begun", 0, bytes(6))]
    good += [update(uuid, control.value) for uuid, control in known.items()]
    assert sum(permitted(pack(one), gui) == pack(one) for one in good) > 12

    @settings(max_examples=count, derandomize=True, database=None)
    @given(message=st.sampled_from(good), data=st.data())
    def check(message: dict[str, Any], data: st.DataObject) -> None:
        message = dict(message)
        key = data.draw(st.sampled_from(sorted(message)))
        if key == "updates":
            message[key] = {data.draw(st.sampled_from(("value", "label", "_impl"))): data.draw(ANY)}
        elif data.draw(st.booleans()):
            message[key] = data.draw(st.one_of(ANY, st.sampled_from(sorted(known))))
        else:
            message.pop(key)
        raw = bytearray(pack(message))
        for at in data.draw(st.lists(st.integers(0, len(raw) - 1), max_size=2)):
            raw[at] = data.draw(st.integers(0, 255))
        judge(permitted(bytes(raw), gui))

    def judge(passed: bytes) -> None:
        if not passed:
            return
        found = msgspec.msgpack.decode(passed)
        if found["type"] == "GuiUpdateMessage":
            ((name, value),) = found["updates"].items()
            assert name == "value"
            assert fits(known[found["uuid"]], value)
        elif found["type"] == "ViewerCameraMessage":
            assert np.isfinite(np.hstack([found[key] for key in found if key != "type"])).all()
        else:
            assert found["source_component_uuid"] == upload
            if found["type"] == "FileTransferPart":
                assert found["transfer_uuid"] == "begun"
                assert len(found["content"]) <= 6
            else:
                assert found["type"] == "FileTransferStartUpload"
                assert 0 <= found["size_bytes"] <= LARGEST_FILE - 10
                assert 0 <= found["part_count"] <= 1000

    check()
    slider = next(u for u, c in known.items() if isinstance(c, viser.GuiSliderHandle))
    for wrong in (
        part(upload, "begun", 0, bytes(7)), part(upload, "nobody", 0, b"a"),
        part(slider, "begun", 0, b"a"), start(slider, "b", 1, 1), start(upload, "begun", 1, 1),
        start(upload, "b", -1, 1), start(upload, "b", 1, -1), start(upload, "b", 1, 1001),
        *(CAMERA | {key: math.inf} for key in ("fov", "near", "far")),
    ):  # fmt: skip
        assert permitted(pack(wrong), gui) == b"", wrong
    large = msgspec.msgpack.decode(permitted(pack(start(upload, "b", LARGEST_FILE - 9, 1)), gui))
    assert (large["size_bytes"], large["part_count"]) == (0, 0)  # which the page refuses by name
    for message in GARBAGE:
        assert permitted(message, gui) == b""
    for uuid, control in known.items():
        for name in ("uuid", "options", "disabled", "update_cb", "props", "label", "_impl"):
            assert permitted(pack(update(uuid, control.value, **{name: ["pwn:C"]})), gui) == b""


def controls_of(kind: str, server: Any) -> dict[str, Any]:
    """Controls of a page, by their labels."""
    server.gui.reset()
    if kind == "run":
        RunPage(server, Replay(read_run(WRITTEN / "dome"), GraspView(server)))
    elif kind == "source":
        looking = Looking(
            source="x", rest="first:8", fps=None, calibration="dome-2022", reconstructor="auto"
        )
        WatchPage(server, looking)
    else:
        with Page(server, load_scene(kind, {"path": "truth"})):
            pass
    return {one.label: one for one in server.gui._gui_input_handle_from_uuid.values()}


@pytest.mark.parametrize("kind", ["run", "source", "camera-100hz", "dome-1"])
def test_every_control_of_every_page_has_a_rule(server: Any, kind: str) -> None:
    for label, control in controls_of(kind, server).items():
        for value in BAD:
            assert not allowed(control, value), label
        if label.startswith("object from"):  # a file has messages of its own
            continue
        control.disabled = False
        now = control.value
        if isinstance(now, str) and not now:  # of buttons; none is pressed
            now = control.options[0]
        assert allowed(control, now), label
        if isinstance(now, bool):
            others = [1]
        elif isinstance(now, str):
            others = [f"{now} ", control.options]
        else:
            assert allowed(control, control.max + 1e-9)  # a browser rounds for its display
            others = [True, control.max + 1e-3, control.min - 1e-3]
        assert not any(allowed(control, other) for other in others), label
    assert not allowed(None, 1.0)
    assert not allowed(server.gui.add_checkbox("off", True, disabled=True), True)
    assert not allowed(server.gui.add_number("a", 1.0), 1.0)  # a new kind needs a rule first


def test_a_page_goes_on_whatever_comes(
    server: Any, until: Callable[..., None], capfd: pytest.CaptureFixture[str]
) -> None:
    """Garbage, files that are larger than they say, what is no frame, and what is no request."""
    server.gui.reset()
    port = server.get_port()
    slider = server.gui.add_slider("force", 0.0, 3.0, 0.1, 1.0)
    upload = server.gui.add_upload_button("object")
    files, piece = server.gui._current_file_upload_states, bytes(512 * 1024)
    version = f"viser-v{importlib.metadata.version('viser')}"
    address = f"ws://127.0.0.1:{port}/{TOKEN}"

    def goes_on(browser: ClientConnection, value: float) -> None:
        browser.send(pack(update(slider._impl.uuid, value)))
        until(lambda: slider.value == value, 20.0)

    with connect(address, subprotocols=[Subprotocol(version)], close_timeout=0.2) as browser:
        browser.send(pack(CAMERA))
        for message in GARBAGE:
            browser.send(message)
        browser.send("text")
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        browser.send(pack(start(upload._impl.uuid, "lies", 1000, 900)))
        for k in range(60):
            browser.send(pack(start(upload._impl.uuid, f"part-{k}", 5 * len(piece), 6)))
            browser.send(pack(part(upload._impl.uuid, f"part-{k}", k % 6, piece)))
            browser.send(pack(part(upload._impl.uuid, "lies", k, piece)))
        goes_on(browser, 0.5)
        assert sum(file["total_bytes"] for file in files.values()) <= LARGEST_FILE
        assert (len(files) <= 8, files["lies"]["parts"]) == (True, {})
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        assert grown < 50_000  # kB; 60 MB were sent
        browser.send(bytes(2_000_000))
        with pytest.raises(ConnectionClosed, match="too big"):
            _ = [browser.recv(timeout=20) for _ in range(1000)]
    until(lambda: files == {})  # those of a browser that has left
    lines = (
        f"GET /{TOKEN} HTTP/1.1", f"Host: 127.0.0.1:{port}", "Upgrade: websocket",
        "Connection: Upgrade", "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version: 13", f"Sec-WebSocket-Protocol: {version}", "", "",
    )  # fmt: skip
    hello = "\r\n".join(lines).encode()
    for sent in (*REQUESTS, *(hello + frames for frames in FRAMES)):
        with socket.create_connection(("127.0.0.1", port), timeout=10) as raw, suppress(OSError):
            raw.sendall(sent)
            raw.shutdown(socket.SHUT_WR)
            while raw.recv(65536):
                pass
    for spoken in ("viser-v0.0.1", "other", None):
        protocols = None if spoken is None else [Subprotocol(spoken)]
        with (
            connect(address, subprotocols=protocols) as browser,
            pytest.raises(ConnectionClosed, match="Version mismatch"),
        ):
            browser.recv(timeout=10)
    with connect(address, subprotocols=[Subprotocol(version)], close_timeout=0.2) as browser:
        goes_on(browser, 0.75)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    "name", ["<img src=x onerror=alert(1)>", "![a](notes.md)", "[a](javascript:1)", "a\\`b", "&lt;"]
)
def test_names_are_shown_as_they_are(server: Any, name: str) -> None:
    """viser draws HTML in Markdown, and reads the files of its pictures."""
    server.gui.reset()
    with Page(server, load_scene("dome-1", {"path": "truth"})) as page:
        page.drop(f"{name}.step", b"solid")
        plain = str.maketrans({c: f"&#{ord(c)};" for c in "<>[`\\&"})
        assert f"{Path(name).name}.step".translate(plain) in page.board._status.content
        sent = page.board._status._markdown.replace("<br/>", "")
    assert "<" not in sent
    assert "[" not in sent
