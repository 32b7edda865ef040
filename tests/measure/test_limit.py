"""What an image can tell: limits that must hold, and the design that was found with them."""

import csv
import json
import tomllib
from dataclasses import astuple
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from chromagrip.cli.limit import limit
from chromagrip.errors import UserError
from chromagrip.measure.limits.chain import ChainLimit
from chromagrip.measure.limits.dials import DIALS
from chromagrip.measure.limits.dome.report import NOISES, DomeLimit
from chromagrip.measure.limits.forces import (
    LEFT_FRICTION,
    Press,
    follow_path,
    force_limit,
    histories,
    press,
)
from chromagrip.measure.limits.sweep import Point, needed, sweep
from chromagrip.model import ContactObject, Fingertip
from chromagrip.render import SensorDesign, load_sensor
from chromagrip.render.drawing.coverage import edge_width
from chromagrip.strict_toml import convert

THESIS, FOVEA = load_sensor("thesis"), load_sensor("fovea")
DESIGNS = Path(__file__).parents[2] / "render" / "designs"
#: A quarter of the markers on a quarter of the pixels, for what holds for any design.
SPARSER = (
    ("count = 300", "count = 75"),
    ("pitch_mm = 0.45", "pitch_mm = 0.9"),
    ("size_mm = 0.24", "size_mm = 0.48"),
    ("_px = 640", "_px = 320"),
    ("_px = 480", "_px = 240"),
    ("225.0, 225.0", "112.5, 112.5"),
)
#: Fewer markers on a coarse skin.
COARSER = (
    ("core_mm = 15.6", "core_mm = 15.6\npitch_mm = 1.6"),
    ("count = 108", "count = 60"),
    ("coverage_deg = 61.5", "coverage_deg = 50.0"),
)


def text_of(name: str, changes: tuple[tuple[str, str], ...]) -> str:
    """Text of a design with changes and without defects."""
    text = (DESIGNS / f"{name}.toml").read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return text.partition("# Of one specimen")[0]


SPARSE = convert(tomllib.loads(text_of("fovea", SPARSER)), SensorDesign, "sparse")
TIP, FLAT = Fingertip(), ContactObject()


@pytest.fixture(scope="module")
def held() -> Press:
    """A margin of 0.3 on the thesis's object."""
    return press(TIP, FLAT, 1.86, 0.65)


def chain_limit(design: SensorDesign) -> ChainLimit:
    return ChainLimit(design=design, levels=2.0, fingertip=TIP, object_=FLAT, grip=1.86, load=0.65)


def try_few(monkeypatch: pytest.MonkeyPatch, *dials: str) -> None:
    """Try two values of some dials beside the design's own, and none of the others."""
    for name, dial in DIALS.items():
        tried = (0.5, 1.0, 2.0) if name in dials else ()
        monkeypatch.setitem(DIALS, name, changed(dial, tried=tried))


# ---- contacts ----


def test_forces_answer_to_grip_and_load_alone(held: Press) -> None:
    """On a flat object ΣFn is the grip and ΣFf the load, whatever else changes."""
    expected = np.zeros((2, 9))
    expected[0, 3], expected[1, 4] = 1.6, 0.8
    np.testing.assert_allclose(held.sums, expected, atol=0.02)
    assert held.field.safety_margin(0.5) == pytest.approx(1 - 0.65 / (0.5 * 1.86), abs=0.005)


def test_what_random_histories_leave_is_as_large_as_taken() -> None:
    """Friction of random paths to the same end, beyond what the four ways span."""
    rng, left = np.random.default_rng(3), []
    for obj, grip, load in (
        (FLAT, 1.86, 0.65),
        (ContactObject(stiffness=160.0, curvature=50.0, friction=0.7), 1.33, 0.65),
        (ContactObject(stiffness=80.0, curvature=200.0), 1.86, 0.65),
        (FLAT, 4.0, 0.65),
    ):
        mu, end = obj.friction, (grip, load)
        base = follow_path(TIP, obj, [(grip, 0.0), end]).friction
        ways = [follow_path(TIP, obj, way).friction - base for way in histories(mu, grip, load)]
        span = np.linalg.qr(np.stack(ways, axis=1))[0]
        rest = []
        for _ in range(7):
            grips = grip * rng.uniform(0.3, 1.4, rng.integers(1, 4))
            path = [(g, 0.95 * mu * g * rng.uniform(-0.5, 1.0)) for g in grips]
            other = follow_path(TIP, obj, [*path, end]).friction - base
            rest.append(other - span @ (span.T @ other))
        touching = abs(base) > 0.0
        typical = np.sqrt(np.mean(np.square(rest), axis=0)[touching].mean())
        left.append(typical / (mu * grip / touching.sum()))
    assert np.exp(np.mean(np.log(left))) == pytest.approx(LEFT_FRICTION, rel=0.5)


