"""Fidelities: what is chosen for a scene, and what is refused."""

import dataclasses
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from chromagrip import UserError, load_scene
from chromagrip.loop.fidelity import TABLE, Fidelity, Measured, choose, expected, read
from chromagrip.output.cells import write_cells

FINE = Fidelity()
CHEAP = Fidelity(tracker="quick", step_ms=5.0)


def measured(
    fidelity: Fidelity, milliseconds: float, seen: float, curvature: float = 0.0, **more: Any
) -> Measured:
    """Measurement of a fidelity on an object that is flat or round."""
    told = {"scene_body": "chain", "rate_hz": 60.0, "noise": 2.0, "friction": 0.5, "plant": 0.0}
    told |= {"stiffness_kpa": 200.0, "curvature": curvature, "milliseconds": milliseconds}
    return Measured(**dataclasses.asdict(fidelity) | told | {"seen": seen} | more)


#: The cheap one is good on flat objects only.
TOLD = [
    *(measured(FINE, 10.0, 0.02, c) for c in (0.0, 0.0, 0.0, 200.0, 200.0, 200.0)),
    *(measured(CHEAP, 4.0, 0.03) for _ in range(3)),
    *(measured(CHEAP, 4.0, 0.09, 200.0) for _ in range(3)),
]
SHARP = {"object.radius_mm": 5.0}


def test_the_cheapest_that_keeps_the_tolerance_is_chosen_for_the_object_at_hand() -> None:
    flat, sharp = load_scene("margin-60hz"), load_scene("margin-60hz", SHARP)
    assert choose(0.05, flat, TOLD).fidelity == CHEAP
    assert choose(0.05, sharp, TOLD).fidelity == FINE
    assert choose(0.2, sharp, TOLD).fidelity == CHEAP
    choice = choose(0.05, sharp, TOLD)
    assert choice.milliseconds == 10.0
    assert choice.error == pytest.approx(1.25 * 0.02)
    assert len(choice.lines) == 2
    assert choice.lines[0].startswith("fit, way")
    assert "not quick" in choice.lines[1]
    assert load_scene("margin-60hz", choice.fidelity.changes).tracker == "fit"


@given(st.floats(0.03, 0.3), st.floats(0.03, 0.3))
def test_a_wider_tolerance_never_costs_more(one: float, other: float) -> None:
    scene = load_scene("margin-60hz", SHARP)
    narrow, wide = (choose(t, scene, TOLD) for t in sorted((one, other)))
    assert wide.milliseconds <= narrow.milliseconds
    assert narrow.error <= min(one, other)


def test_what_cannot_be_planned_is_refused() -> None:
    for tolerance, changes, words in (
        (0.001, {}, r"no fidelity is known to keep Γ within 0\.001"),
        (0.0, {}, "more than 0 and at most 1"),
        (0.1, {"sensor": "fovea"}, "sensor fovea was not measured"),
        (0.1, {"path": "truth"}, "no fidelity was measured on the truth path"),
    ):
        with pytest.raises(UserError, match=words):
            choose(tolerance, load_scene("margin-60hz", changes), TOLD)


def test_a_table_comes_back_as_it_was_written(tmp_path: Path) -> None:
    write_cells(TOLD, tmp_path / "table.csv")
    assert read(tmp_path / "table.csv") == TOLD
    with pytest.raises(UserError, match="is missing or empty"):
        read(tmp_path / "none.csv")


def test_the_shipped_table_plans_every_shipped_grasp_of_the_thesis_sensor() -> None:
    for name in ("thesis", "camera-100hz", "margin-60hz", "margin-30hz"):
        for path in ("camera", "truth"):
            choice = Fidelity.auto(0.25, load_scene(name, {"path": path}))
            assert choice.error <= 0.25
            assert choice.fidelity.step_ms <= 1e3 * load_scene(name).period
    assert len({m.fidelity for m in read(TABLE)}) >= 10


#: A dome that is as good as a chain and takes longer.
DOMES = [
    measured(Fidelity(tracker="", reconstructor="", **of), spent, 0.0, plant=e, scene_body="dome")
    for of, spent, e in (
        ({"step_ms": 5.0, "nodes": 101}, 1.0, 0.02),
        ({"nodes": 0, "body": "dome", "pitch_mm": 0.8}, 9.0, 0.01),
        ({"nodes": 0, "body": "dome", "pitch_mm": 0.4}, 30.0, 0.001),
    )
    for _ in range(3)
]


def test_a_chain_stands_in_for_a_dome_where_the_scene_is_plane() -> None:
    dome = {"path": "truth", "body": "dome"}
    flat = choose(0.05, load_scene("margin-60hz", dome), DOMES)
    assert flat.changes == {"body": "chain", "fingertip.step_ms": 5.0, "fingertip.nodes": 101}
    assert load_scene("margin-60hz", dome | flat.changes).body == "chain"
    finer = choose(0.005, load_scene("margin-60hz", dome), DOMES)
    assert finer.changes["dome.pitch_mm"] == 0.4
    assert "a dome with nodes every 0.4 mm" in finer.lines[0]
    for more in ({"load.twists_nmm": [0.0, 0.5]}, {"object.beside_mm": [1.0, 0.0]}):
        chosen = choose(0.05, load_scene("margin-60hz", dome | more), DOMES)
        assert chosen.fidelity.pitch_mm == 0.8
    box = {"object.shape": "box", "object.size_mm": [10.0, 10.0, 10.0]}
    with pytest.raises(UserError, match=r"object.shape = box was not measured"):
        choose(0.05, load_scene("margin-60hz", dome | box), DOMES)


def test_built_domes_and_pinches_are_planned_for_and_others_are_named() -> None:
    for name in ("chromatouch-2020", "chromatouch-2022", "pinch-lift"):
        scene = load_scene(name)
        choices = expected(scene, read(TABLE))
        assert {one.fidelity.reconstructor for one in choices} == {"contact"}
        assert [one.milliseconds for one in choices] == sorted(one.milliseconds for one in choices)
        assert load_scene(name, choices[0].changes(scene)).body == "dome"
        assert expected(load_scene(name, {"path": "truth"}), read(TABLE))
    with pytest.raises(UserError, match="planned for thesis, dome-2020, dome-2022"):
        expected(load_scene("chromatouch-2022", {"sensor": "chromatouch-next"}), read(TABLE))
