"""Names of sources: pictures, patterns, arrays, and sources of one's own."""

import json
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import cv2
import numpy as np
import pytest

from chromagrip import UserError
from chromagrip.sources import open_source

Typed = Callable[..., CompletedProcess[str]]
#: Pictures, not square.
PICTURES = np.random.default_rng(6).integers(0, 256, (12, 4, 7, 3), dtype=np.uint8)


@pytest.fixture
def shots(tmp_path: Path) -> Path:
    """Pictures 0 to 11, their numbers without zeros in front, with others beside them."""
    folder = tmp_path / "shots"
    folder.mkdir()
    for k, image in enumerate(PICTURES):
        cv2.imwrite(str(folder / f"frame-{k}.png"), image[..., ::-1])
    cv2.imwrite(str(folder / "rest.png"), PICTURES[0])
    cv2.imwrite(str(folder / ".hidden.png"), PICTURES[0])
    (folder / "notes.txt").write_text("nothing")
    return folder


def images(name: object, **more: Any) -> np.ndarray:
    return np.array([frame.image for frame in open_source(str(name), **more).frames()])


@pytest.mark.parametrize("pattern", ["", "/*", "/frame-?*.png", "/../**/*.png"])
def test_a_folder_and_patterns_of_it_are_the_same(pattern: str, shots: Path) -> None:
    np.testing.assert_array_equal(images(f"{shots}{pattern}"), PICTURES)


def test_parts_of_a_folder_and_files_with_signs_of_a_pattern(shots: Path) -> None:
    left = images(shots / "frame-[3-5].png", without=shots / "frame-4.png")
    np.testing.assert_array_equal(left, PICTURES[[3, 5]])
    cv2.imwrite(str(shots / "press[1].png"), PICTURES[0, ..., ::-1])
    np.testing.assert_array_equal(images(shots / "press[1].png"), PICTURES[:1])


def test_repeated_pictures_are_counted(shots: Path) -> None:
    (shots / "frame-12.png").write_bytes((shots / "frame-11.png").read_bytes())
    source = open_source(str(shots))
    for _ in range(2):  # each time from the first one
        assert len(list(source.frames())) == 13
        counts = source.delivery.counts
        assert counts == {"repeated": 1, "dropped": None, "stalled": None, "late": None}


def test_times_of_an_archive(tmp_path: Path) -> None:
    """Three frames are missing."""
    times = 0.5 + 0.02 * np.delete(np.arange(15), [6, 9, 10])
    np.savez_compressed(tmp_path / "c.npz", frames=PICTURES, time_s=times)
    source = open_source(str(tmp_path / "c.npz"))
    assert [frame.time for frame in source.frames()] == pytest.approx(times)
    assert source.delivery.counts["dropped"] == 3
    assert source.fps == pytest.approx(11 / 0.28)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("none.npz", "there is no none.npz; give a picture, a folder of pictures"),
        ("none", "there is no none; give .* another one of `chromagrip list sources`"),
        ("*.txt", r"pattern \*.txt has no pictures; expected .png"),
        ("json:JSONDecoder", "source 'json:JSONDecoder' has no read; see chromagrip.sources.Frame"),
        ("mine:Own(cont=3)", r"has no argument cont \(did you mean count\?\); it has count, of"),
        (5, "source 'builtins:int' has no read"),
        ("camera:0(fps=60", "expected a camera's number, as camera:0 or camera:0"),
        ("camera:0(exposur=1)", r"has no argument exposur \(did you mean exposure\?\); it has"),
        ("camera:0(gain=high)", "gain = 'high'; expected a number"),
        ("camera:0(width=640)", "width and height go together"),
        ("pipe:a(live=3)", r"expected pipe:FILE or pipe:FILE\(live=true\)"),
    ],
)
def test_what_is_no_source_is_one_sentence(
    name: Any, words: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.txt").write_text("nothing")
    with pytest.raises(UserError, match=words):
        list(open_source(name).frames())


class Own:
    """A source of one's own: the last pictures first."""

    def __init__(self, count: int = 3, of: str = "all") -> None:
        self.left, self.of = count, of

    def read(self) -> tuple[np.ndarray, float] | None:
        self.left -= 1
        return None if self.left < 0 else (PICTURES[self.left], 10.0 - self.left)


class Stored(Own):
    live = False


def installed(group: str) -> list[EntryPoint]:
    assert group == "chromagrip.sources"
    return [EntryPoint("installed", "mine:Stored", group)]


@pytest.fixture(autouse=True)
def _own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mine", sys.modules[__name__])


@pytest.mark.parametrize(
    ("choice", "name", "count", "live"),
    [
        ("mine:Own(count=2, of=some)", "mine:Own(count=2, of=some)", 2, True),
        (Stored, f"{__name__}:Stored", 3, False),
        ("installed", "installed", 3, False),
    ],
)
def test_sources_of_ones_own(
    choice: Any, name: str, count: int, live: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("chromagrip.by_name.entry_points", installed)
    source = open_source(choice)
    assert (source.name, source.live, source.timed) == (name, live, True)
    frames = list(source.frames())
    np.testing.assert_array_equal(
        np.array([frame.image for frame in frames]), PICTURES[:count][::-1]
    )
    assert [frame.time for frame in frames] == [11.0 - count + k for k in range(count)]


FRAME = (PICTURES[0], 1.0)


@pytest.mark.parametrize(
    ("found", "words"),
    [
        ((FRAME, OSError("unplugged")), r"failed after 1 frames: OSError: unplugged \(test_open"),
        ((FRAME, SystemExit(0)), "failed after 1 frames: SystemExit: 0"),
        ((FRAME, UserError("no light in the gel")), "^no light in the gel$"),
        ((FRAME, PICTURES[0]), "it gave the time None; wanted: a number"),
        (((PICTURES[0, ..., 0], 0.0),), r"it gave uint8 \(4, 7\); wanted: \(picture uint8"),
        (((PICTURES[0], np.nan),), "it gave the time nan; wanted: a number of seconds"),
        (((PICTURES[0], 2.0), FRAME), "frame 1 of .* has the time 1 s, the one before 2 s"),
    ],
)
def test_what_a_source_of_ones_own_must_not_give(found: tuple[object, ...], words: str) -> None:
    left = list(found)

    class Gives:
        def read(self) -> object:
            one = left.pop(0)
            if isinstance(one, BaseException):
                raise one
            return one

    with pytest.raises(UserError, match=words):
        list(open_source(Gives()).frames())


def test_the_list_of_sources(typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("chromagrip.by_name.entry_points", installed)
    listed = json.loads(typed("list", "sources", "--json").stdout)
    assert listed["installed"] == "mine:Stored, installed"
    assert {"camera:N", "FOLDER", "pipe:FILE", "BAG", "MODULE:CLASS"} <= set(listed)
