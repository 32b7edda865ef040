"""The report in a real browser: the slider moves everything, by keys alone too."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from chromagrip import load_scene
from chromagrip.loop.results.run_folder import read_run
from chromagrip.loop.run import run

Browsing = Callable[[int], Any]
pytestmark = [pytest.mark.browser]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("run")
    run(load_scene("camera-100hz", {"duration_s": 1.2}), made)
    return made


@pytest.mark.parametrize("width", [1280, 420])
def test_the_slider_moves_everything(folder: Path, width: int, browsing: Browsing) -> None:
    trace = read_run(folder).columns
    with browsing(width) as browser:
        made = browser.made
        begin = time.perf_counter()
        made.get((folder / "report.html").as_uri())
        assert time.perf_counter() - begin < 10.0  # 2 s are asked for, of a machine of its own
        assert made.execute_script("return document.body.scrollWidth") <= width
        slider = made.find_element("id", "time")
        video = made.find_element("tag name", "video")
        made.execute_script(
            "arguments[0].value = 0.6; arguments[0].dispatchEvent(new Event('input'))", slider
        )
        assert made.find_element("id", "now").text == "0.60 s"
        shown = made.find_element("css selector", ".legend li b").text  # of the true Γ
        assert float(shown) == pytest.approx(trace["margin_true"][60], abs=2e-3)
        wanted = 4 * 0.6
        for _ in range(100):
            at = made.execute_script("return arguments[0].currentTime", video)
            ready = made.execute_script("return arguments[0].readyState", video)
            if abs(at - wanted) < 0.05 and ready >= 2:
                break
            time.sleep(0.05)
        assert abs(at - wanted) < 0.05
        assert browser.complaints() == []
        assert browser.requested() == {(folder / "report.html").as_uri()}


def test_keys_alone_suffice(folder: Path, browsing: Browsing) -> None:
    with browsing(1280) as browser:
        made = browser.made
        made.get((folder / "report.html").as_uri())
        from selenium.webdriver.common.keys import Keys

        focused = made.switch_to.active_element
        for _ in range(10):
            focused.send_keys(Keys.TAB)
            focused = made.switch_to.active_element
            if focused.get_attribute("id") == "time":
                break
        assert focused.get_attribute("id") == "time"
        focused.send_keys(Keys.HOME)
        assert made.find_element("id", "now").text == "0.00 s"
        focused.send_keys(Keys.ARROW_RIGHT)
        assert made.execute_script("return Number(arguments[0].value)", focused) > 0.0
        focused.send_keys(" ")  # plays
        time.sleep(1.0)
        playing = float(made.find_element("id", "now").text.split()[0])
        assert 0.05 < playing < 1.2
        focused.send_keys(" ")  # and stops
        stopped = made.find_element("id", "now").text
        time.sleep(0.3)
        assert made.find_element("id", "now").text == stopped
