"""Every message of a browser is input: what is not allowed changes nothing and ends nothing."""

import importlib.metadata
import math
import random
import resource
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from chromagrip import load_scene
from chromagrip.live.guard import LARGEST_FILE, allowed
from chromagrip.live.page import Page
from chromagrip.live.record import Recorder
from chromagrip.live.replay import Replay
from chromagrip.live.run_page import RunPage
from chromagrip.live.serve import Address, serving
from chromagrip.live.session import Session
from chromagrip.live.view import GraspView
from chromagrip.live.watch import Looking, WatchPage
from chromagrip.loop.results.run_folder import read_run

TOKEN = "abcdefgh-ijklmnop_1234"
DOME = {"path": "truth", "camera.rate_hz": 10.0, "fingertip.step_ms": 10.0}
WRITTEN = Path(__file__).parents[2] / "fixtures/written-before"
Until = Callable[..., None]
pack = msgspec.msgpack.encode

#: Values that no control allows.
BAD: tuple[Any, ...] = (
    None, math.nan, math.inf, -math.inf, 1e308, -1e308, 2**63, -(2**63), 1e9, -1e9,
    "", "pwn:C", "os:system", "../../x", "x" * 300, "x" * 100_000, "\0", "nan", "True", b"true",
    [], [1.0], [0, 0], {}, {"value": 1.0}, {"name": "a", "content": b""}, [[[[[1]]]]],
    msgspec.Raw(b"\xd4\x01\x02"),
)  # fmt: skip
#: Messages that no page of ours sends, or that are no messages.
GARBAGE: tuple[str | bytes, ...] = (
    "", "text", b"", b"\xc1", b"\x91" * 50_000, b"\xdd\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff",
    b"\xc6\xff\xff\xff\xffab", b"\x82\xa4type\xd9\x20", b"\xa3\xff\xfe\xfd", bytes(700_000),
    pack(None), pack([]), pack({}), pack({"type": None}), pack({"type": "Message"}),
    *(pack({"type": kind}) for kind in ("ShareUrlRequest", "ShareUrlDisconnect", "Nobody")),
    pack({"type": "GuiUpdateMessage"}), pack({"type": "GuiUpdateMessage", "uuid": "x"}),
    pack({"type": "GuiUpdateMessage", "uuid": "nobody", "updates": {"value": 1}}),
    pack({"type": "GuiUpdateMessage", "uuid": 3, "updates": []}),
    pack({"type": "GuiFormSubmitMessage", "uuid": "root"}),
    pack({"type": "GuiFormDirtyMessage", "uuid": "x"}),
    pack({"type": "GuiRemoveMessage", "uuid": "x"}),
    pack({"type": "GuiButtonHoldMessage", "uuid": "x", "frequency": math.nan}),
    pack({"type": "CommandTriggerMessage", "uuid": "x"}),
    pack({"type": "SceneNodeClickMessage", "name": "/skin"}),
    pack({"type": "SceneNodeUpdateMessage", "name": "/skin", "updates": {"visible": False}}),
    pack({"type": "RunJavascriptMessage", "source": "1"}),
    pack({"type": "ViewerCameraMessage"}),
    # A message of two kinds: who reads the first kind and who reads the last one would differ.
    b"\x82\xa4type" + pack("ViewerCameraMessage") + b"\xa4type" + pack("ShareUrlRequest"),
)  # fmt: skip
CAMERA: dict[str, Any] = {
    "type": "ViewerCameraMessage", "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [1, 2, 3],
    "fov": 1.0, "near": 0.01, "far": 1000, "image_height": 100, "image_width": 100,
    "look_at": [0, 0, 0], "up_direction": [0, 0, 1],
}  # fmt: skip


@contextmanager
def joined(port: int) -> Iterator[ClientConnection]:
    """A browser that has said where its camera is."""
    version = Subprotocol(f"viser-v{importlib.metadata.version('viser')}")
    address = f"ws://127.0.0.1:{port}/{TOKEN}"
    with connect(address, subprotocols=[version], close_timeout=0.2) as browser:
        browser.send(pack(CAMERA))
        yield browser


def update(uuid: str, value: Any, more: dict[str, Any] | None = None) -> bytes:
    updates = {"value": value} | (more or {})
    return pack({"type": "GuiUpdateMessage", "uuid": uuid, "updates": updates})


