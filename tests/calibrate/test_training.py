from pathlib import Path

import numpy as np
import pytest

from chromagrip.calibrate import readout as training
from chromagrip.calibrate.networks import Basis
from chromagrip.cli.calibrate import train
from chromagrip.errors import UserError
from chromagrip.tracking import load_calibration
from chromagrip.tracking.forces.chain.readout import load_readout

KNOWN = load_calibration("thesis")


class StoppedError(Exception):
    pass


def test_an_interrupted_training_goes_on_and_comes_to_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("sklearn", reason="training needs the extra `learn`")
    monkeypatch.setattr(training, "PART", 10)
    monkeypatch.setattr(training, "BASIS", 25)

    def stop_half_way(text: str) -> None:
        if text == "histories, 10 of 20":
            raise StoppedError

    def learn(out: Path, tell: object = lambda text: None) -> dict[str, float]:
        return training.train(KNOWN, 2.0, 20, 3, out, 1, tell)  # type: ignore[arg-type]

    broken, whole = tmp_path / "broken.npz", tmp_path / "whole.npz"
    with pytest.raises(StoppedError):
        learn(broken, stop_half_way)
    assert not broken.exists()
    kept = {
        file.name: file.stat().st_mtime_ns for file in (tmp_path / "broken.npz.parts").iterdir()
    }
    assert "0-10.npz" in kept
    errors = learn(broken)
    assert not (tmp_path / "broken.npz.parts").exists()
    assert learn(whole) == errors
    a, b = load_readout(broken), load_readout(whole)
    assert all(np.array_equal(vars(a)[name], vars(b)[name]) for name in ("codes", "linear", "rows"))
    # Even so few tell more of µ than no image does.
    assert errors["friction_n"] < 0.5


def test_scikit_learn_is_asked_for_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps: list[str] = []
    monkeypatch.setattr("chromagrip.extras.find_spec", lambda name: None)
    with pytest.raises(UserError, match="training read-outs needs the extra `learn`: pip install"):
        training.train(KNOWN, 2.0, 20, 3, tmp_path / "x.npz", 1, steps.append)
    assert not steps
    assert not list(tmp_path.iterdir())


def test_parts_of_another_training_are_not_taken_for_ones_own(tmp_path: Path) -> None:
    pytest.importorskip("sklearn", reason="training needs the extra `learn`")
    parts = tmp_path / "x.npz.parts"
    parts.mkdir()
    training._claim(parts, KNOWN, 3.0)
    kept = {file.name: file.read_bytes() for file in parts.iterdir()}
    with pytest.raises(UserError, match="with another sensor or noise"):
        training.train(KNOWN, 2.0, 20, 3, tmp_path / "x.npz", 1, lambda text: None)
    assert {file.name: file.read_bytes() for file in parts.iterdir()} == kept


def test_codes_without_some_pairs_are_those_of_the_others() -> None:
    """Where the press is one that codes can write, the pairs that are left tell it as well."""
    rng = np.random.default_rng(2)
    pairs, codes = 60, 8
    rows = np.linalg.qr(rng.standard_normal((6 * pairs, codes)))[0].T
    spread = np.full(codes, 300.0)
    none = np.zeros((1, 1, 1))
    basis = Basis(
        noise=rng.uniform(0.5, 2.0, 6 * pairs), mean=rng.standard_normal(6 * pairs), rows=rows,
        left=np.zeros(6 * pairs), scale=np.hypot(spread, 1.0), normal=none, friction=none,
        displacement=none, shifts=none,
    )  # fmt: skip
    true = 300.0 * rng.standard_normal(codes)
    shifts = basis.noise * (basis.mean + true @ rows)
    assert basis.codes(shifts) == pytest.approx(true)
    lost = np.arange(60, 60 + 36)
    assert basis.codes_without(shifts, lost[:0]) == pytest.approx(true)
    wrong = shifts.copy()
    wrong[lost] += 1e3
    assert basis.codes_without(wrong, lost) == pytest.approx(true, rel=2e-3, abs=0.5)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"calibration": "flat-2019"}, "sensor flat-2019: a flat pad has no force model"),
        ({"calibration": "thesis", "histories": 10}, "--histories 10: expected 500 or more"),
        ({"calibration": "thesis", "noise": 0.0}, "--noise 0: expected 0.1 to 50 levels"),
        ({"calibration": "dome-2022"}, "forces are read from stiff discs only"),
    ],
)
def test_what_cannot_be_trained_is_said_before_the_work(
    tmp_path: Path, words: dict[str, object], said: str
) -> None:
    with pytest.raises(UserError, match=said):
        train(**words, out=tmp_path / "x.npz")  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())
