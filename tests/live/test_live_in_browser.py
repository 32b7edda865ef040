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


@pytest.mark.usefixtures("server")
@pytest.mark.parametrize("width", [1280, 420])
def test_sliders_change_the_grasp(width: int, port: int, browsing: Browsing) -> None:
    # Half as high as a page is: the fingertip is drawn by the processor that also computes it.
    with browsing(width, 450) as browser:
        made = browser.made
        made.get(page(port))
        until(lambda: begun(made))
        assert made.execute_script("return document.body.scrollWidth") <= width
        type_number(made, "load [N]", 0.0)
        made.find_element(
            "xpath", '//label[text()="controller grips"]/following::input[1]'
        ).send_keys(" ")
        until(lambda: bool(field(made, "grip [N]").is_enabled()))
        type_number(made, "grip [N]", 4.0)
        until(lambda: abs(true_values(made)["normal"] - 4.0) < 0.2)
        type_number(made, "load [N]", 1.0)
        until(lambda: abs(true_values(made)["friction"] - 1.0) < 0.1)
        type_number(made, "grip [N]", 2.5)
        until(lambda: abs(true_values(made)["normal"] - 2.5) < 0.2)
        severe = [line for line in browser.complaints() if "SEVERE" in line]
        assert severe == []
        assert browser.requested() == {page(port)}


@pytest.mark.usefixtures("server")
def test_two_pages_a_reload_and_one_that_is_closed(port: int, browsing: Browsing) -> None:
    address = page(port)
    with browsing(1280) as first:
        first.made.get(address)
        until(lambda: begun(first.made))
        with browsing(1280) as second:
            second.made.get(address)
            until(lambda: begun(second.made))
            type_number(second.made, "load [N]", 0.3)
            until(lambda: field(first.made, "load [N]").get_attribute("value") == "0.3")
        first.made.refresh()
        until(lambda: begun(first.made))
        assert field(first.made, "load [N]").get_attribute("value") == "0.3"


@pytest.mark.parametrize("word", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_server_that_ends_frees_its_port(
    word: signal.Signals, server: subprocess.Popen[str], port: int
) -> None:
    time.sleep(2.0)
    server.send_signal(word)
    ended = server.wait(timeout=20.0)
    assert ended in (130, 143, -signal.SIGKILL)
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
        wanted = {
            "load [N]",
            "twist [N mm]",
            "controller grips",
            "pause",
            "step",
            "restart",
            "record",
        }
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


@pytest.mark.usefixtures("server")
def test_a_file_and_a_recording_through_the_page(
    port: int, browsing: Browsing, tmp_path: Path
) -> None:
    (tmp_path / "flat.stl").write_text("solid flat\nendsolid flat\n")
    trimesh.creation.icosphere(subdivisions=3, radius=9.0).export(tmp_path / "egg.stl")
    with browsing(1280) as browser:
        made = browser.made
        made.get(page(port))
        until(lambda: begun(made))
        body = made.find_element("tag name", "body")
        press(made, "record")
        until(lambda: "recording into" in body.text)
        folded = made.find_element("xpath", '//*[contains(text(), "starts the grasp again")]')
        made.execute_script("arguments[0].click()", folded)
        taken = made.find_element("css selector", 'input[type="file"]')
        taken.send_keys(str(tmp_path / "flat.stl"))
        until(lambda: "Refused: " in body.text and "flat.stl" in body.text)
        assert begun(made)
        made.find_element("css selector", 'input[type="file"]').send_keys(str(tmp_path / "egg.stl"))
        until(lambda: "recorded" in body.text or "recording into" in body.text)
        until(lambda: (tmp_path / "kept/001/report.html").is_file())
        until(lambda: time_shown(made) < 5.0)
        assert "Refused" not in body.text


def test_a_token_lets_a_browser_in_and_keeps_the_others_out(
    port: int, browsing: Browsing, tmp_path: Path
) -> None:
    with serving(port, tmp_path, *SCENE, "--host", "0.0.0.0") as (_, address):
        token = address.rpartition("/")[2]
        with browsing(1280) as browser:
            made = browser.made
            made.get(f"http://127.0.0.1:{port}/")
            assert "needs the token" in made.find_element("tag name", "body").text
            made.get(f"http://127.0.0.1:{port}/{token}")
            until(lambda: begun(made))
            made.get("data:text/html,<p>another site")
            script = """
                const done = arguments[arguments.length - 1];
                const open = new WebSocket(arguments[0], "viser-v" + arguments[1]);
                open.onopen = () => done("open");
                open.onerror = () => done("refused");
            """
            for path in ("", token):
                url = f"ws://127.0.0.1:{port}/{path}"
                version = importlib.metadata.version("viser")
                assert made.execute_async_script(script, url, version) == "refused"


@pytest.mark.parametrize("width", [1280, 420])
def test_a_finished_run(width: int, port: int, browsing: Browsing, tmp_path: Path) -> None:
    from chromagrip import load_scene, run

    scene = load_scene("camera-100hz", {"path": "truth", "duration_s": 0.5})
    run(scene, tmp_path / "done")
    with serving(port, tmp_path, "--run", str(tmp_path / "done")), browsing(width) as browser:
        made = browser.made
        made.get(page(port))
        body = made.find_element("tag name", "body")
        until(lambda: "agrees with the record" in body.text)
        until(lambda: time_shown(made) == 0.5)
        type_number(made, "time [s]", 0.2)
        until(lambda: time_shown(made) == 0.2)
        press(made, "step")
        until(lambda: time_shown(made) == 0.21)
        assert made.execute_script("return document.body.scrollWidth") <= width
        assert [line for line in browser.complaints() if "SEVERE" in line] == []
        assert browser.requested() == {page(port)}
