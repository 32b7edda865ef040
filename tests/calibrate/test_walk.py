"""A walk at a simulated bench: a specimen nobody told it about, a noisy camera, and a scale."""

import json
import math
import re
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tomli_w
from msgspec import to_builtins
from msgspec.structs import replace as changed

from chromagrip import Reader, TactileSensor
from chromagrip.calibrate import walk as module
from chromagrip.calibrate.expected_errors import grip_scores, grip_settings, scored
from chromagrip.calibrate.presses import read_list
from chromagrip.calibrate.walk import Plan, _reading, _with_lens, walk
from chromagrip.cli.calibrate import calibrate_walk
from chromagrip.errors import UserError
from chromagrip.model import Solid, shapes
from chromagrip.pictures.still_frames import judge_press, judge_rest, judge_return
from chromagrip.render import (
    Defects,
    FisheyeCamera,
    Frame,
    SensorDesign,
    load_camera,
    load_sensor,
    save_camera,
)
from chromagrip.sources import Source
from chromagrip.tracking import load_calibration
from chromagrip.tracking.forces import (
    FitReport,
    nominal_calibration,
    silicone_of,
    with_silicone,
)

NOISE, RATE = 2.0, 30.0


def coarse(name: str) -> SensorDesign:
    """A design with few nodes, so that it is quick."""
    design = load_sensor(name)
    assert design.silicone is not None
    return changed(design, silicone=changed(design.silicone, pitch_mm=2.0))


DESIGN = coarse("dome-2020")


def design_file(folder: Path, design: SensorDesign) -> str:
    table = {key: value for key, value in to_builtins(design).items() if value is not None}
    camera = {key: value for key, value in table["camera"].items() if value is not None}
    path = folder / "design.toml"
    path.write_text(tomli_w.dumps(table | {"camera": camera}), encoding="utf-8")
    return str(path)


class Bench:
    """A specimen before a camera, and somebody who does and types what is asked for.

    `answers` has what is typed first, by the begin of a question, and `leaves` the begin of a
    question at which there is nobody any more.
    """

    def __init__(self, design: SensorDesign, seed: int = 0, defects: Defects | None = None) -> None:
        self.sensor = TactileSensor(design, defects=defects)
        self.rng, self.time, self.frames_left = np.random.default_rng(seed), 0.0, math.inf
        self.held = False
        self.questions, self.told = list[str](), list[str]()
        self.answers, self.leaves = dict[str, list[str]](), "nothing"
        self.radius = self.wanted = self.pull = 0.0
        self.scale_error, self.scale_factor = 0.0, 1.0

    def source(self) -> Source:
        return Source(name="bench", frames=self.frames, count=None, fps=1.0, live=True)

    def frames(self) -> Iterator[Frame]:
        while self.frames_left > 0:
            self.frames_left -= 1
            untouched, camera = self.sensor.body.untouched(), self.sensor.camera
            clean = self.sensor.data.clean if self.held else camera.clean(untouched, 0)
            self.time += 1.0 / RATE
            yield Frame(image=noisy(clean, self.rng), time=self.time)

    def ask(self, question: str) -> str:
        self.questions.append(question)
        if question.startswith(self.leaves):
            raise EOFError
        first = next((v for k, v in self.answers.items() if question.startswith(k)), [])
        if first:
            return first.pop(0)
        if about := re.search(r"about ([\d.]+) N", question):
            pull = re.search(r"pull it by ([\d.]+) N", question)
            self.wanted, self.pull = float(about[1]), float(pull[1]) if pull else 0.0
            self.radius = 8.0 - self.radius  # plate and ball in turn
            return f"{self.radius:g}"
        if question.startswith("Press"):
            self.press()
        if question.startswith("Let nothing"):
            self.held = False
        if question.startswith("What does"):
            normal, lateral = -self.sensor.data.wrench[2], self.sensor.data.wrench[0]
            off = self.scale_factor * (1.0 + self.scale_error * self.rng.standard_normal(2))
            return f"{off[0] * normal:.4f} {off[1] * lateral:.4f}"
        return ""

    def press(self) -> None:
        """Press with a ball or a plate of steel, and then pull."""
        shape = shapes.ball(1e-3 * self.radius) if self.radius else shapes.plane()
        self.sensor.attach(Solid(shape=shape, friction=0.8, stiffness=2e10))
        for k in range(1, 7):
            self.sensor.update(force=(0.0, 0.0, -self.wanted * k / 6), dt=0.05)
        for k in range(1, 7) if self.pull else ():
            self.sensor.update(force=(self.pull * k / 6, 0.0, -self.wanted), dt=0.05)
        self.held = True

    def walk(self, out: Path, sensor: str, **options: object) -> dict:
        plan = Plan(presses=2, forces=(0.8, 2.5))
        told = self.told.append
        options = {"plan": plan, **options}
        return walk(self.source(), out, sensor=sensor, ask=self.ask, tell=told, **options)


