"""The page of pictures from outside: their estimates, and what fails there."""

import re
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from chromagrip.live.watch import Looked, Looking, Watcher, WatchPage
from chromagrip.output.video import VideoFile
from chromagrip.pictures.estimate import estimate_source

Until = Callable[..., None]
CHANGES = {"path": "camera", "duration_s": 0.3, "camera.rate_hz": 50.0}


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
    assert [one.reading.frame.time for one in watched.shown] == pytest.approx(np.arange(17) / 50.0)
    outcome = estimate_source(
        "first:1", str(taken), calibration="thesis", reconstructor="contact", tracker="fit",
        fps=50.0,
    )  # fmt: skip
    last, wanted = watched.shown[-1].reading.observation, outcome.summary["estimates"]
    assert last.field.total_normal == pytest.approx(wanted["normal_n"]["last"], rel=1e-6)
    assert last.margin == pytest.approx(wanted["margin"]["last"], rel=1e-6)


@pytest.mark.loops
def test_a_video_is_shown_again(taken: Path, tmp_path: Path, until: Until) -> None:
    from chromagrip.sources import open_source

    video = VideoFile(tmp_path / "taken.mkv", 50, codec="ffv1")
    for frame in open_source(str(taken), fps=50.0).frames():
        video.append(frame.image)
    video.close()
    with watching(looking(tmp_path / "taken.mkv")) as (watcher, watched):
        until(lambda: len(watched.told) == 1)
        count = len(watched.shown)
        watcher.restart()
        until(lambda: len(watched.told) == 2)
    assert count == 17
    assert len(watched.shown) == 34
    assert watched.shown[17].reading.frame.time == 0.0


@pytest.mark.loops
def test_a_pause_stands_and_a_step_is_one_frame(taken: Path, until: Until) -> None:
    with watching(looking(taken)) as (watcher, watched):
        watcher.paused = True
        time.sleep(0.5)
        count = len(watched.shown)
        time.sleep(0.2)
        assert len(watched.shown) == count < 17
        watcher.step_once()
        until(lambda: len(watched.shown) > count)
        watcher.paused = False
        until(lambda: watched.told)
    assert len(watched.shown) == 17


def test_pictures_that_break_off_are_a_sentence(taken: Path, tmp_path: Path, until: Until) -> None:
    for file in sorted(taken.iterdir())[:4]:
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / "z.png").write_bytes(b"\x89PNG")
    with watching(looking(tmp_path)) as (_, watched):
        until(lambda: watched.told)
    assert "z.png cannot be read" in watched.told[0]
    assert len(watched.shown) == 4


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
