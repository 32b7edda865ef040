"""Breakdown curves of trackers: where identity is lost, refusals, and interrupted maps."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from chromagrip.by_name import Choice
from chromagrip.errors import UserError
from chromagrip.measure.stability.track import TrackCell, TrackCondition, cells, report
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


def curve(tracker: Choice, dial: str, values: tuple[float, ...], frames: int) -> list[TrackCell]:
    return [
        cell
        for value in values
        for cell in cells(TrackCondition(dial, value, frames, {"tracker": tracker}))
    ]


def test_identity_is_lost_where_half_a_pitch_is_passed() -> None:
    """By who takes the nearest marker for its own; the default holds on far beyond.

    The smallest distance in this layout is three quarters of its pitch, so no swap can come before
    0.37 pitches, and along that row one has to have come at 0.6.
    """
    result = report(curve(Nearest, "shift", (0.35, 0.6), 2))
    rows = {row.name: row.value for row in result.rows}
    assert rows["tracker/shift/identity_lost_at"] == 0.6
    assert rows["tracker/shift/holds_up_to"] is not None
    sentence = "tracker takes one marker for another from a shift of 0.6 pitches on"
    assert result.notes[1:] == (sentence,)
    result = report(curve("fit", "shift", (1.2,), 2))
    (row,) = (row for row in result.rows if row.score == "identity_lost_at")
    assert (row.value, row.note, row.met) == (None, "never, up to 1.2", None)
    assert result.notes[1:] == ()


def test_where_a_tracker_holds_is_said_in_words() -> None:
    def cell(value: float, right: float) -> TrackCell:
        return TrackCell("mine", "noise", value, 4, right, 0.1, 0, "")

    for curve, value, note in (
        ([cell(1.0, 99.0), cell(2.0, 96.0), cell(4.0, 80.0)], 2.0, "fails at 4"),
        ([cell(1.0, 99.0), cell(2.0, 96.0)], 2.0, "holds at all values"),
        (
            [cell(1.0, 77.0), cell(2.0, 99.0)],
            None,
            "fails already at the easiest setting (1): 77 % right, 95 % needed",
        ),
    ):
        (row,) = report(curve).rows
        assert (row.name, row.value, row.note) == ("mine/noise/holds_up_to", value, note)


def test_refused_frames_do_not_stop_the_others() -> None:
    trackers: dict[str, Choice] = {"refusing": Refusing, "constant": "constant"}
    found = cells(TrackCondition("noise", 2.0, 1, trackers))
    assert [cell.right_percent > 0.0 for cell in found] == [False, True]
    assert "does not like" in found[0].note
    json.dumps(report(found).as_json(), allow_nan=False)


def test_a_bug_of_a_tracker_is_not_taken_for_a_refusal() -> None:
    with pytest.raises(IndexError, match="a bug"):
        curve(Broken, "noise", (2.0,), 1)
