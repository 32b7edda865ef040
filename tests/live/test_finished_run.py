"""The page of a finished run repeats it where that is possible, and says so where it is not."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from chromagrip import load_scene
from chromagrip.live import replay as module
from chromagrip.live.replay import Replay, not_repeated
from chromagrip.live.run_page import RunPage
from chromagrip.live.view import GraspView
from chromagrip.loop.results.run_folder import read_run
from chromagrip.outside.grasp import run_outside

Until = Callable[..., None]
CHANGES = {"path": "camera", "duration_s": 0.3, "camera.rate_hz": 50.0, "camera.rest_frames": 2}


@contextmanager
def shown(server: Any, folder: Path) -> Iterator[RunPage]:
    found = read_run(folder)
    view = GraspView(server)
    if not not_repeated(found):
        view.begin(found.scene)
    with Replay(found, view) as replay:
        yield RunPage(server, replay)
        replay.check()


def played(page: RunPage, until: Until) -> str:
    """What the page says once it has played to its end."""

    def ended() -> bool:
        page.tick()
        return page._replay.ended and not page._playing

    until(ended)
    page.tick()
    return str(page.board._status.content)


def test_a_run_is_repeated_and_agrees(viser_server: Any, dome_run: Path, until: Until) -> None:
    with shown(viser_server, dome_run) as page:
        assert "repeated from scene and seed; it agrees with the record" in played(page, until)
        frames = page._replay.frames
        of = read_run(dome_run).columns
        assert [kept.time for kept in frames] == pytest.approx(of["time_s"].tolist())
        last = frames[-1].true
        assert last is not None
        assert last.normal.sum() == pytest.approx(of["normal_true_n"][-1], rel=1e-5)
        assert page.board.strips is not None
        assert page.board.strips._rows[-1]["margin_estimated"] == of["margin_estimated"][-1]


@pytest.mark.loops
def test_time_goes_where_it_is_put(viser_server: Any, dome_run: Path, until: Until) -> None:
    with shown(viser_server, dome_run) as page:
        played(page, until)
        arrows = np.array(page._replay.view._arrows.points)
        page._slider.value = 0.1
        page._moved(SimpleNamespace(client_id=0))  # a hand's
        page.tick()
        assert page._now == pytest.approx(0.1)
        assert "**t = 0.10 s** of 0.3 s" in page.board._status.content
        assert arrows.shape != page._replay.view._arrows.points.shape
        page.press("step")
        page.tick()
        assert page._now == pytest.approx(0.12)
        page.press("play")
        until(lambda: (page.tick(), page._now > 0.15)[1])
        page.press("pause")
        stands = page._now
        page.tick()
        assert page._now == stands


@pytest.mark.loops
def test_what_differs_from_the_record_is_said(
    viser_server: Any, dome_run: Path, tmp_path: Path, until: Until
) -> None:
    other = shutil.copytree(dome_run, tmp_path / "other")
    table = pq.read_table(other / "trace.parquet")
    at = table.column_names.index("margin_true")
    changed = table["margin_true"].to_numpy().copy()
    changed[5] += 0.01
    pq.write_table(table.set_column(at, "margin_true", [changed]), other / "trace.parquet")
    with shown(viser_server, other) as page:
        said = played(page, until)
    assert "it differs from the record**, the true Γ by up to 0.01" in said


@pytest.mark.loops
def test_of_a_long_run_every_second_frame_is_kept(
    viser_server: Any, dome_run: Path, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MOST", 8)
    with shown(viser_server, dome_run) as page:
        played(page, until)
        times = [kept.time for kept in page._replay.frames]
    assert times == pytest.approx(np.arange(8) * 0.04)


@pytest.mark.loops
def test_frames_from_outside_have_curves_alone(
    viser_server: Any, dome_run: Path, tmp_path: Path, until: Until
) -> None:
    taken = tmp_path / "taken"
    shutil.copytree(dome_run / "frames", taken)
    (taken / "rest.png").rename(taken / "a-1.png")
    shutil.copyfile(taken / "a-1.png", taken / "a-2.png")
    run_outside(load_scene("dome-1", CHANGES), str(taken), tmp_path / "run", fps=50.0)
    with shown(viser_server, tmp_path / "run") as page:
        said = played(page, until)
        assert page._replay.frames == []
    assert "cannot be repeated, its frames came from outside; only its curves are shown" in said
    assert "true:" not in said
    assert "estimated: Γ" in said


def test_a_recording_shows_its_video(
    viser_server: Any, dome_run: Path, tmp_path: Path, until: Until
) -> None:
    other = shutil.copytree(dome_run, tmp_path / "other")
    text = (other / "summary.json").read_text().rstrip().removesuffix("}")
    (other / "summary.json").write_text(text + ', "recorded_live_from_s": 1.0}')
    with shown(viser_server, other) as page:
        said = played(page, until)
        frames = page._replay.frames
    assert "sliders were moved by hand; curves and video are shown" in said
    assert frames[-1].time == pytest.approx(0.3, abs=0.011)
    assert frames[-1].true is None
