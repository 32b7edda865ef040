"""The default reconstructor, and the sensors that it refuses."""

from dataclasses import replace
from pathlib import Path

import pytest

import chromagrip
from chromagrip.errors import UserError
from chromagrip.tracking import (
    METHODS,
    check_reconstructor,
    load_calibration,
    load_reconstructor,
    shipped_readout,
)
from chromagrip.tracking.forces import required_readout

NEEDED = ("auto", "sequential", "way")


@pytest.mark.parametrize("name", ["auto", *METHODS])
def test_only_trained_reconstructors_refuse_a_sensor_without_a_read_out(
    name: str, no_kept: Path
) -> None:
    fovea = load_calibration("fovea")
    check_reconstructor(name, load_calibration("thesis"))
    if name not in NEEDED:
        check_reconstructor(name, fovea)
        return
    with pytest.raises(UserError) as refusal:
        check_reconstructor(name, fovea)
    sentence = str(refusal.value)
    assert sentence.startswith("sensor fovea has no trained read-out: ")
    assert "`chromagrip calibrate readout fovea`" in sentence
    with pytest.raises(UserError, match="sensor fovea has no trained read-out"):
        load_reconstructor(name)(fovea, None)  # type: ignore[arg-type]


def test_a_grasp_without_a_read_out_is_refused_before_there_is_a_folder(
    tmp_path: Path, no_kept: Path
) -> None:
    scene = chromagrip.load_scene("margin-60hz", {"sensor": "fovea", "duration_s": 0.1})
    with pytest.raises(UserError, match="sensor fovea has no trained read-out"):
        chromagrip.run(scene, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_three_lines_of_a_calibration_name_a_read_out(tmp_path: Path, no_kept: Path) -> None:
    shipped = shipped_readout("thesis")
    assert shipped is not None
    (tmp_path / "mine.npz").write_bytes(shipped.read_bytes())
    mine = tmp_path / "mine.toml"
    mine.write_text("format = 'chromagrip calibration 1'\nsensor = 'fovea'\nreadout = 'mine.npz'\n")
    known = load_calibration(str(mine))
    assert required_readout(known) == tmp_path / "mine.npz"
    assert replace(known, readout=None) == load_calibration("fovea")