class Shown:
    """A page of a grasp, and its controls by their labels."""

    def __init__(self, server: Any, page: Page, session: Session, port: int) -> None:
        self.server, self.page, self.session, self.port = server, page, session, port
        self.controls = dict(server.gui._gui_input_handle_from_uuid)
        self.named = {control.label: uuid for uuid, control in self.controls.items()}

    def values(self) -> dict[str, Any]:
        return {uuid: control.value for uuid, control in self.controls.items()}

    @property
    def count(self) -> int:
        return 0 if self.page.board.strips is None else len(self.page.board.strips._rows)

    def goes_on(self, browser: ClientConnection, until: Until) -> None:
        """A good value of the same browser arrives, and frames follow."""
        wanted = round(random.Random(self.count).uniform(0.2, 1.4), 2)
        browser.send(update(self.named["µ of the object"], wanted))
        until(lambda: self.session.sliders.friction == wanted, 20.0)
        before = self.count
        until(lambda: self.count != before, 20.0)
        self.session.check()


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shown]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    scene = load_scene("dome-1", DOME)
    with serving(Address(port=port, token=TOKEN)) as server, Page(server, scene) as page:
        recorder = Recorder(tmp_path_factory.mktemp("kept"), page.tell_kept)
        with Session(scene, page.show, page.tell, recorder) as session:
            page.connect(session)
            yield Shown(server, page, session, port)
            session.check()


def test_every_control_refuses_what_it_does_not_allow(
    shown: Shown, until: Until, capfd: pytest.CaptureFixture[str]
) -> None:
    until(lambda: shown.count > 1)
    before, sliders = shown.values(), shown.session.sliders
    assert len(before) > 12
    with joined(shown.port) as browser:
        for uuid, control in shown.controls.items():
            low, high = getattr(control, "min", 0.0), getattr(control, "max", 0.0)
            for value in (*BAD, low - 0.01, high + 0.01):
                browser.send(update(uuid, value))
            if isinstance(control.value, bool):
                continue
            browser.send(update(uuid, True))
            for name in ("uuid", "options", "disabled", "update_cb", "props", "label", "_impl"):
                browser.send(update(uuid, control.value, {name: ["pwn:C"]}))
                message = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {name: 1}}
                browser.send(pack(message))
        shown.goes_on(browser, until)
    now = shown.values()
    for uuid, control in shown.controls.items():
        if control.label not in ("grip [N]", "µ of the object"):  # moved by the controller, by us
            assert now[uuid] == before[uuid], control.label
    after = shown.session.sliders
    assert (after.controller, after.noise) == (sliders.controller, sliders.noise)
    assert capfd.readouterr().err == ""


def controls_of(kind: str, server: Any) -> dict[str, Any]:
    """Controls of a page, by their labels."""
    if kind == "run":
        run = read_run(WRITTEN / "dome")
        RunPage(server, Replay(run, GraspView(server)))
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
def test_every_control_of_every_page_has_a_rule(viser_server: Any, kind: str) -> None:
    for label, control in controls_of(kind, viser_server).items():
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
    assert not allowed(viser_server.gui.add_checkbox("off", True, disabled=True), True)
    for other in (viser_server.gui.add_number("a", 1.0), viser_server.gui.add_text("b", "x")):
        assert not allowed(other, other.value)  # a new kind needs a rule first


def test_allowed_values_pass(shown: Shown, until: Until) -> None:
    with joined(shown.port) as browser:
        for label, value, name in (
            ("load [N]", 1, "load"),  # a whole number, as browsers write it
            ("load [N]", 0.0, "load"),
            ("azimuth [°]", -180.0, "azimuth"),
            ("latency [frames]", 3, "latency"),
            ("controller", "conservative", "controller"),
            ("object", "plane", "object"),
            ("controller grips", False, "automatic"),
            ("controller grips", True, "automatic"),
        ):
            browser.send(update(shown.named[label], value))
            until(lambda name=name, value=value: getattr(shown.session.sliders, name) == value, 20)
        shown.goes_on(browser, until)


def test_garbage_is_passed_over_or_ends_its_own_connection(
    shown: Shown, until: Until, capfd: pytest.CaptureFixture[str]
) -> None:
    draw = random.Random(5)
    good = [update(uuid, value) for uuid, value in shown.values().items() if value]
    with joined(shown.port) as browser:
        for message in GARBAGE:
            browser.send(message)
        for key in CAMERA:
            for bad in (None, math.nan, [math.inf] * 4, "x", [1.0], [[1.0] * 4]):
                browser.send(pack(CAMERA | {key: bad}))
            browser.send(pack({k: v for k, v in CAMERA.items() if k != key}))
        for _ in range(100):  # flipped and cut
            bytes_ = bytearray(draw.choice([*good[:4], pack(CAMERA)]))
            bytes_[draw.randrange(8, 30)] = draw.randrange(256)
            browser.send(bytes(bytes_[: draw.randrange(8, len(bytes_))]))
        shown.goes_on(browser, until)
        browser.send(pack(CAMERA | {"near2": 1.0}))
        with pytest.raises(ConnectionClosed):
            _ = [browser.recv(timeout=20) for _ in range(1000)]
    with joined(shown.port) as browser:
        shown.goes_on(browser, until)
    assert capfd.readouterr().err == ""


