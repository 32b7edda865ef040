from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace as changed

from chromagrip.calibrate import readout as training
from chromagrip.calibrate.networks import Errors
from chromagrip.cli.calibrate import calibrate_readout as train
from chromagrip.errors import UserError
from chromagrip.render import SensorDesign
from chromagrip.tracking import load_calibration
from chromagrip.tracking.forces.chain.readout import load_readout

KNOWN = load_calibration("thesis")


class StoppedError(Exception):
    pass


def sparse() -> SensorDesign:
    """The known sensor with a quarter of its markers, as a basis takes their number's cube."""
    design = KNOWN.sensor
    return changed(design, layout=changed(design.layout, count=100, meridian_pitch_mm=1.5))


@pytest.mark.stages
def test_an_interrupted_training_goes_on_and_comes_to_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training, "PART", 10)
    monkeypatch.setattr(training, "BASIS", 25)
    known = replace(KNOWN, sensor=sparse(), readout=None)
    basis = training._basis(known, 2.0)  # takes longer than all else; both read it from their file
    monkeypatch.setattr(training, "_basis", lambda *_: basis)

    def stop_half_way(text: str) -> None:
        if text == "histories, 10 of 20":
            raise StoppedError

    def learn(out: Path, tell: object = lambda text: None) -> Errors:
        return training.train(known, 2.0, 20, 3, out, 1, tell)  # type: ignore[arg-type]

    broken, whole = tmp_path / "broken.npz", tmp_path / "whole.npz"
    with pytest.raises(StoppedError):
        learn(broken, stop_half_way)
    assert not broken.exists()
    assert (tmp_path / "broken.npz.parts" / "0-10.npz").exists()
    errors = learn(broken)
    assert not (tmp_path / "broken.npz.parts").exists()
    assert learn(whole) == errors
    a, b = load_readout(broken), load_readout(whole)
    same = ("fields", "amounts", "context", "targets")
    assert all(np.array_equal(getattr(a, name), getattr(b, name)) for name in same)
    assert all(np.array_equal(x, y) for x, y in zip(a.totals[0], b.totals[0], strict=True))
    assert np.isfinite(list(errors.values())).all()


def test_what_cannot_be_trained_is_said_before_the_work(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="--histories 10: expected 500 or more"):
        train(calibration="thesis", histories=10, out=tmp_path / "x.npz")
    assert not list(tmp_path.iterdir())
    parts = tmp_path / "x.npz.parts"
    parts.mkdir()
    training._claim(parts, KNOWN, 3.0)
    with pytest.raises(UserError, match="with another sensor or noise"):
        training.train(KNOWN, 2.0, 20, 3, tmp_path / "x.npz", 1, lambda text: None)
