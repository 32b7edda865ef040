"""Pictures of the maps: what every colour, letter and line in them is, their legend says."""

from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from benchmarks.model import chain_map as model
from benchmarks.model import dome_map as dome
from chromagrip.measure.stability import cells, figures, force, track
from chromagrip.measure.stability.grips import cells as grips
from chromagrip.measure.stability.maps import Map, maps

Draw = Callable[[Any, Path, bool], None]


def drawn(
    home: ModuleType, draw: Draw, results: Sequence[Any], monkeypatch: pytest.MonkeyPatch
) -> Figure:
    """Figure that a function of a module would write."""
    shown: list[Figure] = []

    def kept(figure: Figure) -> bytes:
        figure.draw_without_rendering()
        shown.append(figure)
        return b""

    monkeypatch.setattr(home, "png", kept)
    monkeypatch.setattr(Path, "write_bytes", lambda *_: 0)
    draw(results, Path("map.png"), False)
    return shown[0]


def model_cells() -> list[model.ChainCell]:
    """Every outcome, of methods of all kinds."""
    kinds = (("implicit", (1e-3, 2e-3)), ("euler", (9e-6, 2e-5)), ("bdf", (1e-3,)))
    return [
        model.ChainCell(method, 21, 10.0**k, step, outcome, 0.0, 0.0, 1e-5, "")
        for method, steps in kinds
        for k, outcome in enumerate(model.OUTCOMES)
        for step in steps
    ]


def dome_cells() -> list[dome.DomeCell]:
    """Every outcome, some with halved steps."""
    return [
        dome.DomeCell("ball", 0.7, 1e7, 1e-5 * (k + 1), outcome, 0.0, 0.1 * (k == 1), 0, 1.0, "")
        for k, outcome in enumerate(dome.OUTCOMES)
    ]


def force_cells() -> list[force.ForceCell]:
    """Every outcome."""
    return [
        force.ForceCell("thesis", "sequential", "noise", str(k), outcome, 3.0, 0.0, 0, 4, "")
        for k, outcome in enumerate(force.OUTCOMES)
    ]


@pytest.mark.parametrize("kind", [cells, grips, model, dome, force])
def test_every_outcome_has_a_colour_and_a_letter_of_its_own(kind: ModuleType) -> None:
    """The best one has no letter."""
    colours, letters, _ = zip(*kind.OUTCOMES.values(), strict=True)
    assert len(set(letters)) == len(set(colours)) == len(letters)
    assert [bool(letter) for letter in letters] == [False] + [True] * (len(letters) - 1)


@pytest.mark.parametrize(
    ("kind", "draw", "made"),
    [
        (model, model.draw_model, model_cells),
        (dome, dome.draw_dome, dome_cells),
        (force, force.draw_force, force_cells),
    ],
)
def test_the_legend_explains_every_outcome(
    kind: ModuleType,
    draw: Draw,
    made: Callable[[], list[Any]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    figure = drawn(kind, draw, made(), monkeypatch)
    (legend,) = figure.legends
    told = {
        to_hex(patch.get_facecolor()): text.get_text()
        for patch, text in zip(legend.legend_handles, legend.get_texts(), strict=True)
        if hasattr(patch, "get_facecolor")
    }
    assert set(told) == {outcome.colour for outcome in kind.OUTCOMES.values()}
    letters = {outcome.letter for outcome in kind.OUTCOMES.values() if outcome.letter}
    for name, (colour, letter, _) in kind.OUTCOMES.items():
        assert told[colour].startswith(f"{letter}  {name}" if letter else name)
    written = {text.get_text().split(" ")[0] for axes in figure.axes for text in axes.texts}
    assert letters <= written


def test_a_map_of_the_loop_tells_outcomes_by_letters(tmp_path: Path) -> None:
    """Also those through the camera, in a ring; a line of the analysis stays inside the cells."""
    which: Map = maps(True)["rate-latency"]
    names = list(cells.OUTCOMES)
    results = {}
    for k, one in enumerate(which.settings()):
        name = names[k % len(names)]
        swing = float(name != "holds")
        results[one] = cells.LoopCell(**vars(one), outcome=name, swing=swing, root=2.0)
    _, places = figures.new_map(which, True, 0.4, 0.9, 1.5)
    for axes, panel in zip(places, which.panels, strict=True):
        figures.draw_field(axes, which, panel, results, cells.OUTCOMES)
        figures._mark(axes, which, figures.CHAIN, panel, results)
        figures.draw_lines(axes, which, panel, figures._STYLES)
        assert axes.get_xlim() == (-0.5, len(panel.x) - 0.5)
    texts = [text.get_text() for axes in places for text in axes.texts]
    wanted = [results[one] for one in which.settings()]
    letters = [cells.OUTCOMES[cell.outcome].letter for cell in wanted]
    assert len(texts) == sum(map(bool, letters)) + sum(
        not cells.OUTCOMES[results[one].outcome].letter for one in which.camera
    )
    assert {"m~", "~", "s~", "c~", "–~"} <= set(texts)
    figures.draw_map(which, figures.CHAIN, results, tmp_path, "map", True)
    assert {path.name for path in tmp_path.iterdir()} == {"map.svg", "map.png"}


def test_curves_of_trackers_differ_by_more_than_colour(monkeypatch: pytest.MonkeyPatch) -> None:
    results = [
        track.TrackCell(f"tracker {k}", "noise", value, 4, 90.0 - k, 0.1 * (k + 1), 0, "")
        for k in range(10)
        for value in (1.0, 2.0)
    ]
    figure = drawn(track, track.draw_track, results, monkeypatch)
    (legend,) = figure.legends
    looks = {(line.get_marker(), line.get_linestyle()) for line in legend.get_lines()}
    assert len(looks) == len(legend.get_texts()) == 11
