"""Read-outs that are trained at their first use; the training itself is replaced."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import pytest
import tomli_w

from chromagrip.calibrate import readout as training
from chromagrip.calibrate.first_use import EPOCHS, HISTORIES, NOISE, ensure_readout, place_to_keep
from chromagrip.calibrate.ranges import RANGES
from chromagrip.calibrate.readout import VARIATIONS
from chromagrip.calibrate.training_ranges import range_lines, training_ranges
from chromagrip.errors import UserError
from chromagrip.render import load_sensor
from chromagrip.tracking import check_reconstructor, load_calibration, sensor_as_designed
from chromagrip.tracking.forces import (
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
    thesis, fovea = load_calibration("thesis"), load_calibration("fovea")
    assert ensure_readout(thesis) is thesis  # has a shipped one
    assert fovea.readout is None
    trainer.broken = True
    with pytest.raises(KeyboardInterrupt):
        ensure_readout(fovea)
    assert kept_readout(fovea.nominal) is None
    path = kept_path(fovea.nominal)
    assert [file.name for file in path.parent.iterdir()] == [f"{path.name}.parts"]
    trainer.broken = False
    known = ensure_readout(fovea)
    assert known.readout == path
    assert path.parent == no_kept / "chromagrip" / "readouts"
    assert path.read_bytes() == b"learned"
    again = load_calibration("fovea")
    assert again.readout == path
    check_reconstructor("auto", again)
    assert ensure_readout(again) == ensure_readout(fovea) == known
    assert len(trainer.known) == 2
    assert not list(path.parent.glob("*.parts"))


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
    def place(**values: str) -> Path:
        return kept_path(load_sensor(str(own_design(tmp_path, **values))))

    same = {kept_path(load_sensor("thesis")), place(), place(description='"another"')}
    others = [
        place(**{key: value})
        for key, value in {
            "radius_mm": "9.0", "follow": "0.9", "count": "380", "blur_px": "0.9",
            "apex": "[240, 249, 248]", "size_mm": "0.45",
        }.items()
    ]  # fmt: skip
    assert len(same) == 1
    assert len({*same, *others}) == 7


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
        with pytest.raises(UserError, match=f"^sensor {sensor}: .*{words}"):
            attempt(known)  # type: ignore[operator]
    assert trainer.known == []
    for name in ("dome-2020", "dome-2022", "fovea"):
        check_trainable(sensor_as_designed(name))


def test_a_command_says_what_it_trains_before_it_begins(
    trainer: Trainer, typed: Typed, no_kept: Path
) -> None:
    """The stand-in learns nothing, so that the run that follows refuses its file."""
    words = ["grasp", "camera-100hz", "--set", "sensor=fovea", "--set", "duration_s=0.02", "--json"]
    first, hint, second = typed(*words).stderr.splitlines()
    assert first.startswith("chromagrip: sensor fovea has no read-out yet: training one on ")
    assert str(kept_path(load_sensor("fovea"))) in first
    assert "--body dome" in hint
    assert second.endswith("is not a trained read-out")
    assert "has no read-out yet" not in typed(*words).stderr
    done = typed(*words, "--path", "truth")  # needs none
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["readout"] is None
    assert len(trainer.known) == 1


def test_the_tables_have_the_ranges_and_sizes_of_the_training(typed: Typed, no_kept: Path) -> None:
    ranges = training_ranges(VARIATIONS, 2.0, HISTORIES, 1)
    rows = {row["name"]: row for rows in ranges.values() if isinstance(rows, list) for row in rows}
    assert {*vars(RANGES), *vars(VARIATIONS)} - {*rows} == {"nominal_share", "each_share"}

    def told(name: str) -> tuple[str, float, float]:
        return rows[name]["unit"], rows[name]["low"], rows[name]["high"]

    assert told("stiffness_n_per_m") == ("N/m", *RANGES.stiffness_n_per_m)
    assert told("slides_by_n") == ("N", 0.0, RANGES.slides_by_n)
    assert told("follow_share") == ("share", -VARIATIONS.follow_share, VARIATIONS.follow_share)
    assert told("azimuth_deg") == ("°", -2 * VARIATIONS.azimuth_deg, 2 * VARIATIONS.azimuth_deg)
    assert told("noise_levels") == ("levels", 2.0 * 0.3, 2.0 * 4.0)
    page = (DOCS / "appendix/training-ranges.md").read_text(encoding="utf-8")
    for cells in range_lines(training_ranges(VARIATIONS, NOISE, HISTORIES, EPOCHS)):
        assert f"| {' | '.join(cells)} |" in page
    listed = json.loads(typed("list", "readouts", "thesis", "--json").stdout)
    digest = hashlib.sha256(Path(listed["readout"]).read_bytes()).hexdigest()[:12]
    assert (listed["origin"], listed["digest"]) == ("shipped", digest)
    assert "sensor fovea has no trained read-out" in typed("list", "readouts", "fovea").stderr


def test_a_calibration_states_its_own_spread_of_the_stiffness_or_has_the_designs(
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
    for line, spread in (("", unsaid), ("stiffness_deviation = 0.0\n", 0.0)):
        mine.write_text(head + line)
        assert load_calibration(str(mine)).stiffness_deviation == spread