# ---- limits ----


def test_frames_are_as_good_as_less_noise(held: Press) -> None:
    once = force_limit(SPARSE, held, 2.0)
    again = force_limit(SPARSE, held, 4.0, frames=4, rest_frames=64)
    np.testing.assert_allclose(astuple(again), astuple(once), rtol=1e-9)
    quiet = force_limit(SPARSE, held, 2.0, frames=4, rest_frames=64)
    ratio = np.array(astuple(quiet)) / astuple(once)
    assert (ratio < 1.0).all()  # more is known …
    assert (ratio > 0.5 - 1e-9).all()  # … by no more than the frames tell
    assert ratio[0] < 0.8
    assert ratio[2] < 0.8


def test_noise_leaves_what_was_known_before_and_none_leaves_the_object(held: Press) -> None:
    blind = force_limit(SPARSE, held, 1e7)
    assert blind.mu == pytest.approx(0.2, rel=1e-3)
    assert blind.normal == pytest.approx(1.6, rel=0.02)
    assert blind.friction == pytest.approx(0.8, rel=0.02)
    clear = force_limit(SPARSE, held, 1e-3)
    assert clear.any_normal < 0.003
    assert clear.normal < 0.005
    assert clear.margin < 0.02


def test_the_same_picture_in_more_pixels_is_a_picture_with_less_noise(held: Press) -> None:
    """Pixels of 0.6 times the number hold 0.6² of the light's samples, and nothing else changes."""
    share, lens = 0.6, SPARSE.camera
    edge = share * edge_width(lens.blur_px)
    camera = replace(
        lens,
        width_px=round(share * lens.width_px),
        height_px=round(share * lens.height_px),
        focal_px=tuple(share * f for f in lens.focal_px),
        blur_px=float(np.sqrt(edge**2 - 1 / 12)),
    )
    fewer = force_limit(replace(SPARSE, camera=camera), held, 2.0)
    noisier = force_limit(SPARSE, held, 2.0 / share)
    np.testing.assert_allclose(astuple(fewer), astuple(noisier), rtol=0.03)


def test_a_press_alone_hides_friction_and_the_load_may_point_either_way(held: Press) -> None:
    assert 0.18 < force_limit(SPARSE, press(TIP, FLAT, 2.0, 0.0), 2.0).mu <= 0.2
    left, right = (
        astuple(force_limit(SPARSE, p, 2.0)) for p in (press(TIP, FLAT, 1.86, -0.65), held)
    )
    # The layout is a spiral, which is not quite its own mirror image.
    np.testing.assert_allclose(left, right, rtol=0.25)
    np.testing.assert_allclose(left[:4], right[:4], rtol=0.1)
    assert right[2] < 0.05


# ---- charts ----


def test_sweeps_vary_one_thing_and_say_what_cannot_be(monkeypatch: pytest.MonkeyPatch) -> None:
    dense = replace(SPARSE, magenta=replace(SPARSE.magenta, size_mm=0.7))
    try_few(monkeypatch, "noise", "size")
    points = sweep(chain_limit(dense))
    noise = [p for p in points if p.dial == "noise"]
    assert [p.value for p in noise] == sorted((p.value for p in noise), reverse=True)
    assert (np.diff([p.error() for p in noise]) < 0.0).all()
    assert [p.value for p in noise if p.own] == [2.0]
    size = [p for p in points if p.dial == "size"]
    assert np.isnan(size[-1].error())
    assert "overlap" in size[-1].note
    for name in ("markers", "height", "size"):
        dial = DIALS[name]
        assert dial.value is not None
        half = dial.value(dial.change(dense, 0.5))
        assert half == pytest.approx(0.5 * dial.value(dense), rel=0.02)