def noisy(clean: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    noise = NOISE * rng.standard_normal(clean.shape, dtype=np.float32)
    return np.clip(np.rint(clean + noise), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def sights() -> dict[str, np.ndarray]:
    """Pictures without noise: at rest, and pressed more and more."""
    sensor = TactileSensor(DESIGN)
    seen = {"rest": sensor.camera.clean(sensor.body.untouched(), 0).copy()}
    sensor.attach(Solid(shape=shapes.plane(), friction=0.8, stiffness=2e10))
    for force in (0.1, 0.5, 2.0, 3.0):
        sensor.update(force=(0.0, 0.0, -force), dt=0.05)
        seen[f"{force} N"] = sensor.data.clean.copy()
    return seen


def taken(images: list[np.ndarray], seed: int = 0) -> list[Frame]:
    rng = np.random.default_rng(seed)
    return [Frame(image=noisy(image, rng), time=k / RATE) for k, image in enumerate(images)]


def lit(image: np.ndarray, factor: float) -> np.ndarray:
    return np.clip(image * factor, 0.0, 255.0)


@pytest.fixture(scope="module")
def judged(sights: dict[str, np.ndarray]) -> tuple[Reader, float]:
    return judge_rest(taken([sights["rest"]] * 8), DESIGN)


def test_the_light_of_rest_frames_is_judged(
    sights: dict[str, np.ndarray], judged: tuple[Reader, float]
) -> None:
    rest = sights["rest"]
    assert judged[1] == pytest.approx(NOISE, rel=0.05)
    for words, images in {
        "too dark": [lit(rest, 0.2)] * 8,
        "overexposed": [lit(rest, 1.5)] * 8,
        "the light changes by": [lit(rest, 1.0 - 0.05 * (k % 2)) for k in range(8)],
        "image is grey": [np.full_like(rest, 200)] * 8,
    }.items():
        with pytest.raises(UserError, match=words):
            judge_rest(taken(images), DESIGN)


def test_presses_are_judged(sights: dict[str, np.ndarray], judged: tuple[Reader, float]) -> None:
    for force in ("0.5 N", "2.0 N"):
        judge_press(*judged, taken([sights[force]] * 8, seed=1))
    for words, images in {
        "press harder": [sights["0.1 N"]] * 8,
        "hold the press still": [sights["2.0 N"]] * 4 + [sights["3.0 N"]] * 4,
    }.items():
        with pytest.raises(UserError, match=words):
            judge_press(*judged, taken(images, seed=1))
    judge_return(*judged, taken([sights["rest"]] * 8, seed=2))
    with pytest.raises(UserError, match="from where they were at rest"):
        judge_return(*judged, taken([sights["0.5 N"]] * 8, seed=2))


@pytest.mark.slow
def test_what_else_may_be_wrong_with_frames(
    sights: dict[str, np.ndarray], judged: tuple[Reader, float]
) -> None:
    rest = sights["rest"]
    with pytest.raises(UserError, match="keep all still"):
        judge_rest(taken([rest] * 4 + [np.roll(rest, 1, axis=1)] * 4), DESIGN)
    with pytest.raises(UserError, match="marker"):  # of another sensor
        judge_rest(taken([rest] * 8), load_sensor("dome-2020-printed"))
    with pytest.raises(UserError, match="fewer than half of the markers"):
        judge_press(*judged, taken([np.zeros_like(rest)] * 8))
    # Who took the frames at rest under a load is found out after the first press.
    loaded = judge_rest(taken([sights["0.5 N"]] * 8), DESIGN)
    with pytest.raises(UserError, match="from where they were at rest"):
        judge_return(*loaded, taken([rest] * 8, seed=1))


@pytest.mark.parametrize(
    ("answer", "normal", "lateral"),
    [
        ("2.1", 2.1, 0.0),
        ("2,1 N", 2.1, 0.0),
        ("2.1 -0.4", 2.1, -0.4),
        ("2.1, 0.4", 2.1, 0.4),
        ("214 g", 2.0993, 0.0),
        ("0.214 kg", 2.0993, 0.0),
        ("214 g 41", 2.0993, 0.4022),
        ("0.1 N", 0.1, 0.0),
    ],
)
def test_a_scale_is_read(answer: str, normal: float, lateral: float) -> None:
    assert _reading(answer, 2.0) == pytest.approx((normal, lateral), abs=1e-4)


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        ("", "'' is no reading"),
        ("two", "'two' is no reading"),
        ("nan", "'nan' is no reading"),
        ("1 2 3", "is no reading"),
        ("-2", "zero the scale"),
        ("0", "zero the scale"),
        ("2000", "far from 2 N: type the reading with its unit, such as 2 N or 204 g"),
        ("0.2", "far from 2 N"),
        ("0.4 2.1", "slips"),
    ],
)
def test_what_is_no_reading_is_named(answer: str, words: str) -> None:
    with pytest.raises(UserError, match=re.escape(words)):
        _reading(answer, 1.0 if "0.4" in answer else 2.0)


