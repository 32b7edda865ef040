from importlib.metadata import EntryPoint

import pytest

from chromagrip.errors import UserError
from chromagrip.render import load_sensor
from chromagrip.tracking import MarkerTracker, Palette, load_tracker, tracker_names
from chromagrip.tracking.baselines.centroid import WeightedCentroid
from chromagrip.tracking.fit.settings import FitSettings


def test_ours_are_found_by_name() -> None:
    assert load_tracker("fit") is MarkerTracker
    palette = Palette.of_sensor(load_sensor("thesis"))
    for name in tracker_names():
        tracker = load_tracker(name)(palette, 2.0)
        assert callable(tracker.reset)
        assert callable(tracker.update)


def test_arguments_are_handed_to_the_class() -> None:
    coarse = load_tracker("fit", {"settings": FitSettings(rows=3)})
    tracker = coarse(Palette.of_sensor(load_sensor("thesis")), 2.0)
    assert isinstance(tracker, MarkerTracker)
    assert tracker.settings == FitSettings(rows=3)


TARGET = "chromagrip.tracking.baselines.centroid:WeightedCentroid"


def test_anybodys_by_module_and_class() -> None:
    assert load_tracker(TARGET) is WeightedCentroid


def test_installed_ones_by_their_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    def installed(group: str) -> list[EntryPoint]:
        assert group == "chromagrip.trackers"
        return [EntryPoint("mine", TARGET, group)]

    monkeypatch.setattr("chromagrip.by_name.entry_points", installed)
    assert load_tracker("mine") is WeightedCentroid
    assert "mine" in tracker_names()
    with pytest.raises(UserError, match="mine, fit"):
        load_tracker("yours")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("best", "no tracker 'best'; there is .*fit.* or give module:Class"),
        ("nowhere:Tracker", "there is no module nowhere in the working folder"),
        ("json:Tracker", "module json has no Tracker"),
        ("json:JSONDecoder", "has no reset"),
    ],
)
def test_what_is_no_tracker_is_refused(name: str, words: str) -> None:
    with pytest.raises(UserError, match=words):
        load_tracker(name)
