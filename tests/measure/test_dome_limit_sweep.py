"""The command `limit --body dome`: designs with one thing changed, what they need, what is said."""

import csv
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from msgspec import structs

from chromagrip.cli.limit import limit
from chromagrip.errors import UserError
from chromagrip.measure.limits.dials import DIALS
from chromagrip.measure.limits.dome.held import Grip
from chromagrip.measure.limits.dome.report import NOISES, DomeLimit
from chromagrip.measure.limits.sweep import Point, needed, sweep
from chromagrip.render import Defects, SensorDesign, load_sensor
from chromagrip.render.design import Spiral

GRIP = Grip(normal=3.0, load=1.05, shears=1)
#: A dome of few markers on a coarse skin.
CHANGES = (
    ("core_mm = 15.6", "core_mm = 15.6\npitch_mm = 1.6"),
    ("count = 108", "count = 60"),
    ("coverage_deg = 61.5", "coverage_deg = 50.0"),
)


def small_text() -> str:
    folder = Path(__file__).parents[2] / "render" / "designs"
    text = (folder / "dome-2020.toml").read_text(encoding="utf-8")
    for old, new in CHANGES:
        assert old in text
        text = text.replace(old, new)
    return text.partition("# Of one specimen")[0]


@pytest.fixture
def own(tmp_path: Path) -> str:
    path = tmp_path / "own.toml"
    path.write_text(small_text(), encoding="utf-8")
    return str(path)


def small() -> SensorDesign:
    sensor = load_sensor("dome-2020")
    assert sensor.silicone is not None
    return structs.replace(
        sensor,
        silicone=structs.replace(sensor.silicone, pitch_mm=1.6),
        layout=Spiral(count=60, coverage_deg=50.0),
        defects=Defects(),
    )


def tried(monkeypatch: pytest.MonkeyPatch, **values: tuple[float, ...]) -> None:
    """Try fewer values."""
    for name, dial in DIALS.items():
        monkeypatch.setitem(DIALS, name, replace(dial, tried=values.get(name, ())))


# ---- sweeps ----


def test_each_dial_changes_what_it_says_and_nothing_else() -> None:
    sensor = small()
    for name, dial in DIALS.items():
        if dial.value is None:
            continue
        before = dial.value(sensor)
        wanted = {"outer": 0.2, "inner": 0.8, "camera": 0.3}.get(name, 0.5 * before)
        share = wanted / before if dial.multiples else wanted
        changed = dial.change(sensor, share)
        assert dial.value(changed) == pytest.approx(wanted, rel=0.02)
        for other, each in DIALS.items():
            if other != name and each.value is not None:
                assert each.value(changed) == pytest.approx(each.value(sensor))


def test_a_camera_that_is_moved_keeps_its_picture_filled() -> None:
    sensor = small()
    reach = []
    for place in (-0.4, 0.0, 0.6):
        moved = DIALS["camera"].change(sensor, place)
        pixels = np.concatenate(
            [moved.view.project(moved.shape.points(moved.places, d)) for d in moved.depths]
        )
        reach.append(np.linalg.norm(pixels - 143.5, axis=1).max())
    np.testing.assert_allclose(reach, reach[1], rtol=1e-6)


