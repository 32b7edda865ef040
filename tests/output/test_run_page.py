"""The page of runs holds what it shows, whatever texts and values it is given."""

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from chromagrip.output.run_page import MOST_INSTANTS, Curve, Panel, RunOnPage, write_run_page


def a_run(name: str = "run", instants: int = 50, **changes: Any) -> RunOnPage:
    time = np.arange(instants) * 0.01
    values = np.sin(time)
    values[3] = math.nan
    curve = Curve(label="value", values=values, role="true", low=values - 1.0, high=values + 1.0)
    usual = {"words": ("It held.",), "facts": (("grip", "1 N"),)}
    panels = [Panel(title="panel [N]", curves=[curve], levels=[("target", 0.3)])]
    return RunOnPage(name=name, time=time, panels=panels, **{**usual, **changes})


def data_of(path: Path) -> Any:
    found = re.search(r'<script id="data"[^>]*>(.*?)</script>', path.read_text("utf-8"), re.S)
    assert found is not None
    return json.loads(found[1])


def test_values_are_those_given_and_nan_is_null(tmp_path: Path) -> None:
    write_run_page(tmp_path / "page.html", [a_run()], "title")
    (run,) = data_of(tmp_path / "page.html")
    values = run["panels"][0]["curves"][0]["values"]
    assert values[3] is None
    assert values[10] == pytest.approx(math.sin(0.1), rel=1e-4)
    low, high = run["panels"][0]["curves"][0]["band"]
    assert high[20] - low[20] == pytest.approx(2.0, rel=1e-3)
    page = (tmp_path / "page.html").read_text("utf-8")
    addresses = set(re.findall(r"https?://[^\"' ]+", page))
    assert addresses == {"http://www.w3.org/2000/svg"}  # the name of a format
    assert "default-src 'none'" in page


def test_no_text_becomes_markup(tmp_path: Path) -> None:
    text = '</script><b><img src=x>"quoted" & more'
    run = a_run(text, words=(text,), facts=((text, text),))
    write_run_page(tmp_path / "page.html", [run, a_run("other")], text)
    page = (tmp_path / "page.html").read_text("utf-8")
    assert data_of(tmp_path / "page.html")[0]["name"] == text
    assert "<b>" not in page
    assert "<img" not in page
    assert page.count("<script") == page.count("</script>")


def test_a_long_run_is_thinned_and_says_so(tmp_path: Path) -> None:
    run = a_run(instants=3 * MOST_INSTANTS + 1)
    assert run.left_out
    write_run_page(tmp_path / "page.html", [run], "title")
    assert len(data_of(tmp_path / "page.html")[0]["time"]) <= MOST_INSTANTS
    assert f"part of the {3 * MOST_INSTANTS + 1} frames" in (tmp_path / "page.html").read_text()
    assert not a_run().left_out
