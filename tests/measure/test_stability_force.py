"""The map of the reconstructors on domes: outcomes, scenes, and what its folder holds."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from chromagrip.measure.engine import measure
from chromagrip.measure.stability import force
from chromagrip.measure.stability.force import (
    DIALS,
    ForceCell,
    ForceCondition,
    GripCase,
    case_of,
    force_map,
    judged,
    report,
    text_of,
)
from chromagrip.measure.study import ALL, Asked
from chromagrip.measure.worlds.dome.readings import Reading
from chromagrip.measure.worlds.force_scores import Answers
from chromagrip.model import ForceField
from chromagrip.tracking import Tracks

#: (ΣFn, ΣFf, µ, Γ) of two frames.
TRUE = np.array([[2.0, 0.4, 0.5, 0.6], [2.0, 0.9, 0.5, 0.1]])


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
        answers=answers,
        side=np.zeros((2, 2)),
        spent=np.ones(1),
        each=np.ones(1),
        late=np.zeros(1, dtype=np.bool_),
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
    found, normal, _, flagged, frames = judged(reading, TRUE)
    assert found == outcome
    assert normal == pytest.approx(percent, nan_ok=True)
    assert (flagged, frames) == (reading.answers.flagged.sum(), 2)


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
    whole = force_map(ALL).settings
    assert sum(len(one.methods) for one in whole) == 3 * 42
    assert all(one in whole for one in force_map(Asked(quick=True)).settings)


@pytest.mark.studies
def test_a_scene_is_as_its_case_says() -> None:
    """Grip, µ and Γ are in the truth; silicone that is stiffer than told is read too soft."""
    plain = force._watched("dome-2022", GripCase(grip=0.5, friction=0.3))
    np.testing.assert_allclose(plain.true[:, 0], 1.5, rtol=0.03)
    np.testing.assert_allclose(plain.true[:, 2], 0.3)
    np.testing.assert_allclose(plain.true[:, 3], [1.0, 0.6, 0.3, 0.1], atol=0.05)
    along, across, _ = plain.side[-1]
    assert math.degrees(math.atan2(across, along)) == pytest.approx(30.0, abs=0.05)
    stiffer = force._watched("dome-2022", GripCase(young=1.3))
    assert stiffer.known == force._watched("dome-2022", GripCase()).known
    read = force.read("contact", stiffer)
    np.testing.assert_allclose(
        read.answers.value[:, 0], stiffer.true[:, 0] / 1.3, rtol=0.06
    )  # of the same shape, in linear silicone under a hard object
    _, percent, *_ = judged(read, stiffer.true)
    assert 15.0 < percent < 30.0


def test_a_map_is_drawn_with_ones_own_beside_ours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def made(setting: ForceCondition) -> list[ForceCell]:
        outcomes = ["wrong, narrow and unflagged", *["accurate"] * 2]
        return [
            ForceCell(
                setting.design, name, setting.dial, setting.value, outcome, 20.0, 0.3, 0, 4, ""
            )
            for name, outcome in zip(setting.methods, outcomes, strict=True)
        ]

    class Own:
        """Reads nothing."""

        def reset(self) -> None: ...

        def update(self, tracks: Tracks) -> ForceField:
            raise AssertionError

    monkeypatch.setattr(force, "cells", made)
    out = tmp_path / "map"
    report = measure("stability", "force", Asked(quick=True, methods=(Own,)), out=out, workers=1)
    names = {"map.png", "map.csv", "results.json", "index.html"}
    assert {path.name for path in out.iterdir()} == names
    with (out / "map.csv").open(encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) == 9
    counts = {row.subject[2]: row.value for row in report.rows if row.score == "accurate"}
    assert counts == {"sequential": 0, "contact": 3, "Own": 3}


def test_what_reads_domes_and_is_wrong_is_named() -> None:
    bad = ForceCell(
        "thesis", "contact", "noise", "4", "wrong, narrow and unflagged", 31.0, 0.4, 0, 4, ""
    )
    gone = ForceCell(
        "thesis", "sequential", "grip", "3", "not held", math.nan, math.nan, 0, 0, "it gave up"
    )
    assert report([bad, gone]).notes == (
        "contact on thesis is wrong, narrow and unflagged at noise 4: ΣFn 31 % off, Γ 0.40",
        "thesis, grip 3: it gave up",
    )


def test_an_object_that_slides_off_is_not_held() -> None:
    found = force.cells(
        ForceCondition("thesis", "ball", "0.12", {"sequential": "sequential", "contact": "contact"})
    )
    assert [one.method for one in found] == ["sequential", "contact"]
    assert {(one.outcome, one.note) for one in found} == {("not held", "the object slides off")}
