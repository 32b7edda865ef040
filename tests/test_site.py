"""The documentation as a site, and its tutorials as notebooks."""

import inspect
import re
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
TUTORIALS = sorted((ROOT / "docs/tutorials").glob("*.md"))

pytestmark = pytest.mark.environments  # notebooks take minutes, the site fetches its packages


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built with the command of the documentation."""
    folder = tmp_path_factory.mktemp("site")
    begun = time.monotonic()
    done = subprocess.run(
        ["./run", "docs", "--site-dir", str(folder)], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr + done.stdout
    assert time.monotonic() - begun < 120.0
    return folder


def text_of(page: Path) -> str:
    """What a reader sees, with single spaces."""
    return " ".join(re.sub(r"<[^>]+>", " ", page.read_text(encoding="utf-8")).split())


def test_every_public_name_has_a_page_with_its_parameters(site: Path) -> None:
    for package in ("", "model", "render", "tracking", "control"):
        module = import_module(f"chromagrip.{package}".rstrip("."))
        for name in set(module.__all__) - {"__version__"}:
            text = text_of(site / "reference" / package / f"{name}.html")
            value = getattr(module, name)
            assert ".".join(filter(None, ["chromagrip", package, name])) in text
            if inspect.isfunction(value):
                assert "Source code in" in text, name
                assert all(f" {one} " in text for one in inspect.signature(value).parameters), name


def test_nothing_is_fetched_from_another_host(site: Path) -> None:
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        fetched = re.findall(r"<(?:script|img|iframe|source)[^>]+src=\"(\w+:)?//", text)
        styles = re.findall(r"<link[^>]+rel=\"(?:stylesheet|preconnect)\"[^>]+href=\"https?:", text)
        assert not fetched, page
        assert not styles, page


def test_what_is_typed_is_found_in_a_browser_from_disk(
    site: Path, browsing: Callable[[int], AbstractContextManager[Any]]
) -> None:
    with browsing(420) as browser:
        page = browser.made
        page.get((site / "index.html").as_uri())
        page.execute_script("document.querySelector('[data-md-toggle=search]').click()")
        page.find_element("css selector", "[data-md-component=search-query]").send_keys(
            "largest_grip"
        )
        deadline, found = time.monotonic() + 20.0, ""
        while time.monotonic() < deadline and "model/largest_grip.html" not in found:
            links = page.find_elements("css selector", ".md-search-result__link")
            found = " ".join(link.get_attribute("href") for link in links)
            time.sleep(0.2)
        assert "reference/model/largest_grip.html" in found
        assert browser.complaints() == []
        assert all(address.startswith("file:") for address in browser.requested())


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_tutorials_run_as_notebooks(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every cell runs, and prints about as many lines as the page shows."""
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:/usr/bin:/bin")
    book = import_module("website.notebook").executed(page, tmp_path)
    cells = [cell for cell in book.cells if cell.cell_type == "code"]
    text = page.read_text(encoding="utf-8")
    assert len(cells) == len(re.findall(r"^```(?:bash|python)$", text, re.MULTILINE))
    shown = len(re.findall(r"^```text$", text, re.MULTILINE))
    printed = [one for cell in cells for one in cell.outputs if one.get("name") == "stdout"]
    assert len(printed) >= shown > 0
