"""Read-outs that are trained at their first use; the training itself is replaced."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from subprocess import CompletedProcess
from types import SimpleNamespace
from typing import Any

import pytest
import tomli_w

from chromagrip.calibrate import first_use
from chromagrip.calibrate import readout as training
from chromagrip.calibrate.first_use import (
    EPOCHS,
    HISTORIES,
    NOISE,
    ensure_readout,
    place_to_keep,
)
from chromagrip.calibrate.ranges import RANGES
from chromagrip.calibrate.readout import VARIATIONS
from chromagrip.calibrate.training_ranges import range_lines, training_ranges
from chromagrip.errors import UserError
from chromagrip.render import load_sensor
from chromagrip.tracking import check_reconstructor, load_calibration, sensor_as_designed
from chromagrip.tracking.forces import (
    chain,
    check_trainable,
    kept_path,
    kept_readout,
    nominal_calibration,
)

DOCS = Path(__file__).parents[2] / "docs"
DESIGNS = Path(__file__).parents[2] / "render" / "designs"
Typed = Callable[..., CompletedProcess[str]]


class Trainer:
    """In place of the training: counts, and writes what it is told."""

    def __init__(self) -> None:
        self.known: list[Any] = []
        self.broken = False

    def __call__(self, known: Any, noise: float, n: int, e: int, out: Path, *rest: Any) -> Any:
        """As `train`."""
        self.known.append(known)
        parts = out.with_name(f"{out.name}.parts")
        parts.mkdir(exist_ok=True)
        if self.broken:
            raise KeyboardInterrupt
        parts.rmdir()
        out.write_bytes(b"learned")
        return {"normal": 0.1, "friction_n": 0.1, "mu": 0.1, "margin": 0.1}


@pytest.fixture
def trainer(monkeypatch: pytest.MonkeyPatch, no_kept: Path) -> Trainer:
    """Stands in for the training, with no read-out kept yet."""
    found = Trainer()
    monkeypatch.setattr(training, "train", found)
    return found


def own_design(folder: Path, **values: str) -> Path:
    """File of the thesis's design with other values."""
    text = (DESIGNS / "thesis.toml").read_text(encoding="utf-8")
    for key, value in values.items():
        line = next(line for line in text.splitlines() if line.startswith(f"{key} = "))
        text = text.replace(line, f"{key} = {value}", 1)
    path = folder / "own.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_first_use_trains_and_the_second_finds_what_is_kept(
    trainer: Trainer, no_kept: Path
) -> None:
    fovea = load_calibration("fovea")
    assert fovea.readout is None
    known = ensure_readout(fovea)
    assert known.readout == kept_path(load_sensor("fovea"))
    assert known.readout.parent == no_kept / "chromagrip" / "readouts"
    assert known.readout.read_bytes() == b"learned"
    again = load_calibration("fovea")
    assert again.readout == known.readout
    check_reconstructor("auto", again)
    assert ensure_readout(again) == ensure_readout(fovea) == known
    assert len(trainer.known) == 1
    assert not list(known.readout.parent.glob("*.parts"))


def test_a_sensor_with_a_shipped_read_out_is_never_trained(trainer: Trainer) -> None:
    thesis = load_calibration("thesis")
    assert ensure_readout(thesis) is thesis
    assert trainer.known == []


def test_calibrations_of_one_design_share_what_is_learned_of_it(
    trainer: Trainer, tmp_path: Path
) -> None:
    """Calibrated values are no other design: forces are scaled, layers are read off the rest."""
    mine = tmp_path / "mine.toml"
    values = {
        "tissue_stiffness_n_per_m": 500.0,
        "membrane_stiffness_n_per_m": 1544.0,
        "tissue_poisson": 0.4,
        "yellow_follow": 0.45,
        "magenta_depth_mm": 0.2,
        "yellow_depth_mm": 0.7,
    }
    table = {"format": "chromagrip calibration 1", "sensor": "fovea", "values": values}
    mine.write_text(tomli_w.dumps(table), encoding="utf-8")
    ensure_readout(load_calibration(str(mine)))
    assert [known.sensor for known in trainer.known] == [load_sensor("fovea")]
    assert trainer.known[0].fingertip == nominal_calibration(load_sensor("fovea")).fingertip
    assert load_calibration(str(mine)).readout == kept_path(load_sensor("fovea"))


def test_another_design_is_kept_elsewhere(no_kept: Path, tmp_path: Path) -> None:
    thesis = kept_path(load_sensor("thesis"))

    def place(**values: str) -> Path:
        return kept_path(load_sensor(str(own_design(tmp_path, **values))))

    assert place() == thesis
    others = [
        place(radius_mm="9.0"),
        place(follow="0.9"),
        place(count="380"),
        place(blur_px="0.9"),
        place(apex="[240, 249, 248]"),
        place(size_mm="0.45"),
    ]
    assert len({thesis, *others}) == 7
    # Neither of these changes what is learned.
    assert place(description='"another"', stiffness_deviation="0.2") == thesis


