"""What tests of several files use."""

import hashlib
import json
import math
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import cv2
import pytest
from hypothesis import settings
from threadpoolctl import threadpool_limits

from chromagrip.cli import options
from chromagrip.cli.app import main
from chromagrip.model import ForceField
from chromagrip.tracking import NoEstimateError, SensorCalibration, Tracks

#: Benchmarks lie at the root. Last, so that its `control` hides no other.
sys.path.append(str(Path(__file__).parents[1]))

# A worker of pytest has a core, not all: more threads only wait for each other, at full speed.
threadpool_limits(1)
cv2.setNumThreads(1)
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # for the processes that it starts

# No test is timed: first calls compile.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


def pytest_configure(config: pytest.Config) -> None:
    """Keep tables of domes for the next run, where no other program's take their room."""
    if hasattr(config, "cache"):
        os.environ["XDG_CACHE_HOME"] = str(config.cache.mkdir("user"))


@pytest.fixture
def typed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Iterator[Callable[..., CompletedProcess[str]]]:
    """Runs a command in the test's folder, in this process: a new one takes seconds to start.

    What is raised but an exit fails the test. `start` is another entry point.
    """
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(options, "EVERY_S", math.inf)  # however long it takes here
    monkeypatch.setattr(options, "_received", [])
    monkeypatch.setattr(options, "_interrupted", threading.Event())

    def run(*words: object, start: Callable[[], None] = main) -> CompletedProcess[str]:
        arguments = [str(word) for word in words]
        monkeypatch.setattr(sys, "argv", ["chromagrip", *arguments])
        with pytest.raises(SystemExit) as ended:
            start()
        return CompletedProcess(arguments, int(ended.value.code or 0), *capsys.readouterr())

    yield run
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def until() -> Callable[..., None]:
    """Waits for a condition."""

    def wait(condition: Callable[[], object], seconds: float = 60.0) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if condition():
                return
            time.sleep(0.05)
        raise AssertionError("it did not come to this")

    return wait


@pytest.fixture
def small_files(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[int], None]]:
    """Sets how large a file of this process may get [bytes], until the test ends."""
    resource = pytest.importorskip("resource")
    # Python keeps a module that it could only write in part, as of pandas, which Arrow imports.
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture
def no_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Folder of the user's caches, in which no read-out is kept yet."""
    folder = tmp_path / "cache"
    folder.mkdir()
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    return folder


@pytest.fixture
def bytes_of() -> Callable[[Path], dict[str, str]]:
    """Digest of every file below a folder."""

    def digests(folder: Path) -> dict[str, str]:
        return {
            str(file.relative_to(folder)): hashlib.sha256(file.read_bytes()).hexdigest()
            for file in sorted(folder.rglob("*"))
            if file.is_file()
        }

    return digests


class Browser:
    """Chromium without a window; `made` is Selenium's driver."""

    def __init__(self, made: Any) -> None:
        self.made = made

    def complaints(self) -> list[str]:
        """What the page's console says, but for remarks."""
        said = self.made.get_log("browser")
        return [entry["message"] for entry in said if entry["level"] != "INFO"]

    def requested(self) -> set[str]:
        """Addresses that the page asked for, but for those that hold what they show."""
        logged = self.made.get_log("performance")
        events = [json.loads(entry["message"])["message"] for entry in logged]
        addresses = {
            event["params"]["request"]["url"]
            for event in events
            if event["method"] == "Network.requestWillBeSent"
        }
        return {address for address in addresses if not address.startswith(("data:", "blob:"))}


@contextmanager
def open_browser(width: int, height: int = 900) -> Iterator[Browser]:
    """Browser of a width [px]; the test is skipped where this machine has none."""
    program, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if program is None or driver is None:
        pytest.skip("needs the programs chromium and chromedriver (Debian: chromium-driver)")
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = program
    for word in (
        "--headless=new",
        "--no-sandbox",
        "--hide-scrollbars",
        f"--window-size={width},{height}",
    ):
        options.add_argument(word)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    made = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    try:
        # A window is no narrower than 500 px.
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        made.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        yield Browser(made)
    finally:
        made.quit()


@pytest.fixture
def browsing() -> Callable[[int], AbstractContextManager[Browser]]:
    """Opens a browser of a width [px]."""
    return open_browser


class NoForces:
    """Reconstructor that needs no read-out and never has an estimate."""

    def __init__(self, calibration: SensorCalibration, rest: Tracks) -> None: ...

    def reset(self) -> None: ...

    def update(self, tracks: Tracks) -> ForceField:
        raise NoEstimateError("no forces are estimated")


@pytest.fixture
def no_forces() -> str:
    """`module:Class` of a reconstructor that needs no read-out."""
    return f"{__name__}:NoForces"
