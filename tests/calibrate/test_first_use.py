"""Read-outs that are trained at their first use; the training itself is replaced."""

from pathlib import Path
from typing import Any

import pytest

from chromagrip.calibrate import readout as training
from chromagrip.calibrate.first_use import ensure_readout
from chromagrip.errors import UserError
from chromagrip.render import load_sensor
from chromagrip.tracking import load_calibration, sensor_as_designed
from chromagrip.tracking.forces import (
    kept_path,
)

DESIGNS = Path(__file__).parents[2] / "render" / "designs"


class Trainer:
    """In place of the training: counts, and writes what it is told."""

    def __init__(self) -> None:
        self.known: list[Any] = []

    def __call__(self, known: Any, noise: float, n: int, e: int, out: Path, *rest: Any) -> Any:
        self.known.append(known)
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
    path = kept_path(fovea.nominal)
    known = ensure_readout(fovea)
    assert known.readout == path
    assert path.parent == no_kept / "chromagrip" / "readouts"
    assert path.read_bytes() == b"learned"
    again = load_calibration("fovea")
    assert again.readout == path
    assert ensure_readout(again) == ensure_readout(fovea) == known
    assert len(trainer.known) == 1


def test_another_design_is_kept_elsewhere(no_kept: Path, tmp_path: Path) -> None:
    def place(**values: str) -> Path:
        return kept_path(load_sensor(str(own_design(tmp_path, **values))))

    same = {kept_path(load_sensor("thesis")), place(), place(description='"another"')}
    others = [
        place(**{key: value})
        for key, value in {
            "radius_mm": "9.0", "follow": "0.9", "blur_px": "0.9", "size_mm": "0.45",
        }.items()
    ]  # fmt: skip
    assert len(same) == 1
    assert len({*same, *others}) == 5


def test_what_cannot_be_trained_is_refused_with_what_to_do(trainer: Trainer) -> None:
    with pytest.raises(UserError, match="flat pad has no force model: calibrate its displacements"):
        ensure_readout(sensor_as_designed("flat-2019"))
    with pytest.raises(UserError, match=r"spring law split, .* axial: choose fingertip\.model"):
        ensure_readout(sensor_as_designed("fovea", "axial"))
    assert trainer.known == []


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
