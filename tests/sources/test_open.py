"""Names of sources: pictures, patterns, arrays, and sources of one's own."""

import json
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any, ClassVar

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


@pytest.mark.parametrize("pattern", ["", "/*", "/*.png", "/frame-?*.png", "/../**/*.png"])
def test_a_folder_and_patterns_of_it_are_the_same(pattern: str, shots: Path) -> None:
    source = open_source(f"{shots}{pattern}", fps=10.0)
    assert (source.count, source.timed, source.fps_from) == (12, False, "given")
    frames = list(source.frames())
    np.testing.assert_array_equal(np.array([frame.image for frame in frames]), PICTURES)
    assert [frame.time for frame in frames] == pytest.approx(np.arange(12) / 10.0)
    assert source.delivery.counts["repeated"] == 0


def test_a_part_of_a_folder_without_its_rest_picture(shots: Path) -> None:
    np.testing.assert_array_equal(images(shots / "frame-[3-5].png"), PICTURES[3:6])
    left = images(shots / "frame-[3-5].png", without=shots / "frame-4.png")
    np.testing.assert_array_equal(left, PICTURES[[3, 5]])


def test_a_file_with_signs_of_a_pattern_is_a_file(tmp_path: Path) -> None:
    for name in ("press[1].png", "press(1).png", "press*.png"):
        cv2.imwrite(str(tmp_path / name), PICTURES[0, ..., ::-1])
        np.testing.assert_array_equal(images(tmp_path / name), PICTURES[:1])


def test_repeated_pictures_are_counted(shots: Path) -> None:
    (shots / "frame-12.png").write_bytes((shots / "frame-11.png").read_bytes())
    source = open_source(str(shots))
    for _ in range(2):  # each time from the first one
        assert len(list(source.frames())) == 13
        counts = source.delivery.counts
        assert counts == {"repeated": 1, "dropped": None, "stalled": None, "late": None}


def test_arrays(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", PICTURES)
    np.savez(tmp_path / "b.npz", images=PICTURES, other=np.zeros(3))
    times = 0.5 + 0.02 * np.delete(np.arange(15), [6, 9, 10])  # three frames are missing
    np.savez_compressed(tmp_path / "c.npz", frames=PICTURES, time_s=times)
    for name in ("a.npy", "b.npz", "c.npz"):
        source = open_source(str(tmp_path / name))
        frames = list(source.frames())
        np.testing.assert_array_equal(np.array([frame.image for frame in frames]), PICTURES)
        assert frames[0].image.flags.writeable
        timed = name == "c.npz"
        expected = times if timed else np.arange(12) / 30.0
        assert [frame.time for frame in frames] == pytest.approx(expected)
        assert (source.count, source.timed) == (12, timed)
        assert source.delivery.counts["dropped"] == (3 if timed else None)
    assert source.fps == pytest.approx(11 / 0.28)
    given = open_source(str(tmp_path / "c.npz"), fps=100.0)
    assert [frame.time for frame in given.frames()] == pytest.approx(np.arange(12) / 100.0)


def save_cut(path: Path) -> None:
    np.save(path, PICTURES)
    path.write_bytes(path.read_bytes()[:-100])


def save_damaged(path: Path) -> None:
    np.savez(path, images=PICTURES)
    data = bytearray(path.read_bytes())
    data[400] ^= 255
    path.write_bytes(data)


def save_times(times: np.ndarray) -> Callable[[Path], None]:
    return lambda path: np.savez(path, images=PICTURES, times=times)


@pytest.mark.parametrize(
    ("name", "save", "words"),
    [
        ("a.npy", lambda p: np.save(p, PICTURES / 255.0), r"has float64 \(12, 4, 7, 3\); wanted"),
        ("a.npy", lambda p: np.save(p, PICTURES[:, :0]), r"has uint8 \(12, 0, 7, 3\); wanted"),
        ("a.npy", lambda p: np.save(p, np.asfortranarray(PICTURES)), "columns first; wanted"),
        ("a.npy", lambda p: np.save(p, np.array([{}]), allow_pickle=True), r"has object \(1,\)"),
        ("a.npy", lambda p: p.write_bytes(b"PK"), "a.npy cannot be read: .*; wanted: an array"),
        ("a.npy", save_cut, "a.npy breaks off after 10 of 12 frames$"),
        ("a.npz", save_damaged, "a.npz cannot be read: Bad CRC-32"),
        ("a.npz", lambda p: p.write_bytes(b"PK"), "a.npz cannot be read"),
        (
            "a.npz",
            lambda p: np.savez(p, a=PICTURES, b=PICTURES),
            "has a, b; wanted: an array uint8",
        ),
        ("a.npz", save_times(np.zeros(3)), r"has times float64 \(3,\); wanted: .* times or time_s"),
        ("a.npz", save_times(np.full(12, np.nan)), r"has times float64 \(12,\); wanted"),
        ("a.npz", save_times(-np.arange(12.0)), "frame 1 of .*a.npz has the time -1 s, the one be"),
    ],
)
def test_arrays_that_are_no_pictures(
    name: str, save: Callable[[Path], object], words: str, tmp_path: Path
) -> None:
    save(tmp_path / name)
    with pytest.raises(UserError, match=words):
        images(tmp_path / name)
    np.save(tmp_path / "a.npy", PICTURES)
    with pytest.raises(UserError, match="has 7×4 pixels"):
        open_source(str(tmp_path / "a.npy"), max_megapixels=2e-5)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("none.npz", "there is no none.npz; give a picture, a folder of pictures"),
        ("none.mcap(topic=/a)", r"there is no none.mcap\(topic=/a\); give"),
        ("none", "there is no none; give .* another one of `chromagrip list sources`"),
        ("*.txt", r"pattern \*.txt has no pictures; expected .png"),
        ("json:JSONDecoder", "source 'json:JSONDecoder' has no read; see chromagrip.sources.Frame"),
        ("mine:Source", "module mine has no Source"),
        ("mine:Own(cont=3)", r"has no argument cont \(did you mean count\?\); it has count, of"),
        ("mine:Own(count=", "expected module:Class"),
        (5, "source 'builtins:int' has no read"),
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
    """A source of one's own, which writes each picture into the same memory."""

    closed: ClassVar[int] = 0

    def __init__(self, count: int = 3, of: str = "all") -> None:
        self.left, self.memory, self.of = count, np.zeros((4, 7, 3), np.uint8), of

    def read(self) -> tuple[np.ndarray, float] | None:
        self.left -= 1
        if self.left < 0:
            return None
        self.memory[:] = PICTURES[self.left]
        return self.memory, 10.0 - self.left

    def close(self) -> None:
        type(self).closed += 1


class Stored(Own):
    live = False


@pytest.fixture(autouse=True)
def _own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Own, "closed", 0)
    monkeypatch.setattr(Stored, "closed", 0)
    monkeypatch.setitem(sys.modules, "mine", sys.modules[__name__])


