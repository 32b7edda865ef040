import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from chromagrip.calibrate.sensor import save_calibration
from chromagrip.errors import UserError
from chromagrip.model import Fingertip
from chromagrip.render import load_sensor
from chromagrip.tracking import SensorCalibration, Tracks
from chromagrip.tracking.forces.calibration import (
    FitReport,
    load_calibration,
    nominal_calibration,
)
from chromagrip.tracking.forces.displacement import DisplacementGains, fit_gains, skin_displacement

from .drawn import made

SENSOR = load_sensor("thesis")
REPORT = FitReport(presses=("a.png",), noise_levels=2.0, error_px=0.01)
#: Of Lin 2019: −16.5 °/mm, 5.7 px/mm at rest, 8 px/mm² with the depth.
GAINS = DisplacementGains(
    hue_deg_per_mm=-16.5,
    hue_deviation_deg=0.3,
    log_size_per_mm=0.3,
    log_size_deviation=0.01,
    shift_px_per_mm=5.7,
    shift_px_per_mm2=-8.0,
    shift_deviation_px=0.02,
)


#: File of a sensor that is read as a chain.
TEXT = """format = "chromagrip calibration 1"
sensor = "thesis"
position_floor_px = 0.03
size_floor = 4e-4
stiffness_deviation = 0.02
[values]
tissue_stiffness_n_per_m = 330.0
membrane_stiffness_n_per_m = 1400.0
tissue_poisson = 0.41
yellow_follow = 0.45
magenta_depth_mm = 0.28
yellow_depth_mm = 1.1
"""


def calibrated() -> SensorCalibration:
    nominal = nominal_calibration(SENSOR)
    return replace(nominal, position_floor=0.03, size_floor=4e-4, displacement=GAINS)


def test_a_design_has_the_thesis_materials_and_a_file_what_was_written(tmp_path: Path) -> None:
    assert load_calibration("thesis").fingertip == Fingertip()
    large = load_calibration("dome-2020-printed")
    assert large.sensor == load_sensor("dome-2020-printed")
    assert large.fingertip.tissue_stiffness == pytest.approx(25e3 * math.pi * 20e-3 / 2)
    save_calibration(calibrated(), "thesis", REPORT, tmp_path / "mine.toml")
    assert replace(load_calibration(str(tmp_path / "mine.toml")), readout=None) == calibrated()


