"""Breakdown curves of trackers: where identity is lost, refusals, and interrupted maps."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from chromagrip.by_name import Choice
from chromagrip.errors import UserError
from chromagrip.measure.stability import track
from chromagrip.measure.stability.parts import stability_track
from chromagrip.measure.stability.track import Cell, Setting, cells, report
from chromagrip.measure.worlds.track_scores import Constant
from chromagrip.render import Frame
from chromagrip.tracking import Tracks, detect_markers


class Nearest(Constant):
    """Takes the marker that is nearest to the place at rest."""

    def update(self, frame: Frame) -> Tracks:
        rest = self._tracks
        position = np.full_like(rest.position, np.nan)
        for layer, detected in enumerate(detect_markers(frame.image, self._palette)):
            there = rest.visible[layer]
            nearest = KDTree(detected.position).query(rest.position[layer, there])[1]
            position[layer, there] = detected.position[nearest]
        return replace(rest, position=position)


class Refusing(Constant):
    """Refuses every frame."""

    def update(self, frame: Frame) -> Tracks:
        raise UserError("this tracker does not like the frame")


class Broken(Constant):
    """Has a bug."""

    def update(self, frame: Frame) -> Tracks:
        raise IndexError("a bug")


def curve(tracker: Choice, dial: str, values: tuple[float, ...], frames: int) -> list[Cell]:
    settings = [Setting("tracker", dial, value, frames) for value in values]
    return list(cells(settings, {"tracker": tracker}, lambda _: None))


def test_identity_is_lost_where_half_a_pitch_is_passed() -> None:
    """By who takes the nearest marker for its own; the default holds on far beyond.

    The smallest distance in this layout is three quarters of its pitch, so no swap can come before
    0.37 pitches, and along that row one has to have come at 0.6.
    """
    result = report(curve(Nearest, "shift", (0.35, 0.6), 2), False)
    rows = {row.name: row.value for row in result.rows}
    assert rows["tracker/shift/identity_lost_at"] == 0.6
    assert rows["tracker/shift/breaks_at"] is not None
    sentence = "tracker takes one marker for another from a shift of 0.6 pitches on"
    assert result.notes == (sentence,)
    result = report(curve("fit", "shift", (1.2,), 2), False)
    (row,) = (row for row in result.rows if row.score == "identity_lost_at")
    assert (row.value, row.note, row.met) == (None, "never, up to 1.2", None)
    assert result.notes == ()


def test_an_interrupted_map_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(track, "QUICK_VALUES", {"noise": (1.0, 4.0)})
    monkeypatch.setattr(track, "QUICK_FRAMES", 1)
    told: list[str] = []

    def stop_at_the_second(text: str) -> None:
        if "noise 4" in text:
            raise KeyboardInterrupt

    out, names = tmp_path / "map", ("constant",)
    with pytest.raises(KeyboardInterrupt):
        stability_track(True, out, False, stop_at_the_second, names)
    assert [path.name for path in out.iterdir()] == ["map.unfinished.csv"]
    result = stability_track(True, out, False, told.append, names)
    assert told == ["noise 4: constant"]
    assert sorted(path.name for path in out.iterdir()) == ["map.csv", "map.png"]
    with (out / "map.csv").open() as file:
        assert [float(row["value"]) for row in csv.DictReader(file)] == [1.0, 4.0]
    json.dumps(result.as_json(), allow_nan=False)
    assert [row.name for row in result.rows] == ["constant/noise/breaks_at"]


def test_refused_frames_do_not_stop_the_others() -> None:
    settings = [Setting(name, "noise", 2.0, 1) for name in ("refusing", "constant")]
    trackers: dict[str, Choice] = {"refusing": Refusing, "constant": "constant"}
    found = list(cells(settings, trackers, lambda _: None))
    assert [cell.right_percent > 0.0 for cell in found] == [False, True]
    assert "does not like" in found[0].note
    json.dumps(report(found, False).as_json(), allow_nan=False)


def test_a_bug_of_a_tracker_is_not_taken_for_a_refusal() -> None:
    with pytest.raises(IndexError, match="a bug"):
        curve(Broken, "noise", (2.0,), 1)
