"""The live page in a real browser: its sliders change the grasp, and nothing of it is left over."""

import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytestmark = pytest.mark.slow
Browsing = Callable[[int], Any]


@pytest.fixture
def server(port: int) -> Iterator[subprocess.Popen[str]]:
    words = ["live", "dome-1", "--set", "path=truth", "--port", str(port)]
    command = [sys.executable, "-P", "-m", "chromagrip", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith(f"http://127.0.0.1:{port}")
        yield process
        process.kill()


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


def until(condition: Callable[[], bool], seconds: float = 40.0) -> None:
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
    with browsing(width) as browser:
        made = browser.made
        made.get(f"http://127.0.0.1:{port}")
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
        assert browser.requested() == {f"http://127.0.0.1:{port}/"}


@pytest.mark.usefixtures("server")
def test_two_pages_a_reload_and_one_that_is_closed(port: int, browsing: Browsing) -> None:
    address = f"http://127.0.0.1:{port}"
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


def test_a_port_in_use_is_one_sentence(port: int) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", port))
        taken.listen()
        command = [sys.executable, "-P", "-m", "chromagrip", "live", "--port", str(port)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert re.fullmatch(rf"chromagrip: port {port} cannot be used: .*\n", done.stderr)
