"""What an image can tell: limits that must hold, and the design that was found with them."""

import csv
import json
import tomllib
from dataclasses import astuple
from dataclasses import replace as changed
from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from chromagrip.cli.limit import limit
from chromagrip.errors import UserError
from chromagrip.measure.limits.chain import ChainLimit
from chromagrip.measure.limits.dials import DIALS
from chromagrip.measure.limits.forces import (
    LEFT_FRICTION,
    Press,
    follow_path,
    force_limit,
    histories,
    press,
)
from chromagrip.measure.limits.kernels import fisher_information, pair_information
from chromagrip.measure.limits.sweep import LOOKS, Point, legend_of, needed, sweep
from chromagrip.model import ContactObject, Fingertip
from chromagrip.render import (
    Frame,
    MembraneMap,
    SensorDesign,
    add_noise,
    load_sensor,
    open_renderer,
)
from chromagrip.render.colour import decode_srgb, encode_srgb
from chromagrip.render.drawing.coverage import edge_width
from chromagrip.render.outlines import centroids, outlines
from chromagrip.strict_toml import convert
from chromagrip.tracking import MarkerTracker, Palette

THESIS, FOVEA = load_sensor("thesis"), load_sensor("fovea")
# A quarter of the markers on a quarter of the pixels, for what holds for any design.
SMALLER = (
    ("count = 300", "count = 75"),
    ("pitch_mm = 0.45", "pitch_mm = 0.9"),
    ("size_mm = 0.24", "size_mm = 0.48"),
    ("_px = 640", "_px = 320"),
    ("_px = 480", "_px = 240"),
    ("225.0, 225.0", "112.5, 112.5"),
)


def sparse_text() -> str:
    folder = Path(__file__).parents[2] / "render" / "designs"
    text = (folder / "fovea.toml").read_text(encoding="utf-8")
    for old, new in SMALLER:
        assert old in text
        text = text.replace(old, new)
    return text


SPARSE = convert(tomllib.loads(sparse_text()), SensorDesign, "sparse")
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


# ---- a pair ----


