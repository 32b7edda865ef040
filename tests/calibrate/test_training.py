from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace as changed

from chromagrip.calibrate import readout as training
from chromagrip.calibrate.learner import Learner
from chromagrip.calibrate.networks import NOISE, Basis, Errors
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


@pytest.fixture(scope="module")
def learner() -> Learner:
    """Of the shipped read-out's codes, with the noise of a camera and a floor."""
    readout = load_readout(KNOWN.readout)  # type: ignore[arg-type]
    sensor = KNOWN.sensor
    noise = np.tile([0.022, 0.022, 1.5e-3], (len(sensor.places), 2))
    none = np.zeros((1, 1))
    basis = Basis(
        noise=noise, frame=0.4 * noise, mean=readout.mean, fields=readout.fields, left=readout.left,
        strength=readout.strength, modes=readout.modes, amounts=readout.amounts, normal=none,
        friction=none,
    )  # fmt: skip
    return Learner.of(basis, sensor.places)


def test_lessons_are_codes_of_the_shifts(learner: Learner) -> None:
    """What codes can write is read as those codes, with and without the pairs that are lost."""
    rng = np.random.default_rng(2)
    count, unknowns = 40, learner.rows.shape[1]
    true = np.zeros((count, unknowns))
    true[:, :20] = 0.1 * np.sqrt(learner.strength[:20]) * rng.standard_normal((count, 20))
    white = (true @ learner.rows.T).reshape(count, -1, 6)
    shifts = learner.mean + white * learner.basis.noise
    codes, level, context = learner.read(rng, shifts)
    # Rows of the fields at other places than the axes' own are nearly, not exactly, orthonormal.
    error = codes[:, :20] - true[:, :20]
    assert np.sqrt((error**2).mean()) < 0.02 * np.sqrt((true[:, :20] ** 2).mean()) + 0.5
    # The residual is the noise alone: its mean square, in units of the noise, is at most one.
    assert (np.median(context, axis=0)[:12] < 0.1).all()
    assert np.corrcoef(np.log(level), context[:, 8])[0, 1] > -0.9
    assert ((level >= NOISE[0]) & (level <= NOISE[1])).all()


def test_a_motion_that_no_code_describes_shows_in_the_context(learner: Learner) -> None:
    rng = np.random.default_rng(3)
    shifts = np.tile(learner.mean, (30, 1, 1))
    wave = np.cos(3.0 * KNOWN.sensor.places[:, 1]) * np.sin(2.0 * KNOWN.sensor.places[:, 0]) ** 2
    moved = shifts.copy()
    moved[:, :, 0] += 0.15 * wave
    quiet, loud = learner.read(rng, shifts)[2], learner.read(rng, moved)[2]
    assert np.median(loud[:, 0]) > np.median(quiet[:, 0]) + 1.0


def test_what_cannot_be_trained_is_said_before_the_work(tmp_path: Path) -> None:
    told: list[tuple[dict[str, Any], str]] = [
        ({"calibration": "flat-2019"}, "sensor flat-2019: a flat pad has no force model"),
        ({"calibration": "thesis", "histories": 10}, "--histories 10: expected 500 or more"),
        ({"calibration": "thesis", "noise": 0.0}, "--noise 0: expected 0.1 to 50 levels"),
    ]
    for words, said in told:
        with pytest.raises(UserError, match=said):
            train(**words, out=tmp_path / "x.npz")
    assert not list(tmp_path.iterdir())
    parts = tmp_path / "x.npz.parts"
    parts.mkdir()
    training._claim(parts, KNOWN, 3.0)
    with pytest.raises(UserError, match="with another sensor or noise"):
        training.train(KNOWN, 2.0, 20, 3, tmp_path / "x.npz", 1, lambda text: None)
