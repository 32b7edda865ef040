"""Every column of a dataset obeys its law, and whatever damages it is found and named.

The audit: each column of numbers is made NaN, scaled, negated, shifted, noisy, or wrong in a single
cell or frame. What changes a column by less than its stated tolerance is not asked for.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from chromagrip.dataset import load_sequences
from chromagrip.dataset.check import wrong_values
from chromagrip.dataset.labels import Columns, columns_of
from chromagrip.dataset.labels.chain_physics import lawful_chain
from chromagrip.dataset.labels.dome_physics import lawful_dome
from chromagrip.dataset.labels.laws import Stored, Table, differences, missing
from chromagrip.dataset.labels.reading import read_again
from chromagrip.dataset.make import make
from chromagrip.dataset.recipe import Recipe
from chromagrip.dataset.sequence import simulated

Values = NDArray[Any]

CHAIN: dict[str, Any] = {
    "duration_s": 0.1, "camera": {"rate_hz": 60.0}, "fingertip": {"step_ms": 5.0, "nodes": 101},
    "actuator": {"lag_ms": 10.0},
}  # fmt: skip
DOME: dict[str, Any] = {
    "body": "dome", "duration_s": 0.1, "camera": {"rate_hz": 50.0}, "dome": {"pitch_mm": 0.9},
}  # fmt: skip
PAD = DOME | {"sensor": "flat-2019", "dome": {"pitch_mm": 2.0}}
GRASP: dict[str, Any] = {
    "motion": {"choice": ["slip"]}, "grip_n": {"choice": [2.0]}, "slip_share": {"choice": [1.3]},
    "object.radius_mm": {"choice": [20.0]}, "object.friction": {"choice": [0.4]},
}  # fmt: skip
MOVE: dict[str, Any] = {
    "motion": {"choice": ["move"]}, "pose.press_share": {"choice": [0.3]},
    "pose.shear_mm": {"choice": [0.6]}, "pose.shear_towards_deg": {"choice": [70.0]},
    "pose.twist_deg": {"choice": [15.0]}, "pose.tilt_deg": {"choice": [5.0]},
}  # fmt: skip
BOX = {"shape": "box", "size_mm": [20.0, 20.0, 20.0], "rounding_mm": 0.5,
       "turned_deg": [45.0, 0.0, 0.0]}  # fmt: skip
BALL = {"object.radius_mm": {"choice": [12.0]}}
WORN = {"missing_markers": 0.05, "misplacement_mm": 0.02, "rubbed_markers": 0.1}
LOST = {"rate_hz": 60.0, "exposure_ms": 4.0, "dropped": 0.3, "late": 0.3, "latency_frames": 2}
PATCHES = {"friction_places_mm": [-1.0, 0.0, 1.0], "friction_factors": [1.0, 2.0, 0.5]}

#: Kinds of recipes: scene and draws.
KINDS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "chain": (CHAIN, GRASP),
    "press": (CHAIN, GRASP | {"motion": {"choice": ["press"]}}),
    "worn": (CHAIN | {"camera": LOST, "defects": WORN}, GRASP),
    "patches": (CHAIN | {"object": PATCHES}, GRASP),
    "changes": (
        CHAIN | {"object": {"friction_times_s": [0.05], "frictions": [0.3], "creeps": 0.5}},
        GRASP,
    ),
    "stays": (CHAIN | {"object": {"surface": "stays"}}, GRASP),
    "dome": (DOME, GRASP),
    "move": (DOME, MOVE | BALL),
    "twist": (DOME, MOVE | BALL | {"pose.twist_deg": {"choice": [40.0]}}),
    "edges": (DOME, MOVE | {"object": {"choice": [BOX]}}),
    "viscous": (DOME | {"dome": {"pitch_mm": 0.9, "relaxation_ms": 50.0}}, MOVE | BALL),
    "pad": (PAD, MOVE | BALL),
    "read": (CHAIN, GRASP),
}
#: Of these the audit is quick; every kind is audited by the slow test.
QUICK = ("chain", "dome")


class Case:
    """Labels of a sequence, and what its laws say.

    Parameters
    ----------
    kind: of KINDS
    """

    def __init__(self, kind: str) -> None:
        scene, draw = KINDS[kind]
        reading = "auto" if kind == "read" else ""
        with TemporaryDirectory() as folder:
            recipe = Recipe(sequences=1, scene=scene, draw=draw, reading=reading)
            make(recipe, Path(folder) / "data")
            one = next(iter(load_sequences(Path(folder) / "data")))
            pictures = one.pictures
            self.read: Table = (
                read_again(one.scene, reading, pictures.rest, pictures) if reading else {}
            )
        again = simulated(one.scene, one.values)
        self.stored = Stored(scene=one.scene, frames=one.frames, markers=one.markers, again=again)
        self.driven = one.values["motion"] != "move"
        self.columns: Columns = columns_of(one.scene.body, bool(reading))
        lawful = lawful_chain if one.scene.body == "chain" else lawful_dome
        with np.errstate(all="ignore"):
            self.frames, self.markers = lawful(self.stored)

    def wrong(self) -> list[str]:
        """What is wrong with the labels as they are."""
        return list(wrong_values(self.stored, self.columns, self.driven, self.read))

    def found(self, name: str, values: Values) -> list[str]:
        """What is wrong with other values of a column."""
        stored, columns = self.stored, self.columns
        if name in columns.markers:  # from which no other column follows
            own, table = {name: columns.markers[name]}, {name: values}
            return [*missing(own, table), *differences(own, table, self.markers)]
        of = "frames" if name in columns.frame else "markers"
        spoilt = replace(stored, **{of: {**getattr(stored, of), name: values}})
        return list(wrong_values(spoilt, columns, self.driven, self.read))


@cache
def case(kind: str) -> Case:
    return Case(kind)


def damages(values: Values) -> Iterator[tuple[str, Values]]:
    """The audit's damages of a column, and finer ones."""
    rng = np.random.default_rng(1)
    known = np.flatnonzero(np.isfinite(values))
    spread = float(np.ptp(values.ravel()[known])) if known.size else 0.0
    yield "NaN", np.full_like(values, np.nan)
    yield "1.3", 1.3 * values
    yield "negated", -values
    yield "+ 1", values + 1.0
    yield "noise", values + 0.05 * spread * rng.standard_normal(values.shape)
    yield "shift", values + 0.05 * spread
    yield "1.05", 1.05 * values
    for name, change in (("+", 0.05 * spread), ("NaN", np.nan)):
        cell, frame = values.copy().ravel(), values.copy()
        if known.size:
            cell[rng.choice(known)] += change
        frame[len(frame) // 2] += change
        yield f"cell {name}", cell.reshape(values.shape)
        yield f"frame {name}", frame


def told(values: Values, spoilt: Values, slack: float) -> bool:
    """Whether a damage is one: above the stated tolerance, or another cell is NaN."""
    if (np.isnan(values) != np.isnan(spoilt)).any():
        return True
    return bool(np.nanmax(abs(spoilt - values), initial=0.0) > slack)


def audit(kind: str, most: int) -> tuple[int, list[str]]:
    """Damages that were done to a kind of sequence, and those that were not found and named.

    Parameters
    ----------
    most: damages of each column of frames and nodes
    """
    of, done, lost = case(kind), 0, []
    assert of.wrong() == []
    for name, column in {**of.columns.frame, **of.columns.markers, **of.columns.nodes}.items():
        if name in of.columns.markers:
            values = of.stored.markers[name]
        else:
            values = {**of.stored.markers, **of.stored.frames}[name]
        if values.dtype.kind != "f":
            continue
        slack = column.tolerance + column.share * float(np.nanmax(abs(values), initial=0.0))
        for k, (damage, spoilt) in enumerate(damages(values.astype(float))):
            spoilt = spoilt.astype(values.dtype)
            if (k >= most and name not in of.columns.markers) or not told(values, spoilt, slack):
                continue
            done += 1
            if not any(f"{name}" in wrong for wrong in of.found(name, spoilt)):
                lost.append(f"{name}: {damage}")
    return done, lost


@pytest.mark.parametrize("kind", QUICK)
def test_damage_of_a_column_is_found(kind: str) -> None:
    done, lost = audit(kind, most=4 if kind == "chain" else 2)
    assert done > 100
    assert lost == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_damage_of_every_kind_is_found(kind: str) -> None:
    done, lost = audit(kind, most=100)
    assert done > 200
    assert lost == []


@pytest.mark.parametrize("kind", ["worn", "viscous"])
def test_what_is_not_damaged_obeys_its_laws(kind: str) -> None:
    assert case(kind).wrong() == []


@pytest.mark.parametrize("kind", QUICK)
def test_every_column_has_a_law(kind: str) -> None:
    of = case(kind)
    assert {*of.columns.frame} == {*of.frames} == {*of.stored.frames}
    both = of.columns.markers | of.columns.nodes
    assert {*both} == {*of.markers} == {*of.stored.markers}
    for name, column in {**of.columns.frame, **both}.items():
        assert column.meaning, name
        assert column.law, name
        values = of.stored.frames.get(name, of.stored.markers.get(name))
        assert values is not None
        if values.dtype.kind == "f":
            assert column.tolerance > 0.0, name


@pytest.mark.parametrize("kind", QUICK)
def test_words_flags_and_counts_are_seen_too(kind: str) -> None:
    of = case(kind)
    for name, values in {**of.stored.frames, **of.stored.markers}.items():
        spoilt = values.copy()
        if values.dtype.kind == "b":
            spoilt[-1] = ~values[-1]
        elif values.dtype.kind in "iu":
            spoilt[-1] += 1
        elif values.dtype.kind == "O":
            spoilt[-1] = "none" if values[-1] != "none" else "stick"
        else:
            continue
        assert any(name in wrong for wrong in of.found(name, spoilt)), name