def brute_levels(centres: np.ndarray, radii: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Levels of one pair of discs: every pixel sampled 16 × 16 times, edges soft, then blurred."""
    fine, size = 16, ground.shape[0]
    y, x = (np.mgrid[: size * fine, : size * fine] + 0.5) / fine - 0.5
    light = np.ones((size * fine, size * fine, 3))
    for (cx, cy), radius, dye in zip(centres, radii, THESIS.transmittance, strict=True):
        covered = np.clip(fine * (radius - np.hypot(x - cx, y - cy)) + 0.5, 0.0, 1.0)
        light *= 1.0 - covered[..., None] * (1.0 - dye)
    light = np.asarray(cv2.GaussianBlur(light, (0, 0), THESIS.camera.blur_px * fine))
    return encode_srgb(ground * light.reshape(size, fine, size, fine, 3).mean(axis=(1, 3)))


@pytest.mark.parametrize("apart", [(0.0, 0.0), (5.0, -2.0)])
def test_bound_of_a_pair_is_that_of_brute_force(apart: tuple[float, float]) -> None:
    ground = np.broadcast_to(decode_srgb(np.array([250.0, 249.0, 248.0])), (36, 36, 3)).copy()
    centres = np.array([[15.2, 17.1], [15.2 + apart[0], 17.1 + apart[1]]])
    radii, step = np.array([4.8, 5.1]), 0.02
    slopes = []
    for layer in (0, 1):
        for axis in range(3):
            levels = []
            for sign in (step, -step):
                moved, grown = centres.copy(), radii.copy()
                if axis < 2:
                    moved[layer, axis] += sign
                else:
                    grown[layer] *= np.exp(sign)
                levels.append(brute_levels(moved, grown, ground).ravel())
            slopes.append((levels[0] - levels[1]) / (2 * step))
    brute = np.array(slopes) @ np.array(slopes).T
    shapes = np.zeros((2, 1, 3, 2))
    shapes[:, 0, 0], shapes[:, 0, 1:] = centres, radii[:, None, None] * np.eye(2)
    inverses = np.linalg.inv(np.swapaxes(shapes[:, :, 1:], -1, -2))
    rest = (edge_width(THESIS.camera.blur_px), 1.0 - THESIS.transmittance, ground, 1.0)
    found = pair_information(shapes, inverses, *rest)
    for information in (found[0], fisher_information(shapes, inverses, *rest)[0]):
        expected = brute if len(information) == 6 else brute[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])]
        deviation, known = (np.sqrt(np.diag(np.linalg.inv(i))) for i in (information, expected))
        np.testing.assert_allclose(deviation, known, rtol=0.03)


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


@pytest.mark.parametrize("grip", [0.0, 1.3, np.nan, np.inf])
def test_a_contact_that_cannot_be_is_refused(grip: float) -> None:
    with pytest.raises(UserError, match=r"must hold a load of 0\.65 N|press the whole"):
        press(TIP, FLAT, grip, 0.65)


# ---- limits ----


@pytest.mark.studies
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


def test_a_press_alone_hides_friction(held: Press) -> None:
    pressed = press(TIP, FLAT, 2.0, 0.0)
    assert 0.18 < force_limit(THESIS, pressed, 2.0).mu <= 0.2
    assert force_limit(THESIS, held, 2.0).mu < 0.05


def test_the_load_may_point_either_way(held: Press) -> None:
    """The layout is a spiral, which is not quite its own mirror image."""
    other = press(TIP, FLAT, 1.86, -0.65)
    left, right = (astuple(force_limit(SPARSE, p, 2.0)) for p in (other, held))
    np.testing.assert_allclose(left, right, rtol=0.25)
    np.testing.assert_allclose(left[:4], right[:4], rtol=0.1)


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
    points = [
        Point(dial="markers", value=n, own=False, errors={"margin_error": 0.4 / np.sqrt(n)})
        for n in (50, 100, 400)
    ]
    assert needed(points, 0.03, False) == pytest.approx((0.4 / 0.03) ** 2)
    assert needed(points, 0.5, False) == 50
    assert needed(points, 0.01, False) is None
    gap = [points[0], Point(dial="markers", value=70, own=False, note="no"), *points[1:]]
    assert needed(gap, 0.03, False) == needed(points, 0.03, False)


# ---- the design ----


def test_fovea_shows_more_than_the_thesis_design(held: Press) -> None:
    thesis, fovea = (force_limit(s, held, 2.0) for s in (THESIS, FOVEA))
    assert fovea.margin < 0.6 * thesis.margin
    assert fovea.any_normal < 0.35 * thesis.any_normal
    # Why: from the sphere centre a radial displacement shows in a marker's size alone.
    (_, far), (angle, near) = (chain_limit(s).pair_errors() for s in (THESIS, FOVEA))
    assert near["radially"][angle < 20.0].max() < 0.6 * np.median(far["radially"])


def test_fovea_is_found_and_followed(held: Press) -> None:
    """From rest straight to a press and shear of more than a pitch."""
    painter, carry = open_renderer("painter", FOVEA), MembraneMap(FOVEA, TIP.nodes)

    def shoot(seen: np.ndarray, index: int) -> Frame:
        image = painter.render(carry(seen))
        add_noise(image, 2.0, 21, index)
        return Frame(image=image, time=0.01 * index)

    tracker = MarkerTracker(Palette.of_sensor(FOVEA), 2.0)
    tracker.reset([shoot(np.zeros_like(held.displacement), k) for k in range(4)])
    assert tracker.rest.visible.sum(axis=1).tolist() == [300, 300]
    rest, now = (
        centroids(outlines(carry(seen), FOVEA.view), square=False)
        for seen in (np.zeros_like(held.displacement), held.displacement)
    )
    own = np.linalg.norm(tracker.rest.position[0][:, None] - rest[0], axis=-1).argmin(axis=1)
    tracks = tracker.update(shoot(held.displacement, 100))
    assert tracks.visible.all()
    error = tracks.position - now[:, own]
    assert abs(error).max() < 0.1
    assert np.sqrt((error**2).mean()) < 0.012


# ---- the command ----


def test_command_prints_limits_and_needs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    try_few(monkeypatch, *ChainLimit.DIALS)
    (tmp_path / "own.toml").write_text(sparse_text(), encoding="utf-8")
    own, out = str(tmp_path / "own.toml"), tmp_path / "out"
    assert limit(sensor=(own,), margin_error=0.05, out=out) == 0
    text = capsys.readouterr().out
    report = json.loads((out / "limit.json").read_text(encoding="utf-8"))
    entry = report["sensors"][own]
    assert f"{entry['limits']['margin']:.3g}\n" in text
    assert f"{1e3 * entry['limits']['any_normal']:.3g}" in text
    assert "marker pairs, at least" in text
    assert entry["normal_n"] == pytest.approx(1.86, rel=0.01)
    assert set(entry["needed"]) == set(ChainLimit.DIALS)
    assert limit(sensor=(own,), json_only=True) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["sensors"][own]["limits"] == entry["limits"]
    with (out / "limit.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["own"] == "1"]
    margins = [float(row["margin_error"]) for row in rows]
    np.testing.assert_allclose(margins, entry["limits"]["margin"], rtol=1e-4)
    picture = cv2.imread(str(out / "limit.png"))
    assert picture is not None
    assert picture.std() > 10.0
    with pytest.raises(UserError, match="not empty"):
        limit(sensor=(own,), out=out)


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"sensor": ("flat-2019",)}, "flat pad"),
        ({"sensor": ("dome-2020-printed",)}, "stiff discs only"),
        ({"sensor": ("nothing",)}, "no sensor design"),
        ({"noise": 0.0}, "--noise must be finite and above 0"),
        ({"margin_error": -0.1}, "--margin-error must be finite and above 0"),
        ({"frames": 0}, "--frames must be 1 or more"),
        ({"load": 2.0}, "must hold a load of 2 N"),
        ({"radius_mm": 0.2}, "radius_mm"),
    ],
)
def test_command_refuses_what_cannot_be(asked: dict[str, object], words: str) -> None:
    with pytest.raises(UserError, match=words):
        limit(**asked)  # type: ignore[arg-type]


def test_sensors_in_a_chart_differ_by_more_than_colour() -> None:
    """The legend also says what the large mark is."""
    lines = legend_of([f"sensor {k}" for k in range(len(LOOKS))])
    assert len({line.get_marker() for line in lines[:-1]}) == len(LOOKS)
    assert lines[-1].get_label() == "large: the design as it is"