@pytest.mark.parametrize(
    ("choice", "name", "count", "live"),
    [
        ("mine:Own", "mine:Own", 3, True),
        ("mine:Own(count=2, of=some)", "mine:Own(count=2, of=some)", 2, True),
        ("mine:Stored(count=5)", "mine:Stored(count=5)", 5, False),
        (Stored, f"{__name__}:Stored", 3, False),
        (Own(4), f"{__name__}:Own", 4, True),
        ("installed", "installed", 3, False),
    ],
)
def test_sources_of_ones_own(
    choice: Any, name: str, count: int, live: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def installed(group: str) -> list[EntryPoint]:
        assert group == "chromagrip.sources"
        return [EntryPoint("installed", "mine:Stored", group)]

    monkeypatch.setattr("chromagrip.by_name.entry_points", installed)
    source = open_source(choice)
    assert (source.name, source.live, source.timed) == (name, live, True)
    frames = list(source.frames())
    wanted = PICTURES[:count][::-1]
    np.testing.assert_array_equal(np.array([frame.image for frame in frames]), wanted)
    assert [frame.time for frame in frames] == [11.0 - count + k for k in range(count)]
    assert source.delivery.counts["repeated"] == 0
    assert Own.closed + Stored.closed == 1
    if not live:  # from the first one again, and closed where it is left
        assert len(list(source.frames())) == count
        left = source.frames()
        next(left)
        left.close()  # type: ignore[attr-defined]
        assert Stored.closed == 3


def gives(*found: object) -> type:
    class Gives:
        def __init__(self) -> None:
            self.rest = list(found)

        def read(self) -> object:
            one = self.rest.pop(0)
            if isinstance(one, BaseException):
                raise one
            return one

    return Gives


FRAME = (PICTURES[0], 1.0)


@pytest.mark.parametrize(
    ("found", "words"),
    [
        ((FRAME, OSError("unplugged")), r"failed after 1 frames: OSError: unplugged \(test_open"),
        ((FRAME, SystemExit(0)), "failed after 1 frames: SystemExit: 0"),
        ((FRAME, UserError("no light in the gel")), "^no light in the gel$"),
        ((FRAME, PICTURES[0]), "it gave the time None; wanted: a number"),
        (((PICTURES[0, ..., 0], 0.0),), r"it gave uint8 \(4, 7\); wanted: \(picture uint8"),
        ((("picture", 0.0),), "it gave str; wanted"),
        (((PICTURES[0], np.nan),), "it gave the time nan; wanted: a number of seconds"),
        (((PICTURES[0], "now"),), "it gave the time 'now'; wanted"),
        (((PICTURES[0], 2.0), FRAME), "frame 1 of .* has the time 1 s, the one before 2 s"),
    ],
)
def test_what_a_source_of_ones_own_must_not_give(found: tuple[object, ...], words: str) -> None:
    with pytest.raises(UserError, match=words):
        list(open_source(gives(*found)).frames())


def test_the_list_of_sources(typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
    def installed(group: str) -> list[EntryPoint]:
        return [EntryPoint("ours", "mine:Stored", group)]

    monkeypatch.setattr("chromagrip.by_name.entry_points", installed)
    listed = json.loads(typed("list", "sources", "--json").stdout)
    assert listed["ours"] == "mine:Stored, installed"
    assert {"camera:N", "FOLDER", "pipe:FILE", "BAG", "MODULE:CLASS"} <= set(listed)
