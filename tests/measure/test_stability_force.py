"""The map of the reconstructors on domes: outcomes, scenes, and what its folder holds."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from chromagrip.measure.domes.readings import Reading
from chromagrip.measure.stability import force
from chromagrip.measure.stability.force import (
    DIALS,
    Case,
    Cell,
    Setting,
    case_of,
    cell,
    report,
    settings,
    text_of,
)
from chromagrip.measure.stability.parts import stability_force
from chromagrip.measure.worlds.force_scores import Answers

#: (ΣFn, ΣFf, µ, Γ) of two frames.
TRUE = np.array([[2.0, 0.4, 0.5, 0.6], [2.0, 0.9, 0.5, 0.1]])
SETTING = Setting("thesis", "contact", "noise", "4")


def said(
    normal: Sequence[float], margin: Sequence[float], half: float, flagged: Sequence[bool]
) -> Reading:
    """Reading that is off in ΣFn [N] and Γ by so much, with intervals of that half-width."""
    value = TRUE + np.stack([normal, np.zeros(2), np.zeros(2), margin], axis=1)
    answers = Answers(
        value=value,
        interval=np.stack([value - half, value + half], axis=-1),
        flagged=np.array(flagged),
    )
    return Reading(
        answers=answers, side=np.zeros((2, 2)), spent=np.ones(1), late=np.zeros(1, dtype=np.bool_)
    )


@pytest.mark.parametrize(
    ("reading", "outcome", "percent"),
    [
        (said([0.19, 0.0], [0.0, 0.09], 0.0, [False, False]), "accurate", 9.5),
        (said([0.3, 0.0], [0.0, 0.0], 0.16, [False, False]), "off, inside twice its interval", 15),
        (said([0.3, 0.0], [0.0, 0.0], 0.14, [False, False]), "wrong, narrow and unflagged", 15),
        (said([0.0, 0.0], [0.0, 0.3], 0.14, [False, False]), "wrong, narrow and unflagged", 0),
        (said([9.0, 0.1], [9.0, 0.0], 0.0, [True, False]), "frames flagged", 5),
        (said([9.0, 0.4], [9.0, 0.0], 0.0, [True, False]), "wrong, narrow and unflagged", 20),
        (said([9.0, 9.0], [9.0, 9.0], 0.0, [True, True]), "frames flagged", math.nan),
    ],
)
def test_the_worst_outcome_counts(reading: Reading, outcome: str, percent: float) -> None:
    found = cell(SETTING, reading, TRUE)
    assert found.outcome == outcome
    assert found.normal_percent == pytest.approx(percent, nan_ok=True)
    assert (found.setting, found.frames) == (SETTING, 2)
    assert found.flagged == reading.answers.flagged.sum()


def test_a_dial_turns_one_condition() -> None:
    for name, dial in DIALS.items():
        for value in dial.values:
            changed = vars(case_of(name, text_of(value)))
            base = vars(dial.base)
            assert changed[name] == value
            assert {key for key in base if base[key] != changed[key]} <= {name}
        # The usual value is among them, so that panels can be compared.
        assert vars(dial.base)[name] in dial.values
    assert case_of("ball", "flat").ball == math.inf
    assert len(set(settings(False))) == len(settings(False)) == 5 * 42
    assert set(settings(True)) <= set(settings(False))


@pytest.mark.slow
def test_a_scene_is_as_its_case_says() -> None:
    """Grip, µ and Γ are in the truth; silicone that is stiffer than told is read too soft."""
    plain = force._watched("dome-2022", Case(grip=0.5, friction=0.3))
    np.testing.assert_allclose(plain.true[:, 0], 1.5, rtol=0.03)
    np.testing.assert_allclose(plain.true[:, 2], 0.3)
    np.testing.assert_allclose(plain.true[:, 3], [1.0, 0.6, 0.3, 0.1], atol=0.05)
    along, across, _ = plain.side[-1]
    assert math.degrees(math.atan2(across, along)) == pytest.approx(30.0, abs=0.05)
    stiffer = force._watched("dome-2022", Case(young=1.3))
    assert stiffer.known == force._watched("dome-2022", Case()).known
    read = force.read("contact", stiffer)
    np.testing.assert_allclose(
        read.answers.value[:, 0], stiffer.true[:, 0] / 1.3, rtol=0.06
    )  # of the same shape, in linear silicone under a hard object
    found = cell(Setting("dome-2022", "contact", "young", "1.3"), read, stiffer.true)
    assert 15.0 < found.normal_percent < 30.0


def test_a_map_goes_on_and_is_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[tuple[str, str]] = []

    def scene(group: list[Setting]) -> list[Cell]:
        if len(made) == 2 and not (tmp_path / "stopped").exists():
            (tmp_path / "stopped").touch()
            raise KeyboardInterrupt
        made.append((group[0].dial, group[0].value))
        outcomes = ["wrong, narrow and unflagged", "frames flagged", "accurate", "accurate"]
        return [
            Cell(*one, outcome, 20.0, 0.3, 0, 4, "")
            for one, outcome in zip(group, outcomes, strict=True)
        ]

    monkeypatch.setattr(force, "_cells_of_scene", scene)
    out = tmp_path / "map"
    with pytest.raises(KeyboardInterrupt):
        stability_force(True, out, False, lambda _: None, 1)
    told = stability_force(True, out, False, lambda _: None, 1)
    assert made == [("noise", "8"), ("shape", "ball"), ("shape", "edge")]
    assert {path.name for path in out.iterdir()} == {"map.png", "map.csv"}
    with (out / "map.csv").open(encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) == 12
    counts = {row.subject[2]: row.value for row in told.rows if row.score == "accurate"}
    assert counts == {"sequential": 0, "gp": 0, "contact": 3, "traction": 3}


def test_what_reads_domes_and_is_wrong_is_named() -> None:
    bad = Cell(*SETTING, "wrong, narrow and unflagged", 31.0, 0.4, 0, 4, "")
    gone = Cell("thesis", "gp", "grip", "3", "not held", math.nan, math.nan, 0, 0, "it gave up")
    assert report([bad, gone], False).notes == (
        "contact on thesis is wrong, narrow and unflagged at noise 4: ΣFn 31 % off, Γ 0.40",
        "thesis, grip 3: it gave up",
    )


def test_an_object_that_slides_off_is_not_held() -> None:
    wanted = [one for one in settings(False) if one[0] == "thesis" and one[2:] == ("ball", "0.12")]
    found = list(force.cells(wanted, 1, lambda _: None))
    assert [one.setting for one in found] == wanted
    assert {(one.outcome, one.note) for one in found} == {("not held", "the object slides off")}