@pytest.fixture
def fitted(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Judges, fit, reader and simulated grips are replaced; folders that were fitted."""
    folders: list[Path] = []
    field = SimpleNamespace(total_normal=1.38, totals_covariance=np.diag([0.07**2, 1.0]))
    read = SimpleNamespace(no_estimate="", field=field)
    reader = SimpleNamespace(update=lambda *_: SimpleNamespace(observation=read))
    monkeypatch.setattr(module, "Reader", lambda *_, **__: reader)
    monkeypatch.setattr(module, "judge_rest", lambda *_: (reader, NOISE))
    monkeypatch.setattr(module, "judge_press", lambda *_: None)
    monkeypatch.setattr(module, "judge_return", lambda *_: None)

    def fit(folder: Path, design: SensorDesign, tell: object) -> object:
        folders.append(folder)
        known = replace(nominal_calibration(design), stiffness_deviation=0.02)
        return known, FitReport(presses=("press-0.png",), noise_levels=NOISE, error_px=0.1)

    errors = {"normal_error": 0.031, "margin_error": 0.052, "margin_inside": 0.8, "read": 1.0}
    monkeypatch.setattr(module, "calibrate_sensor", fit)
    monkeypatch.setattr(module, "expected_errors", lambda *_, **__: errors | {"grips": 24})
    return folders


def test_a_walk_that_was_left_goes_on(tmp_path: Path, fitted: list[Path]) -> None:
    sensor, out = design_file(tmp_path, DESIGN), tmp_path / "mine"
    bench = Bench(DESIGN)
    bench.answers = {"What does": ["much", "2000"], "Press 1": ["big"]}
    bench.leaves = "Press 2"
    with pytest.raises(UserError, match=r"the answers ended; the same command goes on with .*mine"):
        bench.walk(out, sensor)
    assert [
        name for name in ("much", "2000", "big") if not any(name in t for t in bench.told)
    ] == []
    (press,), by_force = read_list(out / "presses.csv")
    assert by_force
    assert (press.name, press.radius) == ("press-0.png", 8e-3)
    assert press.normal == pytest.approx(0.8, abs=0.01)
    assert not (out / "calibration.toml").exists()
    assert fitted == []
    before = (out / "rest-0.png").read_bytes()
    bench = Bench(DESIGN, seed=1)
    summary = bench.walk(out, sensor)
    assert "going on" in bench.told[0]
    assert bench.questions[1].startswith("Press 2 of 2: about 2.5 N, then pull it by 0.62 N")
    assert "Press Enter for the ball of 8 mm" in bench.questions[1]
    assert not any(question.startswith("Press 1") for question in bench.questions)
    assert (out / "rest-0.png").read_bytes() == before
    assert fitted == [out]
    assert [p.normal for p in read_list(out / "presses.csv")[0]] == pytest.approx(
        [0.8, 2.5], rel=0.01
    )
    # The rate is that of the frames, not that which the source states.
    assert summary["rate_hz"] == pytest.approx(RATE)
    assert summary == json.loads((out / "summary.json").read_text(encoding="utf-8"))
    for words in ("expect errors of 3.1% of ΣFn and 0.05 of Γ", "grips of 0.8 to 2.5 N"):
        assert words in summary["sentence"]
    text = (out / "calibration.toml").read_text(encoding="utf-8")
    assert text.startswith(f"# {summary['sentence']}\n")
    known = load_calibration(str(out / "calibration.toml"))
    assert known.sensor == DESIGN
    assert summary["check_n"] == pytest.approx(1.4, abs=0.01)
    with pytest.raises(UserError, match=r"has a calibration.toml already; choose another$"):
        bench.walk(out, sensor)


def test_no_go_and_another_check_press(tmp_path: Path, fitted: list[Path]) -> None:
    sensor, out = design_file(tmp_path, DESIGN), tmp_path / "mine"
    bench = Bench(DESIGN)
    bench.scale_factor = 1.4
    summary = bench.walk(out, sensor)
    assert not summary["go"]
    assert summary["sentence"].startswith(
        "No go: the check press of 1.96 N is read as 1.38 N (1.26 to 1.50 N); an error of the "
        "scale of 4% does not explain it"
    )
    assert not (out / "calibration.toml").exists()
    assert json.loads((out / "summary.json").read_text(encoding="utf-8"))["expected"] is None
    bench = Bench(DESIGN, seed=1)
    assert bench.walk(out, sensor)["go"]
    assert [question[:13] for question in bench.questions if "about" in question] == [
        "Check press: "
    ]


def test_a_lens_is_taken_into_the_design(tmp_path: Path, fitted: list[Path]) -> None:
    view = DESIGN.camera
    assert view.focal_px is not None
    lens = FisheyeCamera(
        width=view.width_px, height=view.height_px, focal=view.focal_px,
        centre=((view.width_px - 1) / 2 + 1.0, (view.height_px - 1) / 2),
        distortion=(0.001, 0.0, 0.0, 0.0),
    )  # fmt: skip
    save_camera(lens, tmp_path / "lens.yml")
    sensor, out = design_file(tmp_path, DESIGN), tmp_path / "mine"
    bench = Bench(DESIGN)
    assert bench.walk(out, sensor, lens=tmp_path / "lens.yml")["go"]
    known = load_calibration(str(out / "calibration.toml")).sensor
    assert known.view.camera.lens == changed(DESIGN, camera=known.camera).view.camera.lens
    assert known.view.camera == load_sensor(str(out / "sensor.toml")).view.camera
    assert known.silicone == DESIGN.silicone
    assert (out / "lens.yml").read_bytes() == (tmp_path / "lens.yml").read_bytes()


def test_a_lens_that_leaves_its_model_open_is_asked_about(tmp_path: Path) -> None:
    size, matrix = (320, 240), [[150.0, 0, 160.0], [0, 150.0, 120.0], [0, 0, 1]]
    np.savez(tmp_path / "lens.npz", K=matrix, D=[0.01, 0, 0, 0], image_size=size)
    sensor, out = design_file(tmp_path, DESIGN), tmp_path / "mine"
    with pytest.raises(UserError, match=r"does not say whether .* --camera-model"):
        Bench(DESIGN).walk(out, sensor, lens=tmp_path / "lens.npz")
    out.mkdir(exist_ok=True)
    name = _with_lens(sensor, tmp_path / "lens.npz", "fisheye", out)
    camera = load_camera(out / "lens.yml")
    assert isinstance(camera, FisheyeCamera)
    assert (camera.width, camera.height) == size
    written = tomllib.loads(Path(name).read_text(encoding="utf-8"))["camera"]
    assert (written["calibration"], written["width_px"]) == ("lens.yml", 320)


def test_what_cannot_be_walked_is_one_sentence(tmp_path: Path, fitted: list[Path]) -> None:
    sensor, bench = design_file(tmp_path, DESIGN), Bench(DESIGN)
    out = tmp_path / "mine"
    bench.frames_left = 40  # the camera vanishes during the first press
    with pytest.raises(UserError, match="bench gives no more frames; the same command goes"):
        bench.walk(out, sensor)
    assert (out / "rest-7.png").exists()
    assert not (out / "presses.csv").exists()
    with pytest.raises(UserError, match=r"bench gives no more frames$"):
        bench.walk(tmp_path / "other", sensor)
    with pytest.raises(UserError, match="288×288 pixels, the sensor's camera 640×480"):
        Bench(DESIGN).walk(tmp_path / "size", "dome-2022")
    with pytest.raises(UserError, match="sensor thesis is not read as a dome of silicone"):
        Bench(DESIGN).walk(tmp_path / "chain", "thesis")
    with pytest.raises(UserError, match="was recorded"):
        walk(replace(bench.source(), count=9), out, sensor=sensor, ask=bench.ask, tell=print)
    with pytest.raises(UserError, match="not empty, and of no walk"):
        Bench(DESIGN).walk(tmp_path, sensor)


def test_the_command_ends_with_its_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(module, "walk", lambda *_, **__: {"go": False, "sentence": "No go: …"})
    assert calibrate_walk("camera:0", sensor="dome-2022", out=tmp_path) == 1
    assert capsys.readouterr().out.startswith("No go: …\n")
    with pytest.raises(UserError, match="where the answers"):
        calibrate_walk("pipe:-", sensor="dome-2022", out=tmp_path)
    with pytest.raises(UserError, match=r"--highest-n 0\.6"):
        calibrate_walk("camera:0", sensor="dome-2022", out=tmp_path, highest_n=0.6)


def specimen_of(design: SensorDesign, young: float) -> SensorDesign:
    """A sensor of another Young's modulus, as a share of the design's."""
    known = nominal_calibration(design)
    values = silicone_of(known)
    assert values is not None
    return with_silicone(known, changed(values, young_kpa=young * values.young_kpa)).sensor


def test_a_reading_is_scored() -> None:
    field = SimpleNamespace(total_normal=2.2)
    read = SimpleNamespace(no_estimate="", field=field, margin=0.5, margin_interval=(0.3, 0.6))
    assert scored(read, 2.0, 0.4) == pytest.approx([0.1, 0.1, 1.0])
    assert scored(read, 2.5, 0.7) == pytest.approx([-0.12, -0.2, 0.0])
    assert np.isnan(scored(SimpleNamespace(no_estimate="no contact"), 2.0, 0.4)).all()


def test_grips_are_spread_evenly() -> None:
    settings, low, high = grip_settings(12), [8e-3, 0.3, 0.2, 0, 0, 0], [30e-3, 0.9, 0.6, 1, 1, 1]
    ranks = np.floor(12 * (settings - low) / np.subtract(high, low))
    assert (np.sort(ranks, axis=0) == np.arange(12)[:, None]).all()
    assert (ranks[:, :-1] != ranks[:, 1:]).any(axis=0).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "young", "seed"), [("dome-2022", 1.15, 1), ("dome-2020", 0.87, 2)]
)
def test_a_specimen_that_nobody_told_about_is_calibrated(
    tmp_path: Path, name: str, young: float, seed: int
) -> None:
    design = coarse(name)
    true, sensor, out = specimen_of(design, young), design_file(tmp_path, design), tmp_path / "mine"
    defects = Defects(misplacement_mm=0.02, uneven_leds=0.1, vignette=0.1)
    bench = Bench(true, seed, defects)
    bench.scale_error = 0.02
    summary = bench.walk(out, sensor, plan=Plan(presses=6, forces=(0.5, 5.0)))
    assert summary["go"], summary["sentence"]
    low, high = summary["check_interval_n"]
    assert low < summary["check_n"] < high
    file = str(out / "calibration.toml")
    table = tomllib.loads(Path(file).read_text(encoding="utf-8"))
    found, by = table["silicone"]["young_kpa"], table["fit"]["deviations"]["young_kpa"]
    assert true.silicone is not None
    assert design.silicone is not None
    assert abs(found - true.silicone.young_kpa) < 2.5 * by
    assert abs(design.silicone.young_kpa - true.silicone.young_kpa) > 4.0 * by
    # The errors to expect are those of other grips, and of the specimen that nobody knows.
    known, rows, expected = load_calibration(file), list[list[float]](), summary["expected"]
    for number, settings in enumerate(grip_settings(24, seed=1)):
        gripped = TactileSensor(true, noise=NOISE, seed=100 + number, defects=defects)
        rows += grip_scores(known, gripped, settings, RATE, NOISE, (0.5, 5.0))
        gripped.close()
    normal, margin = np.sqrt(np.nanmean(np.array(rows)[:, :2] ** 2, axis=0))
    assert 0.5 < expected["normal_error"] / normal < 2.0
    assert 0.5 < expected["margin_error"] / margin < 2.0
    inside = np.nanmean(np.array(rows)[:, 2])
    assert (expected["margin_inside"], expected["read"]) == pytest.approx((inside, 1.0), abs=0.15)