def test_files_that_a_design_names_count_by_their_content(no_kept: Path, tmp_path: Path) -> None:
    text = own_design(tmp_path).read_text(encoding="utf-8")
    begin, end = text.index("[layout]"), text.index("# Stiff dots")
    (tmp_path / "own.toml").write_text(
        f"{text[:begin]}[layout]\nkind = 'file'\npath = 'dots.csv'\n{text[end:]}", encoding="utf-8"
    )

    def place(third: int) -> Path:
        rows = f"theta_deg,phi_deg\n0,0\n20,0\n30,{third}\n40,180\n"
        (tmp_path / "dots.csv").write_text(rows)
        return kept_path(load_sensor(str(tmp_path / "own.toml")))

    assert place(90) == place(90)
    assert place(90) != place(91)


def test_an_interrupted_training_leaves_its_parts_and_no_read_out(trainer: Trainer) -> None:
    trainer.broken = True
    fovea = load_calibration("fovea")
    with pytest.raises(KeyboardInterrupt):
        ensure_readout(fovea)
    assert kept_readout(fovea.nominal) is None
    assert load_calibration("fovea").readout is None
    path = kept_path(fovea.nominal)
    assert [file.name for file in path.parent.iterdir()] == [f"{path.name}.parts"]
    trainer.broken = False
    assert ensure_readout(fovea).readout == path


def test_a_cache_that_cannot_be_written_is_one_sentence(
    trainer: Trainer, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = tmp_path / "file"
    file.touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(file))
    with pytest.raises(
        UserError, match=r"read-outs cannot be kept in .*: Not a directory; set XDG"
    ):
        ensure_readout(load_calibration("fovea"))
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    with pytest.raises(UserError, match="cannot be kept: there is no cache folder relative"):
        ensure_readout(load_calibration("fovea"))
    assert trainer.known == []


@pytest.mark.parametrize("sensor", ["dome-2020", "dome-2020-printed", "dome-2022", "fovea"])
def test_every_dome_can_be_trained(sensor: str) -> None:
    check_trainable(sensor_as_designed(sensor))


@pytest.mark.parametrize(
    ("sensor", "law", "words"),
    [
        ("flat-2019", "split", "a flat pad has no force model: calibrate its displacements"),
        ("fovea", "axial", "spring law split, the fingertip has axial: choose fingertip.model"),
    ],
)
def test_what_cannot_be_trained_is_refused_with_what_to_do(
    sensor: str, law: Any, words: str, trainer: Trainer
) -> None:
    known = sensor_as_designed(sensor, law)
    for attempt in (ensure_readout, place_to_keep, lambda k: check_reconstructor("auto", k)):
        with pytest.raises(UserError) as refused:
            attempt(known)  # type: ignore[operator]
        assert str(refused.value).startswith(f"sensor {sensor}: ")
        assert words in str(refused.value)
    assert trainer.known == []


def test_a_command_says_what_it_trains_before_it_begins(
    trainer: Trainer, typed: Typed, no_kept: Path
) -> None:
    """The stand-in learns nothing, so that the run that follows refuses its file."""
    changes = ["--set", "sensor=fovea", "--set", "duration_s=0.05"]
    words = ["grasp", "camera-100hz", *changes, "--json"]
    done = typed(*words)
    first, hint, second = done.stderr.splitlines()
    assert first.startswith("chromagrip: sensor fovea has no read-out yet: training one on ")
    assert str(kept_path(load_sensor("fovea"))) in first
    assert "minutes" in first
    assert "--body dome" in hint
    assert second.endswith("is not a trained read-out")
    assert len(trainer.known) == 1
    done = typed(*words)
    assert "has no read-out yet" not in done.stderr
    assert len(trainer.known) == 1


@pytest.mark.parametrize("words", [["--path", "truth"], ["--set", "reconstructor="]])
def test_what_needs_no_read_out_trains_none(
    words: list[str], trainer: Trainer, typed: Typed, no_forces: str
) -> None:
    changes = ["--set", "sensor=fovea", "--set", "duration_s=0.02"]
    words = [w.replace("reconstructor=", f"reconstructor={no_forces}") for w in words]
    done = typed("grasp", "camera-100hz", *changes, *words, "--json")
    assert done.returncode == 0, done.stderr
    assert trainer.known == []
    summary = json.loads(done.stdout)
    assert summary["readout"] is None
    if "--path" in words:
        assert summary["stiffness_deviation"] is None
    else:
        assert summary["reconstructor"] == no_forces
        assert summary["stiffness_deviation"] == load_sensor("fovea").stiffness_deviation


def test_train_without_a_file_keeps_the_read_out_by_design(
    trainer: Trainer, typed: Typed, tmp_path: Path
) -> None:
    design = own_design(tmp_path, radius_mm="9.0")
    done = typed("calibrate", "readout", design)
    assert done.returncode == 0, done.stderr
    path = kept_path(load_sensor(str(design)))
    assert path.is_file()
    assert str(path) in done.stdout
    assert load_calibration(str(design)).readout == path
    assert f"kept in {path}; give --overwrite" in typed("calibrate", "readout", design).stderr
    assert typed("calibrate", "readout", design, "--overwrite").returncode == 0
    assert len(trainer.known) == 2
    assert "which comes first; give --out" in typed("calibrate", "readout", "thesis").stderr