def test_a_file_of_a_chain_is_read(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(TEXT, encoding="utf-8")
    found = load_calibration(str(path))
    tip, sensor = found.fingertip, found.sensor
    assert (tip.tissue_stiffness, tip.membrane_stiffness) == (330.0, 1400.0)
    assert (tip.poisson_tissue, sensor.inner.follow) == (0.41, 0.45)
    assert (sensor.magenta.depth_mm, sensor.inner.depth_mm) == (0.28, 1.1)
    assert (found.position_floor, found.size_floor) == (0.03, 4e-4)
    assert found.stiffness_deviation == 0.02
    assert found.nominal == SENSOR


def test_what_is_wrong_in_a_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    for old, new, words in (
        ("size_floor", "size_flaw", "unknown key size_flaw"),
        ("yellow_depth_mm = 1.1", "yellow_depth_mm = 2.5", "must be less than the silicone's 2"),
        ("calibration 1", "calibration 9", "'chromagrip calibration 9'"),
    ):
        path.write_text(TEXT.replace(old, new), encoding="utf-8")
        with pytest.raises(UserError, match=words):
            load_calibration(str(path))
    with pytest.raises(UserError, match=r"no calibration 'mine'.*thesis"):
        load_calibration("mine")


def shown(moved: np.ndarray, noise: float, rng: np.random.Generator) -> Tracks:
    """What markers show of displacements (M, 3) [mm], by the published relations."""
    spread = noise * rng.standard_normal((4, len(moved)))
    gain = GAINS.shift_px_per_mm + GAINS.shift_px_per_mm2 * moved[:, 2]
    shift = gain[:, None] * moved[:, :2] + GAINS.shift_deviation_px * spread[:2].T
    hue = 13.5 + GAINS.hue_deg_per_mm * moved[:, 2] + GAINS.hue_deviation_deg * spread[2]
    size = GAINS.log_size_per_mm * moved[:, 2] + GAINS.log_size_deviation * spread[3]
    places = np.stack(np.meshgrid(np.arange(20), np.arange(20)), -1).reshape(-1, 2)[: len(moved)]
    position = np.stack([10.0 * places + shift] * 2)
    return replace(made(0.0, position, np.stack([size, size]), np.ones(6)), hue=hue)


def test_gains_come_back_from_presses_though_the_edge_does_not_move() -> None:
    rng = np.random.default_rng(0)
    depth = np.array([0.1, 0.2, 0.3, 0.3, 0.4])
    shear = np.array([0.0, 0.2, 0.0, -0.2, 0.3])
    rest = shown(np.zeros((400, 3)), 0.0, rng)
    presses = []
    for d, s in zip(depth, shear, strict=True):
        moved = np.tile([s, 0.0, d], (400, 1))
        moved[300:] = 0.0
        presses.append(shown(moved, 1.0, rng))
    found = fit_gains(rest, presses, 1e-3 * depth, 1e-3 * shear)
    for name, tolerance in (
        ("hue_deg_per_mm", 0.02),
        ("log_size_per_mm", 0.03),
        ("shift_px_per_mm", 0.01),
        ("shift_px_per_mm2", 0.05),
    ):
        assert getattr(found, name) == pytest.approx(getattr(GAINS, name), rel=tolerance), name


def test_displacements_are_inverted_with_their_covariance() -> None:
    rng = np.random.default_rng(1)
    rest = shown(np.zeros((400, 3)), 0.0, rng)
    moved = rng.uniform([-0.2, -0.2, 0.0], [0.2, 0.2, 0.3], (400, 3))
    exact, _ = skin_displacement(GAINS, rest, shown(moved, 0.0, rng))
    np.testing.assert_allclose(1e3 * exact, moved, atol=1e-12)
    scores = []
    for _ in range(30):
        found, covariance = skin_displacement(GAINS, rest, shown(moved, 1.0, rng))
        error = found - 1e-3 * moved
        scores.append(
            np.einsum("mi,mi->m", error, np.linalg.solve(covariance, error[..., None])[..., 0])
        )
    assert np.mean(scores) == pytest.approx(3.0, rel=0.05)


def test_hue_and_size_count_by_what_they_know() -> None:
    rng = np.random.default_rng(2)
    rest, now = (shown(np.full((9, 3), v), 0.0, rng) for v in (0.0, 0.2))
    variances = []
    for lacking in ({}, {"hue": now.hue * np.nan}, {"log_size": now.log_size * np.nan}):
        found, covariance = skin_displacement(GAINS, rest, replace(now, **lacking))
        np.testing.assert_allclose(found, 2e-4)
        variances.append(covariance[0, 2, 2])
    both, by_size, by_hue = variances
    assert by_hue == pytest.approx((1e-3 * 0.3 / 16.5) ** 2)
    assert by_size == pytest.approx((1e-3 * 0.01 / 0.3) ** 2)
    assert both == pytest.approx(1.0 / (1.0 / by_hue + 1.0 / by_size))


def test_presses_that_leave_a_gain_open_are_refused() -> None:
    rng = np.random.default_rng(3)
    still = shown(np.zeros((9, 3)), 0.0, rng)
    with pytest.raises(UserError, match="3 different depths, 1 of them with a shear"):
        fit_gains(still, [still] * 3, np.array([1e-4, 2e-4, 3e-4]), np.array([0.0, 0.0, 1e-4]))
    blind = replace(still, hue=still.hue * np.nan, log_size=still.log_size * np.nan)
    with pytest.raises(UserError, match="neither hues nor sizes"):
        fit_gains(blind, [blind] * 3, np.array([1e-4, 2e-4, 3e-4]), np.array([0.0, 1e-4, 1e-4]))