def test_what_is_needed_is_read_between_the_points() -> None:
    def point(value: float, own: float = 0.0, **errors: float) -> Point:
        return Point(dial="markers", value=value, own=value == own, errors=errors)

    points = [point(n, margin_error=0.4 / np.sqrt(n)) for n in (50, 100, 400)]
    assert needed(points, 0.03, False) == pytest.approx((0.4 / 0.03) ** 2)
    assert needed(points, 0.5, False) == 50
    assert needed(points, 0.01, False) is None
    gap = [points[0], changed(points[0], value=70, note="no", errors={}), *points[1:]]
    assert needed(gap, 0.03, False) == needed(points, 0.03, False)
    # Of a dome the value that is nearest to the design.
    told = ((0.2, 0.01), (0.4, 0.02), (0.6, 0.04), (0.8, 0.08), (1.0, 0.02))
    valley = [point(value, 0.6, margin_error=margin) for value, margin in told]
    assert needed(valley, 0.05, True) == 0.6
    assert needed(valley, 0.02, True) == pytest.approx(0.4)
    assert needed(valley, np.sqrt(0.02 * 0.04), True) == pytest.approx(0.5)
    assert needed(valley, 0.005, True) is None


# ---- the design ----


@pytest.mark.studies
def test_fovea_shows_more_than_the_thesis_design(held: Press) -> None:
    thesis, fovea = (force_limit(s, held, 2.0) for s in (THESIS, FOVEA))
    assert fovea.margin < 0.6 * thesis.margin
    assert fovea.any_normal < 0.35 * thesis.any_normal
    # Why: from the sphere centre a radial displacement shows in a marker's size alone.
    (_, far), (angle, near) = (chain_limit(s).pair_errors() for s in (THESIS, FOVEA))
    assert near["radially"][angle < 20.0].max() < 0.6 * np.median(far["radially"])


# ---- the command ----


@pytest.mark.parametrize("body", [pytest.param("chain", marks=pytest.mark.studies), "dome"])
def test_command_prints_writes_and_draws(
    body: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    design = {"chain": ("fovea", SPARSER), "dome": ("dome-2020", COARSER)}[body]
    (tmp_path / "own.toml").write_text(text_of(*design), encoding="utf-8")
    own, out = str(tmp_path / "own.toml"), tmp_path / "out"
    asked: dict[str, Any] = {"sensor": (own,)}
    if body == "dome":
        asked |= {"body": "dome", "shears": 1, "azimuth_deg": 30.0}
    try_few(monkeypatch, "noise")
    assert limit(**asked, margin_error=0.05, out=out) == 0
    text = capsys.readouterr().out
    entry = json.loads((out / "limit.json").read_text(encoding="utf-8"))["sensors"][own]
    if body == "dome":
        told, kept = entry["deviations"]["contact"], "deviations"
        best, normal, told = told[NOISES[0]], "normal_n", told[NOISES[1]]
        load = 1.05 * np.array([np.cos(np.pi / 6.0), np.sin(np.pi / 6.0)])
        assert [entry["truth"]["x_n"], entry["truth"]["y_n"]] == pytest.approx(load, abs=0.01)
        assert f"{own}: one layer moves" in text
        assert set(entry["deviations"]) == {
            "contact", "tractions, zone known", "tractions, open zone",
        }  # fmt: skip
    else:
        best, normal, kept = entry["limits"], "any_normal", "limits"
        told = best
        assert entry["normal_n"] == pytest.approx(1.86, rel=0.01)
    assert f"{best['margin']:.3g}" in text
    assert f"{1e3 * best[normal]:.3g}" in text
    assert set(entry["needed"]) == set({"chain": ChainLimit, "dome": DomeLimit}[body].DIALS)
    with (out / "limit.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["own"] == "1"]
    np.testing.assert_allclose([float(row["margin_error"]) for row in rows], told["margin"], 1e-4)
    picture = cv2.imread(str(out / "limit.png"))
    assert picture is not None
    assert picture.std() > 10.0
    assert limit(**asked, json_only=True) == 0
    assert json.loads(capsys.readouterr().out)["sensors"][own][kept] == entry[kept]
    with pytest.raises(UserError, match="not empty"):
        limit(**asked, out=out)
