"""Pages of a finished run, which is repeated where that can be, and of pictures from outside."""

import re
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from chromagrip.live import replay as module
from chromagrip.live.replay import Replay, not_repeated
from chromagrip.live.run_page import RunPage
from chromagrip.live.view import GraspView
from chromagrip.live.watch import Looked, Looking, Watcher, WatchPage
from chromagrip.loop.results.run_folder import read_run
from chromagrip.output.video import VideoFile
from chromagrip.pictures.estimate import estimate_source
from chromagrip.sources import open_source

Until = Callable[..., None]


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


@pytest.mark.loops
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
        page._slider.value = 0.04
        page._moved(SimpleNamespace(client_id=0))  # a hand's
        page.tick()
        assert page._now == pytest.approx(0.04)
        assert "**t = 0.04 s** of 0.1 s" in page.board._status.content
        assert arrows.shape != page._replay.view._arrows.points.shape
        page.press("step")
        page.tick()
        assert page._now == pytest.approx(0.06)
        page.press("play")
        until(lambda: (page.tick(), page._now > 0.07)[1])
        page.press("pause")
        stands = page._now
        page.tick()
        assert page._now == stands


@pytest.mark.loops
def test_what_differs_is_said_and_of_a_long_run_every_second_frame_is_kept(
    viser_server: Any, dome_run: Path, tmp_path: Path, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MOST", 5)
    other = shutil.copytree(dome_run, tmp_path / "other")
    table = pq.read_table(other / "trace.parquet")
    at = table.column_names.index("margin_true")
    changed = table["margin_true"].to_numpy().copy()
    changed[5] += 0.01
    pq.write_table(table.set_column(at, "margin_true", [changed]), other / "trace.parquet")
    with shown(viser_server, other) as page:
        assert "it differs from the record**, the true Γ by up to 0.01" in played(page, until)
        times = [kept.time for kept in page._replay.frames]
    assert times == pytest.approx(np.arange(3) * 0.04)


@pytest.mark.loops
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
    assert frames[-1].time == pytest.approx(0.1, abs=0.011)
    assert frames[-1].true is None


@pytest.fixture(scope="module")
def taken(dome_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the pictures of a grasp, the one at rest first."""
    folder = shutil.copytree(dome_run / "frames", tmp_path_factory.mktemp("taken") / "frames")
    (folder / "rest.png").rename(folder / "a-rest.png")
    return folder


def looking(source: Path | str, calibration: str = "thesis") -> Looking:
    return Looking(
        source=str(source), rest="first:1", fps=50.0, calibration=calibration,
        reconstructor="contact",
    )  # fmt: skip


class Watched:
    """What a watcher shows and tells."""

    def __init__(self) -> None:
        self.shown: list[Looked] = []
        self.told: list[str] = []


@contextmanager
def watching(asked: Looking) -> Iterator[tuple[Watcher, Watched]]:
    watched = Watched()
    with Watcher(asked, asked.open(), watched.shown.append, watched.told.append) as watcher:
        yield watcher, watched
        watcher.check()


@pytest.mark.loops
def test_a_folder_is_estimated_as_by_the_command(taken: Path, tmp_path: Path, until: Until) -> None:
    with watching(looking(taken)) as (_, watched):
        until(lambda: watched.told)
    assert watched.told == [f"**{taken} has ended;** restart shows it again"]
    assert [one.reading.frame.time for one in watched.shown] == pytest.approx(np.arange(7) / 50.0)
    outcome = estimate_source(
        "first:1", str(taken), calibration="thesis", reconstructor="contact", tracker="fit",
        fps=50.0,
    )  # fmt: skip
    last, wanted = watched.shown[-1].reading.observation, outcome.summary["estimates"]
    assert last.field.total_normal == pytest.approx(wanted["normal_n"]["last"], rel=1e-6)
    assert last.margin == pytest.approx(wanted["margin"]["last"], rel=1e-6)


@pytest.mark.loops
def test_a_video_pauses_steps_and_is_shown_again(taken: Path, tmp_path: Path, until: Until) -> None:
    video = VideoFile(tmp_path / "taken.mkv", 50, codec="ffv1")
    for frame in open_source(str(taken), fps=50.0).frames():
        video.append(frame.image)
    video.close()
    with watching(looking(tmp_path / "taken.mkv")) as (watcher, watched):
        watcher.paused = True
        time.sleep(0.5)
        count = len(watched.shown)
        time.sleep(0.2)
        assert len(watched.shown) == count < 7
        watcher.step_once()
        until(lambda: len(watched.shown) > count)
        watcher.paused = False
        until(lambda: len(watched.told) == 1)
        assert len(watched.shown) == 7
        watcher.restart()
        until(lambda: len(watched.told) == 2)
    assert len(watched.shown) == 14
    assert watched.shown[7].reading.frame.time == 0.0


@pytest.mark.loops
def test_the_page_shows_estimates_and_no_truth(
    taken: Path, viser_server: Any, until: Until, tmp_path: Path
) -> None:
    folder = shutil.copytree(taken, tmp_path / "frames")
    shutil.copy(max(folder.glob("*.png")), folder / "z-again.png")
    asked = looking(folder)
    page = WatchPage(viser_server, asked)
    with Watcher(asked, asked.open(), page.show, page.tell) as watcher:
        page.connect(watcher)
        until(lambda: "has ended" in page.board._status.content)
        watcher.check()
    said = page.board._status.content
    assert re.search(r"estimated: Γ 0\.\d\d \(0\.\d\d to 0\.\d\d\), ΣFn 0\.\d\d N", said)
    assert re.search(r"µ 0\.\d\d \(", said)
    assert "true" not in said
    assert "frames of the source: 1 repeated" in said
    assert len(page._view._arrows.points) > 20
    assert page._view._object is None
