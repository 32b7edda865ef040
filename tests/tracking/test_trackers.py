from importlib.metadata import EntryPoint

import pytest

from chromagrip.errors import UserError
from chromagrip.tracking import load_tracker, tracker_names
from chromagrip.tracking.baselines.centroid import WeightedCentroid
from chromagrip.tracking.fit.tracker import MarkerTracker


def test_ours_are_found_by_name() -> None:
    assert load_tracker("fit") is MarkerTracker
    for name in tracker_names():
        kind = load_tracker(name)
        assert callable(kind.reset)  # type: ignore[attr-defined]
        assert callable(kind.update)  # type: ignore[attr-defined]


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
        ("nowhere:Tracker", "cannot be imported: ModuleNotFoundError"),
        ("json:Tracker", "cannot be imported: AttributeError"),
        ("json:JSONDecoder", "has no reset"),
    ],
)
def test_what_is_no_tracker_is_refused(name: str, words: str) -> None:
    with pytest.raises(UserError, match=words):
        load_tracker(name)
