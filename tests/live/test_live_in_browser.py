"""The live page in a real browser: its sliders change the grasp, and nothing of it is left over."""

import importlib.metadata
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import trimesh

pytestmark = [pytest.mark.browser]
TOKEN = "abcdefgh-ijklmnop_1234"
#: Few frames: a browser that draws on the processor would have no time for anything else.
SCENE = ("dome-1", "--set", "path=truth", "--set", "camera.rate_hz=10")
Browsing = Callable[..., Any]


def page(port: int) -> str:
    """Address that is printed."""
    return f"http://127.0.0.1:{port}/{TOKEN}"


@contextmanager
def serving(port: int, folder: Path, *words: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A page in a process of its own, and its address; recordings go into the folder."""
    shared = ["--port", str(port), "--record", str(folder / "kept"), "--token", TOKEN]
    command = [sys.executable, "-P", "-m", "chromagrip", "live", *words, *shared]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process, process.stdout.readline().split()[0]
        finally:
            process.kill()


@pytest.fixture
def server(port: int, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    with serving(port, tmp_path, *SCENE) as (process, address):
        assert address == page(port)
        yield process


def field(made: Any, label: str) -> Any:
    """Box of a slider's number."""
    path = f'//label[text()="{label}"]/following::input[@type="text"][1]'
    return made.find_element("xpath", path)


def type_number(made: Any, label: str, value: float) -> None:
    from selenium.webdriver.common.keys import Keys

    box = field(made, label)
    box.send_keys(Keys.CONTROL, "a")
    box.send_keys(f"{value:g}", Keys.ENTER)


def true_values(made: Any) -> dict[str, float]:
    """What the page says of the truth."""
    text = made.find_element("tag name", "body").text
    found = re.search(r"true: Γ (\S+), ΣFn (\S+) N,\s+ΣFf (\S+) N", text)
    assert found is not None, text
    return dict(zip(("margin", "normal", "friction"), map(float, found.groups()), strict=True))


def until(condition: Callable[[], bool], seconds: float = 150.0) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return
        time.sleep(0.2)
    raise AssertionError("it did not come to this")


def begun(made: Any) -> bool:
    return "true: Γ" in made.find_element("tag name", "body").text


#: Whether a page of another site gets through to an address.
REACHED = """
const done = arguments[arguments.length - 1];
const open = new WebSocket(arguments[0], "viser-v" + arguments[1]);
open.onopen = () => done("open");
open.onerror = () => done("refused");
"""


@pytest.mark.usefixtures("server")
def test_sliders_and_a_file_change_the_grasp_on_every_page_and_after_a_reload(
    port: int, browsing: Browsing, tmp_path: Path
) -> None:
    # Half as high as a page is: the fingertip is drawn by the processor that also computes it.
    with browsing(1280, 450) as browser:
        made = browser.made
        made.get(page(port))
        until(lambda: begun(made))
        type_number(made, "load [N]", 0.0)
        made.find_element(
            "xpath", '//label[text()="controller grips"]/following::input[1]'
        ).send_keys(" ")
        until(lambda: bool(field(made, "grip [N]").is_enabled()))
        type_number(made, "grip [N]", 4.0)
        until(lambda: abs(true_values(made)["normal"] - 4.0) < 0.2)
        with browsing(420, 450) as second:
            second.made.get(page(port))
            until(lambda: begun(second.made))
            type_number(second.made, "load [N]", 1.0)
            assert second.made.execute_script("return document.body.scrollWidth") <= 420
        until(lambda: field(made, "load [N]").get_attribute("value") == "1")
        # Frictions of the nodes are not all along the load: their sum is larger.
        until(lambda: 1.0 < true_values(made)["friction"] < 1.25)
        made.refresh()
        until(lambda: begun(made))
        assert field(made, "load [N]").get_attribute("value") == "1"
        trimesh.creation.icosphere(subdivisions=3, radius=9.0).export(tmp_path / "egg.stl")
        before = time_shown(made)
        folded = made.find_element("xpath", '//*[contains(text(), "starts the grasp again")]')
        made.execute_script("arguments[0].click()", folded)
        taken = made.find_element("css selector", 'input[type="file"]')
        taken.send_keys(str(tmp_path / "egg.stl"))
        until(lambda: time_shown(made) < before)  # another object starts the grasp again
        assert [line for line in browser.complaints() if "SEVERE" in line] == []
        # A page that is loaded again names its own socket.
        asked = {address.partition("?websocket=")[::2] for address in browser.requested()}
        assert asked <= {(page(port), ""), (page(port), page(port).replace("http", "ws"))}
        made.get(f"http://127.0.0.1:{port}/")
        assert "needs the token" in made.find_element("tag name", "body").text
        made.get("data:text/html,<p>another site")
        version = importlib.metadata.version("viser")
        for path in ("", TOKEN):
            url = f"ws://127.0.0.1:{port}/{path}"
            assert made.execute_async_script(REACHED, url, version) == "refused"


def test_a_server_that_ends_frees_its_port(server: subprocess.Popen[str], port: int) -> None:
    time.sleep(2.0)
    server.send_signal(signal.SIGTERM)
    assert server.wait(timeout=20.0) == 128 + signal.SIGTERM
    with socket.socket() as again:
        again.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        again.bind(("127.0.0.1", port))


@pytest.mark.usefixtures("server")
def test_the_keyboard_alone_suffices(port: int, browsing: Browsing) -> None:
    """Tab comes to every control, and keys work them."""
    from selenium.webdriver.common.keys import Keys

    with browsing(1280) as browser:
        made = browser.made
        made.get(page(port))
        until(lambda: begun(made))
        press(made, "pause")
        until(lambda: len({time_shown(made) for _ in range(2) if not time.sleep(0.5)}) == 1)
        reached: set[str] = set()
        for _ in range(30):
            made.switch_to.active_element.send_keys(Keys.TAB)
            reached.add(made.execute_script(FOCUSED))
        wanted = {"load [N]", "twist [N mm]", "controller grips", "pause", "step", "record"}
        assert wanted <= reached, reached
        before = time_shown(made)
        press(made, "step")
        until(lambda: time_shown(made) > before)


#: Label of what has the focus: of its box, or its own words.
FOCUSED = """
const here = document.activeElement;
if (here.innerText) return here.innerText;
for (let e = here; e; e = e.parentElement) {
    const label = e.querySelector("label");
    if (label) return label.innerText;
}
return "";
"""


def press(made: Any, button: str) -> None:
    """Press a button by the keyboard."""
    from selenium.webdriver.common.keys import Keys

    made.find_element("xpath", f'//button[normalize-space()="{button}"]').send_keys(Keys.ENTER)


def time_shown(made: Any) -> float:
    found = re.search(r"t = (\S+) s", made.find_element("tag name", "body").text)
    assert found is not None
    return float(found[1])


def test_a_finished_run(port: int, browsing: Browsing, tmp_path: Path) -> None:
    from chromagrip import load_scene, run

    scene = load_scene("camera-100hz", {"path": "truth", "duration_s": 0.5})
    run(scene, tmp_path / "done")
    with serving(port, tmp_path, "--run", str(tmp_path / "done")), browsing(420) as browser:
        made = browser.made
        made.get(page(port))
        body = made.find_element("tag name", "body")
        until(lambda: "agrees with the record" in body.text)
        until(lambda: time_shown(made) == 0.5)
        type_number(made, "time [s]", 0.2)
        until(lambda: time_shown(made) == 0.2)
        press(made, "step")
        until(lambda: time_shown(made) == 0.21)
        assert made.execute_script("return document.body.scrollWidth") <= 420
        assert [line for line in browser.complaints() if "SEVERE" in line] == []
        assert browser.requested() == {page(port)}