def test_the_table_of_ranges_has_every_field_of_the_training() -> None:
    ranges = training_ranges(VARIATIONS, 2.0, HISTORIES, 1)
    assert json.loads(json.dumps(ranges))["training"]["histories"] == HISTORIES
    rows = {row["name"]: row for rows in ranges.values() if isinstance(rows, list) for row in rows}
    settings = {*vars(RANGES), *vars(VARIATIONS)}
    assert settings - {*rows} == {"nominal_share", "each_share"}

    def told(name: str) -> tuple[str, float, float]:
        return rows[name]["unit"], rows[name]["low"], rows[name]["high"]

    assert told("friction") == ("", *RANGES.friction)
    assert told("stiffness_n_per_m") == ("N/m", *RANGES.stiffness_n_per_m)
    assert told("drag_n_s_per_m") == ("N·s/m", *RANGES.drag_n_s_per_m)
    assert told("slides_by_n") == ("N", 0.0, RANGES.slides_by_n)
    assert told("follow_share") == ("share", -VARIATIONS.follow_share, VARIATIONS.follow_share)
    assert told("azimuth_deg") == ("°", -2 * VARIATIONS.azimuth_deg, 2 * VARIATIONS.azimuth_deg)
    assert told("noise_levels") == ("levels", 2.0 * 0.3, 2.0 * 4.0)
    lines = range_lines(ranges)
    assert len({what for what, *_ in lines}) == len(lines) == len(rows)


def test_the_pages_have_the_ranges_and_sizes_of_the_training() -> None:
    """Made by `docs/make.py ranges`."""
    page = (DOCS / "appendix/training-ranges.md").read_text(encoding="utf-8")
    for cells in range_lines(training_ranges(VARIATIONS, NOISE, HISTORIES, EPOCHS)):
        assert f"| {' | '.join(cells)} |" in page
    text = (DOCS / "forces.md").read_text(encoding="utf-8")
    assert f"on {HISTORIES} random grips with {EPOCHS} passes" in text


def test_the_command_readout_tells_what_was_trained(
    typed: Typed, no_kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ranges = training_ranges(VARIATIONS, 2.0, 123, 4)
    stand_in = SimpleNamespace(ranges=ranges)
    monkeypatch.setattr(chain, "load_readout", lambda path: stand_in)
    told = json.loads(typed("list", "readouts", "thesis", "--json").stdout)
    assert told["origin"] == "shipped"
    assert told["ranges"]["training"]["histories"] == 123
    path = Path(told["readout"])
    assert told["digest"] == hashlib.sha256(path.read_bytes()).hexdigest()[:12]
    printed = typed("list", "readouts", path).stdout
    assert "thesis.npz" in printed
    for what, *_ in range_lines(ranges):
        assert what[:12] in printed
    assert "sensor fovea has no trained read-out" in typed("list", "readouts", "fovea").stderr


@pytest.mark.stages
def test_a_small_training_is_kept_used_and_named(
    typed: Typed, no_kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From a sensor that nobody trained to a run whose summary names what was learned."""
    monkeypatch.setattr(training, "PART", 25)
    monkeypatch.setattr(training, "BASIS", 50)
    monkeypatch.setattr(first_use, "HISTORIES", 50)
    monkeypatch.setattr(first_use, "EPOCHS", 1)
    known = ensure_readout(load_calibration("fovea"), workers=1)
    assert known.readout is not None
    assert [file.name for file in known.readout.parent.iterdir()] == [known.readout.name]
    done = typed("grasp", "--set", "sensor=fovea", "--set", "duration_s=0.02", "--json")
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["reconstructor"] == "sequential"
    digest = hashlib.sha256(known.readout.read_bytes()).hexdigest()
    assert summary["readout"] == {"file": "kept", "digest": digest[:12], "histories": 50}


def test_the_spread_of_the_stiffness_is_the_designs_unless_a_calibration_states_its_own(
    no_kept: Path, tmp_path: Path
) -> None:
    design = own_design(tmp_path, stiffness_deviation="0.03")
    assert load_calibration(str(design)).stiffness_deviation == 0.03
    text = design.read_text(encoding="utf-8").replace("stiffness_deviation = 0.03\n", "")
    design.write_text(text, encoding="utf-8")
    unsaid = load_calibration(str(design)).stiffness_deviation
    assert unsaid == load_sensor("thesis").stiffness_deviation > 0.0
    assert sensor_as_designed("flat-2019").stiffness_deviation == 0.0
    mine = tmp_path / "mine.toml"
    head = f"format = 'chromagrip calibration 1'\nsensor = '{design.name}'\n"
    mine.write_text(head)
    assert load_calibration(str(mine)).stiffness_deviation == unsaid
    mine.write_text(head + "stiffness_deviation = 0.0\n")
    assert load_calibration(str(mine)).stiffness_deviation == 0.0
    assert replace(load_calibration(str(mine)), stiffness_deviation=0.2).design is None