def test_a_huge_message_ends_its_own_connection(
    shown: Shown, until: Until, capfd: pytest.CaptureFixture[str]
) -> None:
    with joined(shown.port) as browser:
        browser.send(bytes(2_000_000))
        with pytest.raises(ConnectionClosed, match="too big"):
            _ = [browser.recv(timeout=20) for _ in range(1000)]
    with joined(shown.port) as browser:
        shown.goes_on(browser, until)
    assert capfd.readouterr().err == ""


def start(shown: Shown, transfer: str, size: int, parts: int, **more: Any) -> bytes:
    message = {
        "type": "FileTransferStartUpload", "source_component_uuid": upload_of(shown),
        "transfer_uuid": transfer, "filename": f"{transfer}.stl", "mime_type": "",
        "part_count": parts, "size_bytes": size,
    }  # fmt: skip
    return pack(message | more)


def part(shown: Shown, transfer: str, index: int, content: Any, **more: Any) -> bytes:
    message = {
        "type": "FileTransferPart", "source_component_uuid": upload_of(shown),
        "transfer_uuid": transfer, "part_index": index, "content": content,
    }  # fmt: skip
    return pack(message | more)


def upload_of(shown: Shown) -> str:
    return next(uuid for label, uuid in shown.named.items() if label.startswith("object from"))


def test_files_are_cut_off_while_they_arrive(
    shown: Shown, until: Until, capfd: pytest.CaptureFixture[str]
) -> None:
    piece, files = bytes(512 * 1024), shown.server.gui._current_file_upload_states
    with joined(shown.port) as browser:
        shown.goes_on(browser, until)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        # One that says that it is too large, many that are too large together, and one that lies.
        browser.send(start(shown, "large", LARGEST_FILE + 1, 39))
        until(lambda: "large.stl is empty or too large" in shown.page.board._status.content)
        browser.send(start(shown, "lies", 1000, 900))
        for k in range(60):
            browser.send(part(shown, "large", k, piece))
            browser.send(start(shown, f"part-{k}", 5 * len(piece) + k, 6))
            browser.send(part(shown, f"part-{k}", k % 6, piece))
            browser.send(part(shown, "lies", k, piece))
        shown.goes_on(browser, until)
        assert sum(file["total_bytes"] for file in files.values()) <= LARGEST_FILE
        assert len(files) <= 8
        assert files["lies"]["parts"] == {}
        after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert after - before < 50_000  # kB; 90 MB were sent
    until(lambda: files == {}, 20.0)  # those of a browser that has left
    assert capfd.readouterr().err == ""


def test_files_that_are_wrong_are_passed_over(
    shown: Shown, until: Until, capfd: pytest.CaptureFixture[str]
) -> None:
    slider, before = shown.named["load [N]"], shown.values()
    with joined(shown.port) as browser:
        for k, (size, parts, more) in enumerate((
            (0, 0, {}), (0, 10, {}), (-1, 1, {}), (10, -1, {}), (10, 2**62, {}), (2**62, 1, {}),
            (math.nan, 1, {}), (10, 1, {"source_component_uuid": slider}),
            (10, 1, {"source_component_uuid": None}), (10, 1, {"filename": None}),
            (10, 1, {"transfer_uuid": ["a"]}),
        )):  # fmt: skip
            name = f"wrong-{k}"
            browser.send(start(shown, name, size, parts, **more))  # type: ignore[arg-type]
            name = more.get("transfer_uuid", name)
            browser.send(part(shown, name, 0, bytes(11)))
        browser.send(start(shown, "index", 10, 2))
        for index, content in ((2, b""), (-1, b"a"), (2**63, b"a"), (0, "text"), (0, None),
                               (0, bytes(11)), (0, [1] * 10), (math.nan, b"a")):  # fmt: skip
            browser.send(part(shown, "index", index, content))  # type: ignore[arg-type]
        # A file as the value of a slider.
        browser.send(part(shown, "index", 0, bytes(5)))
        browser.send(part(shown, "index", 1, bytes(5), source_component_uuid=slider))
        shown.goes_on(browser, until)
        waiting = shown.server.gui._current_file_upload_states
        assert set(waiting) == {"index", "wrong-1"}
        assert waiting["index"]["transferred_bytes"] == 5
    assert shown.values()[slider] == before[slider]
    until(lambda: waiting == {}, 20.0)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    "name", ["<img src=x onerror=alert(1)>", "![a](notes.md)", "[a](javascript:1)", "a\\`b", "&lt;"]
)
def test_names_are_shown_as_they_are(shown: Shown, until: Until, name: str) -> None:
    """viser draws HTML in Markdown, and reads the files of its pictures."""
    with joined(shown.port) as browser:
        browser.send(start(shown, "named", 5, 1, filename=f"{name}.step"))
        browser.send(part(shown, "named", 0, b"solid"))
        plain = str.maketrans({c: f"&#{ord(c)};" for c in "<>[`\\&"})
        end = f"{Path(name).name}.step".translate(plain)
        until(lambda: end in shown.page.board._status.content, 20.0)
    sent = shown.page.board._status._markdown.replace("<br/>", "")
    assert "<" not in sent
    assert "[" not in sent


