"""What an image can tell: limits that must hold."""

import csv
import json
import tomllib
from dataclasses import astuple
from dataclasses import replace as changed
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from chromagrip.cli.limit import limit
from chromagrip.measure.limits.dials import DIALS
from chromagrip.measure.limits.forces import Press, force_limit, press
from chromagrip.measure.limits.sweep import Point, needed
from chromagrip.model import ContactObject, Fingertip
from chromagrip.render import SensorDesign
from chromagrip.render.drawing.coverage import edge_width
from chromagrip.strict_toml import convert

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


def sparse_text() -> str:
    """Text of the design without defects."""
    text = (DESIGNS / "fovea.toml").read_text(encoding="utf-8")
    for old, new in SPARSER:
        assert old in text
        text = text.replace(old, new)
    return text.partition("# Of one specimen")[0]


SPARSE = convert(tomllib.loads(sparse_text()), SensorDesign, "sparse")
TIP, FLAT = Fingertip(), ContactObject()


@pytest.fixture(scope="module")
def held() -> Press:
    """A margin of 0.3 on the thesis's object."""
    return press(TIP, FLAT, 1.86, 0.65)


# ---- contacts ----


def test_forces_answer_to_grip_and_load_alone(held: Press) -> None:
    """On a flat object ΣFn is the grip and ΣFf the load, whatever else changes."""
    expected = np.zeros((2, 9))
    expected[0, 3], expected[1, 4] = 1.6, 0.8
    np.testing.assert_allclose(held.sums, expected, atol=0.02)
    assert held.field.safety_margin(0.5) == pytest.approx(1 - 0.65 / (0.5 * 1.86), abs=0.005)


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


# ---- the command ----


@pytest.mark.studies
def test_the_command_tells_what_less_noise_is_worth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own.toml").write_text(sparse_text(), encoding="utf-8")
    own, out = str(tmp_path / "own.toml"), tmp_path / "out"
    for name, dial in DIALS.items():
        tried = (0.5, 1.0, 2.0) if name == "noise" else ()
        monkeypatch.setitem(DIALS, name, changed(dial, tried=tried))
    assert limit(sensor=(own,), out=out) == 0
    entry = json.loads((out / "limit.json").read_text(encoding="utf-8"))["sensors"][own]
    assert f"{entry['limits']['margin']:.3g}" in capsys.readouterr().out
    assert entry["normal_n"] == pytest.approx(1.86, rel=0.01)
    with (out / "limit.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["dial"] == "noise"]
    noise, errors = (np.array([float(row[k]) for row in rows]) for k in ("value", "margin_error"))
    assert (np.diff(errors[np.argsort(noise)]) > 0.0).all()
    assert (out / "limit.png").stat().st_size > 0
    (kept,) = (row["margin_error"] for row in rows if row["own"] == "1")
    assert float(kept) == pytest.approx(entry["limits"]["margin"], rel=1e-4)