def test_limits_fall_with_pixels_and_markers_and_rise_with_noise(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried(monkeypatch, height=(0.7, 1.4), markers=(0.7, 1.4), noise=(0.5, 2.0), inner=(0.6, 0.2))
    points = sweep(DomeLimit(design=small(), levels=2.0, grip=GRIP))
    found = {name: [p for p in points if p.dial == name] for name in DIALS}
    for name, sign in (("height", -1.0), ("markers", -1.0), ("noise", 1.0)):
        told = np.array([list(p.errors.values()) for p in found[name]])
        assert (sign * np.diff(told, axis=0) > 0.0).all(), name
    own = [p for p in points if p.own]
    assert len(own) == len(DIALS)
    assert len({tuple(p.errors.values()) for p in own}) == 1
    # A layer that moves tells more of forces than one on the core, and lies below the other.
    inner = found["inner"]
    assert inner[-1].own
    assert inner[1].error("normal_error_n") < inner[-1].error("normal_error_n")
    assert math.isnan(inner[0].error())
    assert "below the outer one" in inner[0].note


def test_what_is_needed_is_nearest_to_the_design() -> None:
    def points(*told: tuple[float, float], own: float) -> list[Point]:
        return [
            Point(dial="inner", value=value, own=value == own, errors={"margin_error": margin})
            for value, margin in told
        ]

    valley = points((0.2, 0.01), (0.4, 0.02), (0.6, 0.04), (0.8, 0.08), (1.0, 0.02), own=0.6)
    assert needed(valley, 0.05, True) == 0.6
    assert needed(valley, 0.02, True) == pytest.approx(0.4)
    assert needed(valley, math.sqrt(0.02 * 0.04), True) == pytest.approx(0.5)
    assert needed(valley, 0.005, True) is None
    gap = [*valley[:1], Point(dial="inner", value=0.3, own=False, note="no"), *valley[1:]]
    assert needed(gap, 0.02, True) == needed(valley, 0.02, True)


# ---- the command ----


def test_command_prints_writes_and_draws(
    own: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    tried(monkeypatch, inner=(0.5,), height=(2.0,))
    out = tmp_path / "out"
    asked: dict[str, Any] = {"body": "dome", "sensor": (own,), "shears": 1, "azimuth_deg": 30.0}
    assert limit(**asked, margin_error=0.03, out=out) == 0
    text = capsys.readouterr().out
    report = json.loads((out / "limit.json").read_text(encoding="utf-8"))
    entry = report["sensors"][own]
    assert report["body"] == "dome"
    assert entry["read_by"] == ["contact"]
    assert f"{own}: one layer moves" in text
    assert "read by contact\n" in text
    best = entry["deviations"]["contact"][NOISES[0]]
    assert f"{best['margin']:.3g}" in text
    assert f"{1e3 * best['normal_n']:.3g}" in text
    assert set(entry["deviations"]) == {
        "contact", "tractions, zone known", "tractions, open zone",
    }  # fmt: skip
    truth = entry["truth"]
    load = 1.05 * np.array([math.cos(math.radians(30.0)), math.sin(math.radians(30.0))])
    assert [truth["x_n"], truth["y_n"]] == pytest.approx(load, abs=0.01)
    assert set(entry["needed"]) == set(DomeLimit.DIALS)
    assert "depth of the inner layer [thicknesses]" in text
    with (out / "limit.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["own"] == "1"]
    told = entry["deviations"]["contact"][NOISES[1]]["margin"]
    np.testing.assert_allclose([float(row["margin_error"]) for row in rows], told, rtol=1e-4)
    picture = cv2.imread(str(out / "limit.png"))
    assert picture is not None
    assert picture.std() > 10.0
    assert limit(**asked, json_only=True) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["sensors"][own]["deviations"] == entry["deviations"]


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (
            {"sensor": ("flat-2019",)},
            "sensor flat-2019: limit --body dome needs a dome of silicone",
        ),
        ({"sensor": ("nothing",)}, "no sensor design"),
        ({"noise": 0.0}, "--noise must be finite and above 0"),
        ({"shears": 0}, "--shears must be 1 to 20, got 0"),
        ({"friction": 0.0}, "--friction must be above 0"),
        ({"radius_mm": -5.0}, "--radius-mm must be above 0"),
        ({"stiffness_kpa": 0.0}, "--stiffness-kpa must be above 0"),
        ({"azimuth_deg": math.inf}, "--azimuth-deg must be finite"),
        ({"load": 2.0, "sensor": ("dome-2020",)}, "sensor dome-2020: a grip of 3 N must hold"),
        ({"body": "chain", "shears": 2}, "--shears needs --body dome"),
        ({"body": "chain", "azimuth_deg": 10.0}, "--azimuth-deg needs --body dome"),
    ],
)
def test_command_refuses_what_cannot_be(asked: dict[str, Any], words: str) -> None:
    with pytest.raises(UserError, match=words):
        limit(**{"body": "dome", **asked})