def test_a_file_of_many_parts_arrives(shown: Shown, until: Until) -> None:
    import trimesh

    content = trimesh.creation.icosphere(subdivisions=3, radius=9.0).export(file_type="stl")
    cuts = [content[k : k + 20_000] for k in range(0, len(content), 20_000)]
    with joined(shown.port) as browser:
        browser.send(start(shown, "ball", len(content), len(cuts)))
        for k in reversed(range(len(cuts))):
            browser.send(part(shown, "ball", k, cuts[k]))
        until(lambda: shown.session.sliders.object.endswith(".stl"), 30.0)
        browser.send(update(shown.named["object"], "box"))
        until(lambda: shown.session.sliders.object == "box", 20.0)


def test_pages_of_other_versions_are_closed(shown: Shown) -> None:
    address = f"ws://127.0.0.1:{shown.port}/{TOKEN}"
    for spoken in ("viser-v0.0.1", "viser-v", "other", None):
        protocols = None if spoken is None else [Subprotocol(spoken)]
        with (
            connect(address, subprotocols=protocols) as browser,
            pytest.raises(ConnectionClosed, match="Version mismatch"),
        ):
            browser.recv(timeout=10)


def test_what_is_no_request_leaves_no_line(
    shown: Shown, until: Until, capfd: pytest.CaptureFixture[str]
) -> None:
    for sent in (b"", b"\x16\x03\x01", b"GET\r\n\r\n", b"GET / HTTP/1.1\r\n" + b"a: b\r\n" * 5000,
                 f"GET /{'x' * 5000} HTTP/1.1\r\nHost: a\r\n\r\n".encode(),
                 b"GET /\xff HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n",
                 f"POST /{TOKEN} HTTP/1.1\r\nHost: a\r\n\r\n".encode()):  # fmt: skip
        with socket.create_connection(("127.0.0.1", shown.port), timeout=10) as raw:
            raw.sendall(sent)
            raw.shutdown(socket.SHUT_WR)
            try:
                while raw.recv(65536):
                    pass
            except OSError:
                pass
    with joined(shown.port) as browser:
        shown.goes_on(browser, until)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    "frames",
    [b"\xff" * 100, b"\x81\x82abcd\xff\xff", b"\x82\x05hello", b"\x02\x81abcd1" * 50,
     b"\x82\xff\x7f" + b"\xff" * 20, b"\x88\x80abcd\x88\x80abcd", b"\x89\xfe\x01\x00abcd", b""],
)  # fmt: skip
def test_frames_that_are_none_end_their_own_connection(
    shown: Shown, until: Until, capfd: pytest.CaptureFixture[str], frames: bytes
) -> None:
    version = importlib.metadata.version("viser")
    lines = (
        f"GET /{TOKEN} HTTP/1.1", f"Host: 127.0.0.1:{shown.port}", "Upgrade: websocket",
        "Connection: Upgrade", "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version: 13", f"Sec-WebSocket-Protocol: viser-v{version}", "", "",
    )  # fmt: skip
    with socket.create_connection(("127.0.0.1", shown.port), timeout=10) as raw:
        raw.sendall("\r\n".join(lines).encode())
        assert raw.recv(12) == b"HTTP/1.1 101"
        raw.sendall(frames)
        raw.shutdown(socket.SHUT_WR)
        time.sleep(0.05)
    with joined(shown.port) as browser:
        shown.goes_on(browser, until)
    assert capfd.readouterr().err == ""
